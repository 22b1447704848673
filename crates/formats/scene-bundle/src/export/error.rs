//! Errors of exports.

use std::io;
use std::path::{Path, PathBuf};

use cad_transforms::output::WriteError;

use crate::error::BundleError;

/// Why nothing was written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The bundle cannot be read.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// The path exists already, or writing fails.
    #[error(transparent)]
    File(#[from] WriteError),
    /// The path exists already: give another.
    #[error("writing an export: it exists already and is not overwritten: {}", .0.display())]
    Exists(PathBuf),
    /// Delete it: it is what an earlier run had written before it was stopped.
    #[error("writing an export: an earlier run was stopped and left a folder behind; delete it: {}", .0.display())]
    LeftOver(PathBuf),
    /// Any I/O error of the underlying file system.
    #[error("writing an export: {}", path.display())]
    Write {
        /// Path that was being written.
        path: PathBuf,
        /// What failed.
        #[source]
        error: io::Error,
    },
    /// The format cannot hold what there is.
    #[error("writing {format}: found {found}, expected {expected}")]
    Refused {
        /// The format.
        format: &'static str,
        /// What there is.
        found: String,
        /// What the format needs.
        expected: String,
    },
}

pub(super) fn writing(path: &Path) -> impl FnOnce(io::Error) -> ExportError + use<> {
    let path = path.to_owned();
    move |error| ExportError::Write { path, error }
}
