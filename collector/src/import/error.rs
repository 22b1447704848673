//! Why a session was not imported.

use std::io;
use std::path::{Path, PathBuf};

use session_archive::reader::ReadError;

/// A session was not imported. Source and library are unchanged, except for `.incoming/`.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// It cannot be read as a session, or was written by a newer version.
    #[error("importing a session: {}", .path.display())]
    Unreadable {
        /// Why.
        #[source]
        source: ReadError,
        /// The source.
        path: PathBuf,
    },
    /// The identifier is not a safe folder name: the manifest is not from this recorder.
    #[error("its identifier {id:?} cannot be the name of a folder: {}", .path.display())]
    Identifier {
        /// The identifier.
        id: String,
        /// The source.
        path: PathBuf,
    },
    /// The session is not the announced one: check the announcement.
    #[error("found session {found}, expected {expected}: {}", .path.display())]
    Another {
        /// Its identifier.
        found: String,
        /// The announced identifier.
        expected: String,
        /// Its folder.
        path: PathBuf,
    },
    /// An entry of the source is not a file. Remove it, or replace it by the file.
    #[error("importing a session: found {found}, expected only files and folders: {}", .path.display())]
    NoFile {
        /// What it is.
        found: plain_file::Kind,
        /// It.
        path: PathBuf,
    },
    /// The library has a session with this identifier and other content. To replace it, remove it
    /// first: `paws prune --session ID --yes`.
    #[error("session {key} is in the library already and differs ({what}); nothing was changed: {}", .path.display())]
    Differs {
        /// Its key.
        key: String,
        /// The first difference.
        what: String,
        /// The source.
        path: PathBuf,
    },
    /// The source changed during the copy, so it is still being recorded: import it again later.
    #[error("{what} changed while it was copied; is it still being recorded? {}", .path.display())]
    Changed {
        /// What changed.
        what: String,
        /// The source.
        path: PathBuf,
    },
    /// Free the disk, then import again.
    #[error("copying takes {needed} bytes and {free} are free: {}", .path.display())]
    NoSpace {
        /// Bytes still to be copied plus the reserve.
        needed: u64,
        /// Bytes free.
        free: u64,
        /// The library.
        path: PathBuf,
    },
    /// An I/O error of the source or of the library.
    #[error("{doing}: {}", .path.display())]
    Io {
        /// What was being done.
        doing: &'static str,
        /// What failed.
        #[source]
        source: io::Error,
        /// The file or folder.
        path: PathBuf,
    },
    /// The catalogue could not be updated. The session is in the library; opening the library lists
    /// it.
    #[error("listing session {key}: {reason}")]
    Catalogue {
        /// Its key.
        key: String,
        /// Why.
        reason: String,
    },
}

/// An [`ImportError::Io`] of this file or folder.
pub(crate) fn failed<'a>(
    doing: &'static str,
    path: &'a Path,
) -> impl FnOnce(io::Error) -> ImportError + 'a {
    move |source| ImportError::Io {
        doing,
        source,
        path: path.to_owned(),
    }
}
