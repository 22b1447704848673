//! Errors of replaying a video file.

use std::path::PathBuf;

use video::file::FileError;

/// Error of replaying a video file. A retry will not help.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// It cannot be opened or decoded.
    #[error(transparent)]
    File(#[from] FileError),
    /// There are no usable times: write the file with times, for example as MKV or MP4.
    #[error("replaying a video file: found {found}, expected a time for every image: {}", path.display())]
    Times {
        /// The file.
        path: PathBuf,
        /// Content found instead.
        found: &'static str,
    },
    /// The two files are not from one pair of cameras.
    #[error("replaying two video files: found {found}, expected the same of both: {} and {}", left.display(), right.display())]
    Differ {
        /// The difference.
        found: String,
        /// File of the left eye.
        left: PathBuf,
        /// File of the right eye.
        right: PathBuf,
    },
    /// The width is not possible for a stereo image.
    #[error("replaying a video file: found images that are {width} wide, expected {expected}: {}", path.display())]
    Width {
        /// The file.
        path: PathBuf,
        /// Columns found.
        width: u32,
        /// Possible widths.
        expected: &'static str,
    },
    /// A setting does not match the file.
    #[error("replaying a video file: {what}: {}", path.display())]
    Setting {
        /// The file.
        path: PathBuf,
        /// What was found and what was expected.
        what: String,
    },
}
