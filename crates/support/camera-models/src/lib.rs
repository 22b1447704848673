//! Models of cameras and IMUs as data and functions.
//!
//! [`CameraModel`] is one lens with its image size, [`StereoCalibration`] a stereo camera with its
//! IMU, [`CameraSet`] any number of cameras, all in the conventions of this project (metres,
//! radians, `b_from_a`, integer pixel coordinates at pixel centres). [`Lens`] projects and
//! unprojects, [`convert()`] fits one lens model to another, [`rectify`] rotates a stereo pair so
//! that corresponding points share a row.
//!
//! This crate knows nothing of files, of other tools, or of how a calibration is estimated.

pub mod camera_info;
pub mod plausibility;
pub mod rectify;

mod camera;
mod convert;
mod imu;
mod lens;
mod note;
mod set;
mod stereo;

pub use camera::{CameraModel, Distortion, Rational};
pub use camera_info::CameraInfo;
pub use convert::{Conversion, ConvertError, LensModel, convert, convert_within, exactly};
pub use imu::{ImuCalibration, ImuNoise, ImuSample};
pub use lens::{ByParameters, Lens, ProjectedPoint};
pub use note::Note;
pub use plausibility::InvalidCalibration;
pub use set::{CameraSet, NamedCamera, SetImu};
pub use stereo::{Eye, Provenance, StereoCalibration};
