//! Access to the files of a calibration, so that a format reads bytes and not a disk.

use std::io;
use std::path::{Path, PathBuf};

use crate::error::CalibError;
use crate::text::Source;

/// Files by their paths.
pub(crate) trait Files {
    /// The bytes of a file.
    ///
    /// # Errors
    /// It cannot be read, or is longer than `limit` bytes ([`plain_file::TooLong`]).
    fn bytes(&self, path: &Path, limit: u64) -> io::Result<Vec<u8>>;

    /// Whether the path is a regular file.
    fn is_file(&self, path: &Path) -> bool;

    /// Whether the path is a folder.
    fn is_folder(&self, path: &Path) -> bool;

    /// Whether the path exists and could be a file. Other things, such as a pipe, are rejected by
    /// the reader of the format.
    fn is_there(&self, path: &Path) -> bool;

    /// The paths in a folder, in no defined order.
    ///
    /// # Errors
    /// The folder cannot be read.
    fn entries(&self, folder: &Path) -> io::Result<Vec<PathBuf>>;
}

impl dyn Files + '_ {
    /// A text about one rig.
    pub(crate) fn text(&self, path: &Path) -> Result<Source, CalibError> {
        self.text_up_to(path, plain_file::TEXT_LIMIT)
    }

    /// A text that may also list all images of a recording.
    pub(crate) fn document(&self, path: &Path) -> Result<Source, CalibError> {
        self.text_up_to(path, plain_file::DOCUMENT_LIMIT)
    }

    fn text_up_to(&self, path: &Path, limit: u64) -> Result<Source, CalibError> {
        let text = self.bytes(path, limit).and_then(plain_file::text);
        Ok(Source {
            path: path.to_owned(),
            text: text.map_err(|source| CalibError::unread(path, source))?,
        })
    }
}

/// The files on disk.
pub(crate) struct Disk;

impl Files for Disk {
    fn bytes(&self, path: &Path, limit: u64) -> io::Result<Vec<u8>> {
        plain_file::read(path, limit)
    }

    fn is_file(&self, path: &Path) -> bool {
        path.is_file()
    }

    fn is_folder(&self, path: &Path) -> bool {
        path.is_dir()
    }

    fn is_there(&self, path: &Path) -> bool {
        std::fs::metadata(path).is_ok_and(|data| !data.is_dir())
    }

    fn entries(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        let entries = std::fs::read_dir(folder)?;
        entries.map(|entry| Ok(entry?.path())).collect()
    }
}
