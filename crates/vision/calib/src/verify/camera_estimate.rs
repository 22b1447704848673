//! The comparisons of one camera.

use serde::Serialize;

use super::camera_imu::CameraImu;
use super::stereo::StereoAlignment;

/// Comparisons of one camera.
#[derive(Clone, Debug, Serialize)]
pub struct CameraEstimate {
    /// Camera name.
    pub name: String,
    /// Eyes against each other, if there are enough matches.
    pub eyes: Option<StereoAlignment>,
    /// Camera against its own gyroscope, if there is enough rotation.
    pub imu: Option<CameraImu>,
}
