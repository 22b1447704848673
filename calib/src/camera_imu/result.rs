//! The result of one camera.

use anyhow::Result;
use cad_transforms::RigidTransform;
use calib::camera_imu::{CameraImu, Verdict};
use camera_models::{CameraModel, ImuNoise};

/// A camera with its result.
pub(super) struct CameraResult {
    pub(super) camera: String,
    /// Nominal `imu_from_left`.
    pub(super) nominal: Option<RigidTransform>,
    /// Position of the board, if one was detected.
    pub(super) board: Option<usize>,
    pub(super) noise: ImuNoise,
    pub(super) line_s: f64,
    /// Rate of the IMU, Hz.
    pub(super) rate_hz: f64,
    /// Camera model and `eye_from_left` of each eye.
    pub(super) lenses: Vec<(CameraModel, RigidTransform)>,
    pub(super) found: Result<CameraImu>,
}

impl CameraResult {
    /// The estimate, if no gate fails.
    pub(super) fn accepted(&self) -> Option<&CameraImu> {
        let found = self.found.as_ref().ok()?;
        (found.verdict() != Verdict::Fail).then_some(found)
    }
}
