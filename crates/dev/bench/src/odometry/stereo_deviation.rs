//! Error of the stereo calibration that a run is given: images and ground truth remain as they are,
//! the right eyes of the nominal rig deviate.

use anyhow::Result;
use cad_transforms::RigidTransform;
use odometry::Rig;
use serde::{Deserialize, Serialize};

/// Deviation of the right eye of every camera from its calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct StereoDeviation {
    /// Rotation about the x, y and z axes of the right eye, degrees.
    pub(crate) rotation_deg: [f64; 3],
    /// Principal point, px.
    pub(crate) principal_point_px: [f64; 2],
    /// Baseline, relative.
    pub(crate) baseline: f64,
    /// Focal length, relative.
    pub(crate) focal: f64,
}

impl StereoDeviation {
    /// Applies it to the calibration of a rig.
    ///
    /// # Errors
    /// A number that is not finite.
    pub(crate) fn apply(&self, rig: &mut Rig) -> Result<()> {
        let rotation = self.rotation_deg.map(f64::to_radians);
        let turn = RigidTransform::from_rotation_vector(rotation, [0.0; 3])?;
        for camera in &mut rig.cameras {
            let of = camera.right_from_left;
            let longer = of.translation_m().map(|m| m * (1.0 + self.baseline));
            let stretched = RigidTransform::from_wxyz(of.rotation_wxyz(), longer)?;
            camera.right_from_left = turn * stretched;
            camera.right_from_left_covariance = None;
            camera.right.fx *= 1.0 + self.focal;
            camera.right.fy *= 1.0 + self.focal;
            camera.right.cx += self.principal_point_px[0];
            camera.right.cy += self.principal_point_px[1];
        }
        Ok(())
    }
}
