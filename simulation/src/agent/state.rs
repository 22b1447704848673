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

impl AgentState {
    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        let angles = [self.yaw_rad, self.pitch_rad, self.roll_rad];
        let numbers = self.position_m.iter().chain(&self.velocity).chain(&angles);
        numbers.copied().all(f64::is_finite)
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
