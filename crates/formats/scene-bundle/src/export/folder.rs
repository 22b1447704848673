//! A folder that appears whole or not at all.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::error::{ExportError, writing};

/// A folder being written, under its name with `.partial` appended. It is removed if dropped
/// unfinished.
pub(super) struct NewFolder {
    out: PathBuf,
    partial: PathBuf,
    finished: bool,
}

impl NewFolder {
    pub(super) fn begin(out: &Path) -> Result<Self, ExportError> {
        let Some(name) = out.file_name() else {
            let error = io::Error::new(io::ErrorKind::InvalidInput, "the folder has no name");
            return Err(writing(out)(error));
        };
        let mut name = name.to_owned();
        name.push(".partial");
        let partial = out.with_file_name(name);
        if let Some(parent) = partial.parent() {
            fs::create_dir_all(parent).map_err(writing(parent))?;
        }
        match fs::create_dir(&partial) {
            Ok(()) => Ok(Self {
                out: out.to_owned(),
                partial,
                finished: false,
            }),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
                Err(ExportError::LeftOver(partial))
            }
            Err(error) => Err(writing(&partial)(error)),
        }
    }

    /// Writes a new file, with the folders above it.
    pub(super) fn write(&self, path: &str, bytes: &[u8]) -> Result<(), ExportError> {
        let path = self.partial.join(path);
        let parent = path.parent().unwrap_or(&self.partial);
        fs::create_dir_all(parent).map_err(writing(parent))?;
        fs::write(&path, bytes).map_err(writing(&path))
    }

    pub(super) fn finish(mut self) -> Result<(), ExportError> {
        // A folder cannot be renamed over a file or a folder that holds something.
        fs::rename(&self.partial, &self.out).map_err(writing(&self.out))?;
        self.finished = true;
        Ok(())
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        if !self.finished {
            // It belongs to this run. If removing it fails too, its name shows its origin.
            let _ = fs::remove_dir_all(&self.partial);
        }
    }
}
