//! Lens and stereo calibration: the models as data, and the files that hold them.
//!
//! [`read_stereo`] takes a path and the size of one picture and gives a [`StereoCalibration`] in this
//! project's conventions (metres, radians, `b_from_a`, integer pixel coordinates at pixel centres)
//! together with [`Note`]s: everything that was absent, derived or doubtful and has to be shown.
//!
//! Nothing is guessed. A file that cannot be understood is an error that names file, line, what was
//! found and what was expected. The bytes of the files themselves belong into the session as they
//! are; [`Provenance::files`] says which.
//!
//! This crate knows nothing of devices, sessions or the catalogue.

pub mod adjust;
pub mod allan;
pub mod camera;
pub mod cameras;
pub mod error;
pub mod euroc;
pub mod foxglove;
pub mod imu_noise;
pub mod kitti;
pub mod lens;
pub mod pair;
pub mod pnp;
pub mod read;
pub mod stereo;
pub mod target;
pub mod verify;
pub mod zed_conf;

mod text;
mod yaml;

pub use camera::{CameraModel, Distortion, Rational};
pub use error::{CalibError, Note};
pub use foxglove::CameraInfo;
pub use lens::Lens;
pub use read::read_stereo;
pub use stereo::{Eye, Format, ImuCalibration, ImuNoise, Provenance, StereoCalibration};

#[cfg(test)]
mod test_data;
