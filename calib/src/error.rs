//! What can go wrong while reading a calibration, and what is worth telling although it went right.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// Why a calibration could not be read.
#[derive(Debug, thiserror::Error)]
pub enum CalibError {
    /// The file could not be read: check the path and its permissions.
    #[error("reading a calibration file: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is longer than any calibration: make one that has the cameras alone.
    #[error(
        "reading a calibration file: found {found} bytes, expected at most {limit}; make one that has the cameras alone, \
         without images and other frames: {}", path.display()
    )]
    TooLong {
        /// The file.
        path: PathBuf,
        /// Its length, bytes.
        found: u64,
        /// The most that is read of such a file, bytes.
        limit: u64,
    },
    /// A line is not what this kind of file has there: correct the line or fetch the file again.
    #[error("reading a calibration: line {line}: found {found}, expected {expected}: {}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is there.
        found: String,
        /// What belongs there.
        expected: String,
    },
    /// Something the file must hold is not in it.
    #[error("reading a calibration: {what} is missing, found {found}: {}", path.display())]
    Missing {
        /// The file or folder.
        path: PathBuf,
        /// What is missing.
        what: String,
        /// What is there in its place.
        found: String,
    },
    /// The file is of another resolution than the pictures: use the file or mode that fits.
    #[error("choosing a calibration for pictures of {width}x{height}: found {found}: {}", path.display())]
    Resolution {
        /// The file.
        path: PathBuf,
        /// Width of one picture, pixels.
        width: u32,
        /// Height of one picture, pixels.
        height: u32,
        /// The resolutions the file holds.
        found: String,
    },
    /// The file does not say of which size its pictures are: give the size.
    #[error("reading a calibration: found {found}, expected the size of a picture, which must be given: {}", path.display())]
    SizeUnknown {
        /// The file.
        path: PathBuf,
        /// What is there.
        found: String,
    },
    /// The file is of another camera than expected.
    #[error("reading a calibration: found serial {found}, expected {expected}: {}", path.display())]
    Serial {
        /// The file.
        path: PathBuf,
        /// The serial in the file's name.
        found: String,
        /// The serial of the camera.
        expected: String,
    },
    /// The numbers can be read but cannot be true.
    #[error("checking a calibration: {reason}: {}", path.display())]
    Implausible {
        /// The file.
        path: PathBuf,
        /// What is wrong with them.
        reason: String,
    },
    /// No reader knows this file or folder.
    #[error("recognising a calibration: found {found}, expected {expected}: {}", path.display())]
    Unrecognised {
        /// The file or folder.
        path: PathBuf,
        /// What is there.
        found: String,
        /// What the readers look for.
        expected: String,
    },
}

impl CalibError {
    /// Of a file that could not be read.
    pub(crate) fn unread(path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        let inner = source.get_ref();
        match inner.and_then(|e| e.downcast_ref::<plain_file::TooLong>()) {
            Some(&plain_file::TooLong { found, limit }) => Self::TooLong { path, found, limit },
            None => Self::Read { path, source },
        }
    }
}

/// Something absent, derived or doubtful that did not stop the reading. Show it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note(pub String);

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}
