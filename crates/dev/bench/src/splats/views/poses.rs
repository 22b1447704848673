//! Poses of views: true ones, or those of an odometry.

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use harness::sequences::Truth;
use rig_sim::simulation::seconds;

use super::{STEP_NS, WalkKeyframe, WalkViews};
use crate::terrain::walks::transform;

impl WalkViews {
    /// The same with estimated poses of the rig, which are in a frame of their own, and with those
    /// keyframes alone that lie between them. What is rendered as truth is no longer of these
    /// views.
    #[must_use]
    pub(crate) fn with_poses(mut self, world_from_rig: Vec<(i64, RigidTransform)>) -> Self {
        let estimated = Truth::Measured(world_from_rig);
        let is_between = |own: &WalkKeyframe| {
            let steps = [-STEP_NS, STEP_NS].map(|step_ns| own.recorded.id.time_ns + step_ns);
            steps.iter().all(|time_ns| estimated.at(*time_ns).is_some())
        };
        self.keyframes.retain(is_between);
        self.estimated = Some(estimated);
        self
    }

    pub(super) fn world_from_eye(
        &self,
        camera: usize,
        eye: usize,
        time_ns: i64,
    ) -> Result<RigidTransform> {
        let world_from_rig = match &self.estimated {
            Some(poses) => poses.at(time_ns).context("a time without a pose")?,
            None => {
                let rig = self.prepared.simulation.walker().rig(seconds(time_ns));
                transform(&rig.position, &rig.rotation)?
            }
        };
        Ok(world_from_rig * self.cameras[camera].rig_from_eye[eye])
    }
}
