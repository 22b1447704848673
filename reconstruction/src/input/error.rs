//! Why a hand-off is refused.

use std::io;
use std::path::PathBuf;

use session_archive::handoff::HandOffError;
use session_archive::index::IndexError;
use session_archive::reader::ReadError as SessionError;

/// Why a hand-off is refused. The path of its session comes last in every message.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// There is no such file or folder, or it cannot be reached.
    #[error("looking for a hand-off in {}", .path.display())]
    Path {
        /// As given.
        path: PathBuf,
        /// What failed.
        #[source]
        error: io::Error,
    },
    /// Missing, not validated, failed and not accepted, edited or changed: validate and hand over
    /// again.
    #[error("checking the hand-off of the session {}", .path.display())]
    HandOff {
        /// The session's folder.
        path: PathBuf,
        /// The error.
        #[source]
        error: HandOffError,
    },
    /// A file that reading relies on is not among those that were sealed: hand over again.
    #[error("the hand-off does not seal {file}, which reading relies on: {}", .path.display())]
    NotSealed {
        /// Path below the session's folder.
        file: String,
        /// The session's folder.
        path: PathBuf,
    },
    /// The manifest belongs to another session, or is invalid: hand over again.
    #[error("the hand-off is of session {sealed}, the manifest of {found}: {}", .path.display())]
    OtherSession {
        /// The session that was handed over.
        sealed: String,
        /// The session of the manifest.
        found: String,
        /// The session's folder.
        path: PathBuf,
    },
    /// The session's files cannot be read.
    #[error("reading the session {}", .path.display())]
    Session {
        /// The session's folder.
        path: PathBuf,
        /// What failed.
        #[source]
        error: SessionError,
    },
    /// Written by another version of the programs, or it does not fit: index and hand over again.
    #[error("reading the index of the session {}", .path.display())]
    Index {
        /// The session's folder.
        path: PathBuf,
        /// The error.
        #[source]
        error: IndexError,
    },
    /// Image format that this program does not know: update it.
    #[error("camera {camera} has {what} {found:?}, expected {expected}: {}", .path.display())]
    Unknown {
        /// The camera.
        camera: String,
        /// `codec` or `color`.
        what: &'static str,
        /// The value found.
        found: String,
        /// The values known.
        expected: &'static str,
        /// The session's folder.
        path: PathBuf,
    },
}
