//! Where a foot is expected from its last detections.

use cad_transforms::RigidTransform;
use fiducials::Motion;
use nalgebra::Vector3;

use crate::config::PredictionConfig;
use crate::poses;

/// A foot at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FootPose {
    pub(crate) time_ns: i64,
    pub(crate) world_from_foot: RigidTransform,
}

/// The last detection of a foot, and its velocity then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FootMotion {
    last: FootPose,
    /// In the world: of the foot's origin, m/s, and its angular rate, rad/s.
    velocity: Motion,
}

impl FootMotion {
    /// After a detection; `earlier` is the state before it.
    pub(crate) fn new(seen: FootPose, earlier: Option<&Self>, config: &PredictionConfig) -> Self {
        let velocity = earlier.and_then(|earlier| {
            let seconds = 1e-9 * (seen.time_ns - earlier.last.time_ns) as f64;
            let is_near = seconds > 0.0 && seconds < config.max_velocity_interval_s;
            is_near.then(|| {
                velocity(
                    &earlier.last.world_from_foot,
                    &seen.world_from_foot,
                    seconds,
                )
            })
        });
        Self {
            last: seen,
            velocity: velocity.unwrap_or_default(),
        }
    }

    /// Pose of the foot in the world in its last detection.
    pub(crate) fn last_pose(&self) -> RigidTransform {
        self.last.world_from_foot
    }

    /// Time since the last detection, s.
    pub(crate) fn age_s(&self, time_ns: i64) -> f64 {
        1e-9 * (time_ns - self.last.time_ns) as f64
    }

    /// Pose at a time, and the velocity there.
    pub(crate) fn at(&self, time_ns: i64, config: &PredictionConfig) -> (RigidTransform, Motion) {
        let speed = Vector3::from(self.velocity.linear).norm();
        if speed < config.standing_speed {
            return (self.last.world_from_foot, Motion::default());
        }
        let seconds = self.age_s(time_ns).clamp(0.0, config.max_extrapolation_s);
        let moved = moved(&self.last.world_from_foot, &self.velocity, seconds);
        (moved.unwrap_or(self.last.world_from_foot), self.velocity)
    }

    /// Speed of the motion from the last detection to a pose, m/s.
    pub(crate) fn speed_to(&self, seen: &FootPose) -> f64 {
        let moved = seen.world_from_foot.translation() - self.last.world_from_foot.translation();
        moved.norm() / self.age_s(seen.time_ns).max(1e-3)
    }
}

/// Mean velocity between two poses.
fn velocity(from: &RigidTransform, to: &RigidTransform, seconds: f64) -> Motion {
    let linear = (to.translation() - from.translation()) / seconds;
    let turn = (to.rotation() * from.rotation().inverse()).scaled_axis() / seconds;
    Motion {
        linear: linear.into(),
        angular: turn.into(),
    }
}

/// A pose after a time of constant velocity.
pub(crate) fn moved(
    pose: &RigidTransform,
    velocity: &Motion,
    seconds: f64,
) -> Option<RigidTransform> {
    let turn =
        RigidTransform::from_rotation_vector(velocity.angular.map(|rate| rate * seconds), [0.0; 3])
            .ok()?;
    let at = pose.translation() + Vector3::from(velocity.linear) * seconds;
    let rotation = turn.rotation() * pose.rotation();
    poses::pose(&rotation, &at)
}
