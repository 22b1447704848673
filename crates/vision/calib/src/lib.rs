//! Lens and stereo calibration: the models as data, and the files that hold them.
//!
//! [`read_stereo`] takes a path and the size of one image and returns a [`StereoCalibration`] in
//! the conventions of this project (metres, radians, `b_from_a`, integer pixel coordinates at pixel
//! centres), together with [`Note`]s: everything that was absent, derived or suspicious and has to
//! be shown to the user. [`read_cameras`] does the same for any number of cameras,
//! [`write_cameras`] writes them in the formats of other tools, [`convert()`] fits one lens model
//! to another, [`Rectification`] rotates a stereo pair so that corresponding points share a row.
//!
//! Nothing is guessed. A file that cannot be understood is an error that names the file, the line,
//! what was found and what was expected. The original bytes of the files belong into the session;
//! [`Provenance::files`] lists them.
//!
//! This crate knows nothing of devices, sessions or the catalogue.

pub mod adjust;
pub mod allan;
pub mod basalt;
pub mod camera;
pub mod camera_imu;
pub mod cameras;
pub mod colmap;
pub mod convert;
pub mod epipolar;
pub mod error;
pub mod euroc;
pub mod foxglove;
pub mod imu_noise;
pub mod kalibr;
pub mod kitti;
pub mod lens;
pub mod middlebury;
pub mod nerfstudio;
pub mod opencv;
pub mod pair;
pub mod pnp;
pub mod read;
pub mod rectify;
pub mod remedy;
pub mod ros;
pub mod rosys;
pub mod set;
pub mod stereo;
pub mod target;
pub mod verify;
pub mod write;
pub mod zed_conf;

mod text;
mod tree;

pub use camera::{CameraModel, Distortion, Rational};
pub use convert::{Conversion, LensModel, convert};
pub use error::{CalibError, Note};
pub use foxglove::CameraInfo;
pub use lens::Lens;
pub use read::{read_cameras, read_stereo};
pub use rectify::{Rectification, View};
pub use set::{CameraSet, NamedCamera, SetImu};
pub use stereo::{Eye, Format, ImuCalibration, ImuNoise, Provenance, StereoCalibration};
pub use write::{WriteError, write_cameras};

#[cfg(test)]
mod test_data;
