//! Errors of reading a data set.

use std::path::PathBuf;

use super::MAX_RATE_HZ;

/// Error of reading a data set.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The file or folder could not be read: check the path and its permissions.
    #[error("reading a data set: {}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A line has invalid content: the file is damaged or of another kind.
    #[error("reading a data set: line {line}: found {found:?}, expected {expected}: {}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// Content found.
        found: String,
        /// Content expected.
        expected: String,
    },
    /// The folder is not a data set of a known layout.
    #[error("recognising a data set: found {found}, expected {expected}: {}", path.display())]
    Unrecognised {
        /// The folder.
        path: PathBuf,
        /// Content found.
        found: String,
        /// Content of the known layouts.
        expected: String,
    },
    /// Images of one eye have no counterpart: complete the data set or remove them.
    #[error(
        "pairing images: {left_only} only on the left and {right_only} only on the right, the first is {first}; \
         expected every image on both sides: {} and {}", left.display(), right.display()
    )]
    Unpaired {
        /// Number of images without a right one.
        left_only: usize,
        /// Number of images without a left one.
        right_only: usize,
        /// Timestamp, number or name of the first of them.
        first: String,
        /// Folder of the left images.
        left: PathBuf,
        /// Folder of the right images.
        right: PathBuf,
    },
    /// There is no image to replay.
    #[error("listing images: found none, expected at least one: {}", path.display())]
    Empty {
        /// The folder or list.
        path: PathBuf,
    },
    /// The head of the list is not sufficient; a recording reads all of it.
    #[error("reading the first 1 MiB of a list, which is all that a check reads: found no image on disk: {}", path.display())]
    Head {
        /// The list.
        path: PathBuf,
    },
    /// The data set has no times: give a rate.
    #[error("timing a data set: it has no times of its own, expected a frame rate with it: {}", path.display())]
    NeedsRate {
        /// The folder.
        path: PathBuf,
    },
    /// The given rate is impossible.
    #[error("timing a data set: the rate is {rate_hz} Hz, expected a number above 0 and at most {MAX_RATE_HZ}: {}", path.display())]
    Rate {
        /// The folder.
        path: PathBuf,
        /// The rate as given.
        rate_hz: f64,
    },
    /// The image is unusable: convert it or restore the file.
    #[error("loading an image: found {found}, expected {expected}: {}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// Content found.
        found: String,
        /// Content expected.
        expected: String,
    },
}
