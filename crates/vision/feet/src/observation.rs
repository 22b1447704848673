//! The pose of a foot in the world, from one of its tags in a frame.
//!
//! Contract: of the two poses of a tag that images hardly distinguish, that one counts whose sole
//! is more level. The covariance is that of the tag's pose; errors of the rig's pose are not in it.

use cad_transforms::{Covariance, RigidTransform};
use nalgebra::Vector3;

use crate::config::FootConfig;
use crate::stance::FootObservation;

/// A tag in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TagPose {
    /// Takes points of the tag to the rig, m.
    pub rig_from_tag: RigidTransform,
    /// Covariance of a small motion of the tag in its own axes.
    pub covariance: Covariance,
    /// A second pose that images hardly contradict more, and its cost above that of the first, in
    /// units of the variance of a pixel's noise.
    pub second: Option<(RigidTransform, f64)>,
}

/// The foot that a tag is on.
///
/// ```
/// use cad_transforms::{Covariance, RigidTransform};
/// use feet::FootConfig;
/// use feet::observation::{TagPose, foot_observation};
///
/// // Both poses of a tag below the rig: one is that of a level sole.
/// let tilted = |angle| RigidTransform::from_rotation_vector([angle, 0.0, 0.0], [0.2, 0.1, -1.2]);
/// let tag = TagPose {
///     rig_from_tag: tilted(0.4)?,
///     covariance: Covariance::from_sigmas([1e-3; 3], [0.02; 3])?,
///     second: Some((tilted(0.0)?, 3.0)),
/// };
/// let foot_from_tag = RigidTransform::from_translation_m([0.05, 0.0, 0.08])?;
/// let rig = RigidTransform::from_translation_m([0.0, 0.0, 1.3])?;
/// let foot = foot_observation(0, &rig, &tag, &foot_from_tag, &FootConfig::default());
/// assert!((foot.world_from_foot.translation_m()[2] - 0.02).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn foot_observation(
    time_ns: i64,
    world_from_rig: &RigidTransform,
    tag: &TagPose,
    foot_from_tag: &RigidTransform,
    config: &FootConfig,
) -> FootObservation {
    let tag_from_foot = foot_from_tag.inverse();
    let world_from_foot = |pose: &RigidTransform| *world_from_rig * *pose * tag_from_foot;
    let cost = |pose: &RigidTransform, excess: f64| {
        let up = pose.rotation() * Vector3::z();
        let tilt = libm::acos(up.z.clamp(-1.0, 1.0));
        (tilt / config.level_sigma_rad).powi(2) + excess / config.excess_per_square
    };
    let first = world_from_foot(&tag.rig_from_tag);
    let second = tag
        .second
        .map(|(pose, excess)| (world_from_foot(&pose), excess));
    let pose = match second {
        Some((second, excess)) if cost(&second, excess) < cost(&first, 0.0) => second,
        _ => first,
    };
    FootObservation {
        time_ns,
        world_from_foot: pose,
        covariance: tag.covariance.moved(foot_from_tag),
    }
}

/// At most one observation for each time, the surest.
pub fn surest(observations: impl IntoIterator<Item = FootObservation>) -> Vec<FootObservation> {
    let mut surest: Vec<FootObservation> = Vec::new();
    for observation in observations {
        let sigma = |own: &FootObservation| own.covariance.matrix().trace();
        match surest.last_mut() {
            Some(last) if last.time_ns == observation.time_ns => {
                if sigma(&observation) < sigma(last) {
                    *last = observation;
                }
            }
            _ => surest.push(observation),
        }
    }
    surest
}
