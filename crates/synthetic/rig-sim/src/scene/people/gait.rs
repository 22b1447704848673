//! Motion of a person's feet and hips along a path, by the distance walked.
//!
//! Contract: a standing foot only rolls: over the heel when it lands, over the ball before it lifts
//! off. In between it swings forward above the ground. Poses are continuous in the distance.

use nalgebra::{UnitQuaternion, Vector3};

use super::{BALL, HEEL, SHIN, SOLE, THIGH, pitch, sign};
use crate::walker::Side;
use crate::walker::path::Path;
use cad_transforms::so3;

/// Stance phase as a fraction of a stride (Perry 1992).
const STANCE: f64 = 0.62;
/// Pitch of a foot at landing and lift-off, rad; it is flat between these fractions of a stride.
const LANDING_PITCH: f64 = -0.3;
const LIFT_OFF_PITCH: f64 = 0.7;
const FLAT_PHASE: [f64; 2] = [0.1, 0.38];
/// Offset of the foot behind the middle of the ground that the body covers during stance, as a
/// fraction of a stride.
const CENTER_OFFSET: f64 = 0.06;
/// Distance of a foot from the line, m.
const STANCE_HALF_WIDTH_M: f64 = 0.065;
/// Lift of the ankle in the swing, m.
const LIFT_M: f64 = 0.055;
/// Maximum extension of a leg as a fraction of its length.
const MAX_LEG_EXTENSION: f64 = 0.985;
/// Vertical motion of the hips, m.
const HIP_BOB_M: f64 = 0.042;

/// Gait of a person of 1.75 m times `scale`, with strides of `stride_m`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gait {
    pub(super) stride_m: f64,
    pub(super) scale: f64,
}

/// Pose of a foot: its ankle, and the rotation of its axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Foot {
    pub(super) ankle: Vector3<f64>,
    pub(super) rotation: UnitQuaternion<f64>,
}

/// Smooth step from 0 to 1.
fn ease(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl Gait {
    /// Number of strides of a foot, counted from its landings.
    fn strides(&self, side: Side, walked_m: f64) -> f64 {
        let half = match side {
            Side::Left => 0.0,
            Side::Right => 0.5,
        };
        walked_m / self.stride_m + half
    }

    /// Phase: fraction of a stride since the foot landed.
    pub(super) fn phase(&self, side: Side, walked_m: f64) -> f64 {
        let strides = self.strides(side, walked_m);
        strides - strides.floor()
    }

    /// Whether the foot is in stance.
    #[cfg(test)]
    pub(super) fn stands(&self, side: Side, walked_m: f64) -> bool {
        self.phase(side, walked_m) < STANCE
    }

    /// Pose of a standing foot at a phase of a stride that began at the distance `began`.
    fn standing(&self, path: &Path, side: Side, began: f64, phase: f64) -> Foot {
        let ([x, y], [dx, dy]) = path.at(began + self.stride_m * (0.5 * STANCE - CENTER_OFFSET));
        let heading = so3::exp(Vector3::z() * libm::atan2(dy, dx));
        let aside = Vector3::y() * (sign(side) * STANCE_HALF_WIDTH_M);
        let flat = Vector3::new(x, y, 0.0) + heading * (aside + Vector3::z() * SOLE) * self.scale;
        let (pivot, roll) = if phase < FLAT_PHASE[0] {
            (HEEL, LANDING_PITCH * (1.0 - ease(phase / FLAT_PHASE[0])))
        } else {
            let late = (phase - FLAT_PHASE[1]) / (STANCE - FLAT_PHASE[1]);
            (BALL, LIFT_OFF_PITCH * late.max(0.0) * late.max(0.0))
        };
        let rotation = heading * pitch(roll);
        let pivot = Vector3::new(pivot, 0.0, -SOLE) * self.scale;
        Foot {
            ankle: flat + heading * pivot - rotation * pivot,
            rotation,
        }
    }

    /// Pose of a foot at a distance walked.
    pub(super) fn foot(&self, path: &Path, side: Side, walked_m: f64) -> Foot {
        let phase = self.phase(side, walked_m);
        let began = walked_m - self.stride_m * phase;
        if phase < STANCE {
            return self.standing(path, side, began, phase);
        }
        let from = self.standing(path, side, began, STANCE);
        let to = self.standing(path, side, began + self.stride_m, 0.0);
        let part = (phase - STANCE) / (1.0 - STANCE);
        // Smooth at lift-off and landing, with some initial speed.
        let moved = 0.3 * part + 0.7 * ease(part);
        let up = LIFT_M * self.scale * 4.0 * part * (1.0 - part);
        Foot {
            ankle: from.ankle + (to.ankle - from.ankle) * moved + Vector3::z() * up,
            rotation: from.rotation.slerp(&to.rotation, ease(1.15 * part)),
        }
    }

    /// Height of the hips at a distance walked, m: lowest in double support, such that the front
    /// leg is straight.
    pub(super) fn hips(&self, walked_m: f64) -> f64 {
        let (leg, ahead) = (
            MAX_LEG_EXTENSION * (THIGH + SHIN),
            self.stride_m / self.scale * (0.5 * STANCE - CENTER_OFFSET),
        );
        let least = SOLE + (leg * leg - ahead * ahead).max(0.0).sqrt();
        let turn = 4.0 * std::f64::consts::PI * (self.phase(Side::Left, walked_m) - 0.06);
        self.scale * (least + HIP_BOB_M * (0.5 - 0.5 * libm::cos(turn)))
    }

    /// Forward position of the leg, from -1 to 1.
    pub(super) fn swing(&self, side: Side, walked_m: f64) -> f64 {
        libm::cos(2.0 * std::f64::consts::PI * self.phase(side, walked_m))
    }
}

/// Rotations of thigh and shin between a hip joint and an ankle, the knee forward.
pub(super) fn leg(
    hip: &Vector3<f64>,
    ankle: &Vector3<f64>,
    heading: &UnitQuaternion<f64>,
    scale: f64,
) -> [UnitQuaternion<f64>; 2] {
    let (thigh, shin) = (THIGH * scale, SHIN * scale);
    let reach = ankle - hip;
    let length = reach.norm().min(0.9999 * (thigh + shin));
    let up = -reach.normalize();
    let left = heading * Vector3::y();
    let forward = left.cross(&up).normalize();
    let axes = nalgebra::Matrix3::from_columns(&[forward, up.cross(&forward), up]);
    let line =
        UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(axes));
    let corner = |a: f64, b: f64, across: f64| {
        libm::acos(((a * a + b * b - across * across) / (2.0 * a * b)).clamp(-1.0, 1.0))
    };
    let thigh_turn = line * pitch(-corner(thigh, length, shin));
    let knee = std::f64::consts::PI - corner(thigh, shin, length);
    [thigh_turn, thigh_turn * pitch(knee)]
}
