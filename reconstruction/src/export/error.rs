//! Why nothing was written.

use std::io;
use std::path::{Path, PathBuf};

use session_input::ReadError;

/// Why nothing was written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// Name another folder.
    #[error("writing needs a new or an empty folder, and this one holds something: {}", .0.display())]
    NotEmpty(PathBuf),
    /// Delete it: it is what an earlier run had written before it was stopped.
    #[error("an earlier run was stopped and left a folder behind; delete it: {}", .0.display())]
    LeftOver(PathBuf),
    /// Any I/O error of the underlying file system.
    #[error("writing {}", .path.display())]
    Write {
        /// What was being written.
        path: PathBuf,
        /// What failed.
        #[source]
        error: io::Error,
    },
    /// Reading cannot start.
    #[error(transparent)]
    Read(#[from] ReadError),
}

/// Adds the path to an error of writing it.
pub(super) fn writing(path: &Path) -> impl Fn(io::Error) -> ExportError + use<> {
    let path = path.to_owned();
    move |error| ExportError::Write {
        path: path.clone(),
        error,
    }
}
