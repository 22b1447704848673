//! Whether a frame shows a foot at a pose.

use cad_transforms::RigidTransform;

use super::sure_point::{SurePoint, is_small};
use super::{FootObservation, is_within};
use crate::config::StanceConfig;
use crate::poses::motion;

/// Whether frames show a foot at a pose.
pub(super) struct PoseCheck<'a> {
    point: SurePoint,
    config: &'a StanceConfig,
}

impl<'a> PoseCheck<'a> {
    pub(super) fn new(
        observations: &[FootObservation],
        first: usize,
        config: &'a StanceConfig,
    ) -> Self {
        let point = SurePoint::of(&observations[first].covariance);
        Self { point, config }
    }

    pub(super) fn agrees(&self, world_from_foot: &RigidTransform, own: &FootObservation) -> bool {
        let config = self.config;
        let motion = motion(world_from_foot, &own.world_from_foot);
        let tolerance = [config.max_deviation_m, config.max_deviation_rad];
        is_within(&motion, own.covariance.matrix(), tolerance) || {
            let displacement = self
                .point
                .displacement(world_from_foot, &own.world_from_foot);
            let covariance = self.point.covariance(&own.covariance);
            is_small(&displacement, &covariance, 0.5 * config.max_deviation_m)
        }
    }
}
