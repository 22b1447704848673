//! Errors of reading and writing a bundle.

use std::io;
use std::path::{Path, PathBuf};

/// Why a bundle could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum BundleError {
    /// Any I/O error of the underlying file system: check the path, its permissions and the free
    /// space.
    #[error("{doing}: {}", path.display())]
    Io {
        /// Operation that failed.
        doing: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// Error of the operating system.
        #[source]
        error: io::Error,
    },
    /// No bundle, or one that this version does not read.
    #[error("opening a scene bundle: found {found}, expected {expected}: {}", path.display())]
    NotABundle {
        /// The folder or its manifest.
        path: PathBuf,
        /// What was found.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// Another program is writing to it: wait for that one.
    #[error("opening a scene bundle for writing: another program is writing to it; wait for it to end: {}", path.display())]
    Locked {
        /// The bundle.
        path: PathBuf,
    },
    /// The bundle is of another source: write to another folder.
    #[error("opening a scene bundle for writing: it is of {found}, expected {expected}; name another folder: {}", path.display())]
    OtherSource {
        /// The bundle.
        path: PathBuf,
        /// Source of the bundle.
        found: String,
        /// Source to be written.
        expected: String,
    },
    /// A defect of the caller: a name, a hash or a number that the format does not allow.
    #[error("writing to a scene bundle: found {found}, expected {expected}: {}", path.display())]
    Refused {
        /// The bundle or the file in it.
        path: PathBuf,
        /// Value that was given.
        found: String,
        /// What the format allows.
        expected: String,
    },
    /// No stage has written this output yet.
    #[error("reading a scene bundle: it has no output {name}, only {found}: {}", path.display())]
    NoOutput {
        /// The bundle.
        path: PathBuf,
        /// The output that was requested.
        name: String,
        /// The outputs that are there.
        found: String,
    },
    /// A file differs from what was written: run the stage again.
    #[error("reading a scene bundle: found {found}, expected {expected}: {}", path.display())]
    Changed {
        /// The file.
        path: PathBuf,
        /// What was found.
        found: String,
        /// What was written.
        expected: String,
    },
    /// A file is as it was written, and does not follow its format.
    #[error("reading a scene bundle: {place}: found {found}, expected {expected}: {}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where in it.
        place: String,
        /// What was found.
        found: String,
        /// What was expected.
        expected: String,
    },
}

/// Adds the operation and its path to an I/O error.
pub(crate) fn doing(
    doing: &'static str,
    path: impl AsRef<Path>,
) -> impl FnOnce(io::Error) -> BundleError {
    let path = path.as_ref().to_owned();
    move |error| BundleError::Io { doing, path, error }
}
