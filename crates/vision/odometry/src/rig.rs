//! What is known of the rig before anything is seen.

use cad_transforms::RigidTransform;
use calib::{CameraModel, ImuNoise};
use nalgebra::Matrix6;

/// Stereo cameras and IMUs on one rigid plate.
#[derive(Clone, Debug)]
pub struct Rig {
    /// The cameras, at least one.
    pub cameras: Vec<StereoCamera>,
    /// The IMUs, the best first; may be none.
    pub imus: Vec<Imu>,
}

/// One stereo camera.
#[derive(Clone, Debug)]
pub struct StereoCamera {
    /// For example `feet`.
    pub name: String,
    /// Lens of the left eye, unrectified.
    pub left: CameraModel,
    /// Lens of the right eye.
    pub right: CameraModel,
    /// Where the left eye sits, m.
    pub rig_from_left: RigidTransform,
    /// How far that may be off, if it is known: of a small motion of the left optical frame in its own axes, shift m and turn rad.
    pub covariance: Option<Matrix6<f64>>,
    /// Takes points in the left optical frame to the right one, m.
    pub right_from_left: RigidTransform,
    /// Time from one row's exposure to the next one's, s; 0 for a global shutter.
    pub line_s: f64,
}

/// One IMU.
#[derive(Clone, Debug)]
pub struct Imu {
    /// For example `feet/imu`.
    pub name: String,
    /// Where it sits, m.
    pub rig_from_imu: RigidTransform,
    /// Its noise.
    pub noise: ImuNoise,
    /// Nominal rate, Hz.
    pub rate_hz: f64,
    /// Largest rate and specific force that it can tell, rad/s and m/s²; infinite where not known.
    pub range: [f64; 2],
}
