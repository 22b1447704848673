//! Where an agent is and how it moves.

use cad_transforms::{RigidTransform, so3};

/// Where an agent is and how it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AgentState {
    /// Point on the ground below its center, m; of a free camera its position.
    pub position_m: [f64; 3],
    /// Heading, counterclockwise from x, rad, -π to π.
    pub yaw_rad: f64,
    /// Rotation about its left axis, rad: positive looks down.
    pub pitch_rad: f64,
    /// Rotation about its forward axis, rad: positive lifts the left side.
    pub roll_rad: f64,
    /// Speed forward and to the left, m/s, and rate of turn, rad/s.
    pub velocity: [f64; 3],
    /// Level of the ground.
    pub level: usize,
    /// Whether the footprint rests on the ground.
    pub is_on_ground: bool,
}

/// Largest coordinate of an agent, m: 100 km.
const MAX_POSITION_M: f64 = 1e5;
/// Largest speed, m/s, and rate of turn, rad/s.
const MAX_VELOCITY: f64 = 1e3;
/// Largest angle, rad; angles from outside may have several turns.
const MAX_ANGLE_RAD: f64 = 1e3;

impl AgentState {
    /// Whether all numbers are finite, and in the range of agents: coordinates within 100 km,
    /// speeds within 1000 m/s, rates of turn within 1000 rad/s and angles within 1000 rad.
    pub fn is_valid(&self) -> bool {
        let angles = [self.yaw_rad, self.pitch_rad, self.roll_rad];
        let are_within = |numbers: &[f64; 3], limit: f64| numbers.iter().all(|v| v.abs() <= limit);
        are_within(&self.position_m, MAX_POSITION_M)
            && are_within(&self.velocity, MAX_VELOCITY)
            && are_within(&angles, MAX_ANGLE_RAD)
    }

    /// The same agent with its body at a pose.
    #[must_use]
    pub(crate) fn with_pose(&self, world_from_body: &RigidTransform) -> Self {
        let forward = world_from_body.rotate([1.0, 0.0, 0.0]);
        let [left, up] =
            [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| world_from_body.rotate(axis));
        Self {
            position_m: world_from_body.translation_m(),
            yaw_rad: libm::atan2(forward[1], forward[0]),
            pitch_rad: -libm::asin(forward[2].clamp(-1.0, 1.0)),
            roll_rad: libm::atan2(left[2], up[2]),
            ..*self
        }
    }

    /// Pose of the body: x forward, y left, z up, with yaw, pitch and roll in that order.
    pub fn world_from_body(&self) -> RigidTransform {
        let rotation = so3::from_yaw_pitch_roll(self.yaw_rad, self.pitch_rad, self.roll_rad);
        RigidTransform::from_wxyz(
            [rotation.w, rotation.i, rotation.j, rotation.k],
            self.position_m,
        )
        .unwrap_or_else(|_| RigidTransform::identity())
    }
}
