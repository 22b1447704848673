//! Calibration files of other tools: readers, writers, and the detection of their formats.
//!
//! [`read_stereo`] takes a path and the size of one image and returns a
//! [`StereoCalibration`](camera_models::StereoCalibration), together with
//! [`Note`](camera_models::Note)s: everything that was absent, derived or suspicious and has to be
//! shown to the user. [`read_cameras`] does the same for any number of cameras, [`write_cameras`]
//! writes them. [`board`] has the files of calibration boards.
//!
//! Nothing is guessed. A file that cannot be understood is an error that names the file, the line,
//! what was found and what was expected. The original bytes of the files belong into the session;
//! [`Provenance::files`](camera_models::Provenance::files) lists them.
//!
//! This crate knows nothing of images, sessions, or of how a calibration is estimated.

pub mod board;
pub mod kalibr;
pub mod zed_conf;

mod basalt;
mod colmap;
mod detect;
mod entry;
mod error;
mod euroc;
mod files;
mod format;
mod kitti;
mod middlebury;
mod nerfstudio;
mod opencv;
mod output;
mod pair;
mod read;
mod registry;
mod ros;
mod rosys;
mod text;
mod tree;
mod write;

pub use error::CalibError;
pub use format::Format;
pub use output::WriteError;
pub use read::{detect_format, read_cameras, read_stereo};
pub use write::{contents, write_cameras};

#[cfg(test)]
mod test_data;
