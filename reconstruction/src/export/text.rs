//! Text files, line by line.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;

use super::error::{ExportError, writing};

/// A text file being written.
pub(super) struct Text {
    path: PathBuf,
    file: BufWriter<File>,
}

impl Text {
    pub(super) fn create(path: PathBuf) -> Result<Self, ExportError> {
        let file = File::create_new(&path).map_err(writing(&path))?;
        Ok(Self {
            path,
            file: BufWriter::new(file),
        })
    }

    pub(super) fn line(&mut self, line: std::fmt::Arguments<'_>) -> Result<(), ExportError> {
        writeln!(self.file, "{line}").map_err(writing(&self.path))
    }

    pub(super) fn finish(mut self) -> Result<(), ExportError> {
        self.file.flush().map_err(writing(&self.path))
    }
}
