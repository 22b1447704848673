//! The rig with its nominal calibration.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, ImuNoise};
use nalgebra::Matrix6;

/// Stereo cameras and IMUs on one rigid plate.
#[derive(Clone, Debug)]
pub struct Rig {
    /// Stereo cameras, at least one.
    pub cameras: Vec<StereoCamera>,
    /// IMUs, the best one first; may be empty.
    pub imus: Vec<Imu>,
}

/// One stereo camera.
///
/// ```
/// # use cad_transforms::RigidTransform;
/// # use camera_models::{CameraModel, Distortion, Lens};
/// # use odometry::rig::StereoCamera;
///
/// let lens = CameraModel::new((672, 376), [350.0, 350.0, 335.5, 187.5], Distortion::None);
/// let camera = StereoCamera {
///     name: "feet".to_owned(),
///     left: lens,
///     right: lens,
///     rig_from_left: RigidTransform::from_translation_m([0.1, 0.0, 0.05])?,
///     covariance: None,
///     right_from_left: RigidTransform::from_translation_m([-0.063, 0.0, 0.0])?,
///     right_from_left_covariance: None,
///     line_s: 0.0,
/// };
/// // A point 2 m ahead of the left camera, in both images: a disparity of 350 px x 6.3 cm / 2 m.
/// let in_left = [0.2, -0.1, 2.0];
/// let [left, right] = [
///     Lens::new(&camera.left).project(in_left).ok_or("outside")?,
///     Lens::new(&camera.right).project(camera.right_from_left.apply(in_left)).ok_or("outside")?,
/// ];
/// assert!((left[0] - right[0] - 11.025).abs() < 1e-9);
/// assert!((left[1] - right[1]).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct StereoCamera {
    /// Name, for example `feet`.
    pub name: String,
    /// Camera model of the left image, unrectified.
    pub left: CameraModel,
    /// Camera model of the right image, unrectified.
    pub right: CameraModel,
    /// Extrinsics of the left camera, m.
    pub rig_from_left: RigidTransform,
    /// Covariance of the extrinsics, if known: of a small motion of the left optical frame in its
    /// own axes, translation m and rotation rad.
    pub covariance: Option<Matrix6<f64>>,
    /// Extrinsics between the two optical frames, m.
    pub right_from_left: RigidTransform,
    /// Covariance of these extrinsics, if known: of a small motion of the left optical frame in
    /// its own axes, translation m and rotation rad. `None` for a calibration that states none, as
    /// that of a factory: errors of a tenth of a degree and of a hundredth of the baseline are then
    /// considered possible.
    pub right_from_left_covariance: Option<Matrix6<f64>>,
    /// Readout time per row, s; 0 for a global shutter.
    pub line_s: f64,
}

/// One IMU.
#[derive(Clone, Debug)]
pub struct Imu {
    /// Name, for example `feet/imu`.
    pub name: String,
    /// Extrinsics of the IMU, m.
    pub rig_from_imu: RigidTransform,
    /// Noise densities and bias random walks.
    pub noise: ImuNoise,
    /// Nominal rate, Hz.
    pub rate_hz: f64,
    /// Measurement range of angular rate and specific force, rad/s and m/s²; infinite if unknown.
    pub range: [f64; 2],
}
