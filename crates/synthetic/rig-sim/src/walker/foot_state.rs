//! Where a foot is, and what bears on the ground.

use nalgebra::{UnitQuaternion, Vector3};

/// Pose of a foot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootState {
    /// Middle of the sole, in the world, m.
    pub position: Vector3<f64>,
    /// Maps the foot frame (x forward, y left, z up from the sole) to the world.
    pub rotation: UnitQuaternion<f64>,
    /// What bears on the ground.
    pub phase: Phase,
}

/// Part of a sole that bears on the ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// From heel strike to foot flat: the foot rolls over the heel.
    Heel,
    /// From foot flat to heel off: the whole sole, at rest.
    Flat,
    /// From heel off to toe off: the foot rolls over the toe.
    Toe,
    /// From toe off to heel strike: nothing.
    Swing,
}

impl Phase {
    /// `heel`, `flat`, `toe` or `swing`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Heel => "heel",
            Self::Flat => "flat",
            Self::Toe => "toe",
            Self::Swing => "swing",
        }
    }
}
