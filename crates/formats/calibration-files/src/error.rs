//! Errors of reading a calibration.

use std::io;
use std::path::{Path, PathBuf};

use camera_models::InvalidCalibration;

/// Why a calibration could not be read.
#[derive(Debug, thiserror::Error)]
pub enum CalibError {
    /// The file could not be read: check the path and its permissions.
    #[error("reading a calibration file: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The file is longer than any calibration: extract the cameras alone.
    #[error(
        "reading a calibration file: found {found} bytes, expected at most {limit}; make one that has the cameras alone, \
         without images and other frames: {}", path.display()
    )]
    TooLong {
        /// The file.
        path: PathBuf,
        /// Its length, bytes.
        found: u64,
        /// Maximum length that is read of such a file, bytes.
        limit: u64,
    },
    /// A line differs from the format: correct the line or fetch the file again.
    #[error("reading a calibration: line {line}: found {found}, expected {expected}: {}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// Text found.
        found: String,
        /// Text expected.
        expected: String,
    },
    /// A required element is missing.
    #[error("reading a calibration: {what} is missing, found {found}: {}", path.display())]
    Missing {
        /// The file or folder.
        path: PathBuf,
        /// Missing element.
        what: String,
        /// Content found instead.
        found: String,
    },
    /// The file is of another resolution than the images: use the file or mode that fits.
    #[error("choosing a calibration for images of {width}x{height}: found {found}: {}", path.display())]
    Resolution {
        /// The file.
        path: PathBuf,
        /// Image width, pixels.
        width: u32,
        /// Image height, pixels.
        height: u32,
        /// The resolutions in the file.
        found: String,
    },
    /// The file has no image size: give the size.
    #[error("reading a calibration: found {found}, expected the image size, which must be given: {}", path.display())]
    SizeUnknown {
        /// The file.
        path: PathBuf,
        /// Content found.
        found: String,
    },
    /// The file belongs to another camera.
    #[error("reading a calibration: found serial {found}, expected {expected}: {}", path.display())]
    Serial {
        /// The file.
        path: PathBuf,
        /// The serial in the file's name.
        found: String,
        /// The serial of the camera.
        expected: String,
    },
    /// The numbers can be read but are impossible.
    #[error("checking a calibration: {reason}: {}", path.display())]
    Implausible {
        /// The file.
        path: PathBuf,
        /// The contradiction.
        reason: String,
    },
    /// Unknown file or folder.
    #[error("recognising a calibration: found {found}, expected {expected}: {}", path.display())]
    Unrecognised {
        /// The file or folder.
        path: PathBuf,
        /// Content found.
        found: String,
        /// Formats that are recognized.
        expected: String,
    },
}

impl CalibError {
    /// Error of a file that could not be read.
    pub(crate) fn unread(path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        let inner = source.get_ref();
        match inner.and_then(|e| e.downcast_ref::<plain_file::TooLong>()) {
            Some(&plain_file::TooLong { found, limit }) => Self::TooLong { path, found, limit },
            None => Self::Read { path, source },
        }
    }

    /// Error of a file whose values are invalid.
    pub(crate) fn invalid(path: &Path) -> impl Fn(InvalidCalibration) -> Self {
        move |error| {
            let path = path.to_owned();
            match error {
                InvalidCalibration::Missing { what, found } => Self::Missing { path, what, found },
                InvalidCalibration::Implausible { reason } => Self::Implausible { path, reason },
            }
        }
    }
}
