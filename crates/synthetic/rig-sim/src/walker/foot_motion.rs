//! Motion of a foot: the rolls over heel and toe in stance, and the swing between them.
//!
//! In the swing the pitch of the foot goes on from that of the roll-off, reaches its maximum soon
//! after toe-off, and falls through zero at two thirds of the swing. The height of the sole's
//! middle follows from the pitch and the clearance of the lowest point, so the toe leaves the
//! ground from where it was and passes it closely at mid-swing.

use nalgebra::{UnitQuaternion, Vector3};

use super::curves::{running_share, smooth, vigour};
use super::foot_state::{FootState, Phase};
use super::gait::{Footfall, GroundFn, HEEL_X, TIP_X, TOE_X};
use cad_transforms::so3;

/// Pitch rate at toe-off relative to the mean rate of the roll-off, and its maximum, rad/s.
const OFF_RATE_RATIO: f64 = 1.6;
const MAX_OFF_RATE: f64 = 8.0;
/// Deceleration of the pitch after toe-off at a usual speed, rad/s².
const OFF_DECELERATION: f64 = 60.0;
/// Additional clearance of the toe soon after toe-off, m.
const HUMP_M: f64 = 0.015;
/// Additional clearance of a running foot, m.
const RUNNING_CLEARANCE_M: f64 = 0.05;
/// Radius of the transition from the toe to the heel as the lowest point, m.
const ROUNDING_M: f64 = 0.03;
/// Maximum lift over obstacles, m.
const MAX_LIFT_M: f64 = 0.45;

/// Polynomial of degree five from and to a value with its first two derivatives.
fn quintic(from: [f64; 3], to: [f64; 3], t: f64) -> f64 {
    let [c0, c1, c2] = [from[0], from[1], 0.5 * from[2]];
    let a = to[0] - (c0 + c1 + c2);
    let b = to[1] - (c1 + 2.0 * c2);
    let c = to[2] - 2.0 * c2;
    let (c3, c4, c5) = (
        10.0 * a - 4.0 * b + 0.5 * c,
        -15.0 * a + 7.0 * b - c,
        6.0 * a - 3.0 * b + 0.5 * c,
    );
    c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
}

/// Polynomial of degree three from and to a value with its derivative; the last one is 0.
fn cubic(from: [f64; 2], to: f64, t: f64) -> f64 {
    let rest = 1.0 - t;
    rest * rest * ((1.0 + 2.0 * t) * from[0] + t * from[1]) + t * t * (3.0 - 2.0 * t) * to
}

/// A foot at rest, rotated by `pitch` about a point of its sole.
fn rolled(fall: &Footfall, pivot_x: f64, pitch: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let turn = so3::exp(Vector3::y() * pitch);
    let pivot = Vector3::new(pivot_x, 0.0, 0.0);
    let rotation = fall.rotation * turn;
    (
        fall.position + fall.rotation * pivot - rotation * pivot,
        rotation,
    )
}

/// Pitch rate at the end of a roll-off, rad/s.
fn off_rate(fall: &Footfall) -> f64 {
    let seconds = fall.off_s - fall.flat_phase().1;
    (OFF_RATE_RATIO * fall.off_pitch_rad / seconds).min(MAX_OFF_RATE)
}

/// A foot on the ground.
pub(super) fn standing(fall: &Footfall, time_s: f64) -> FootState {
    let (flat_from, flat_to) = fall.flat_phase();
    let (position, rotation, phase) = if time_s < flat_from {
        let t = (time_s - fall.strike_s) / (flat_from - fall.strike_s);
        let (p, r) = rolled(fall, HEEL_X, fall.strike_pitch_rad * (1.0 - smooth(t)));
        (p, r, Phase::Heel)
    } else if time_s <= flat_to || fall.off_s.is_infinite() {
        (fall.position, fall.rotation, Phase::Flat)
    } else {
        let seconds = fall.off_s - flat_to;
        let end = [fall.off_pitch_rad, off_rate(fall) * seconds, 0.0];
        let pitch = quintic([0.0; 3], end, (time_s - flat_to) / seconds);
        let (p, r) = rolled(fall, TIP_X, pitch);
        (p, r, Phase::Toe)
    };
    FootState {
        position,
        rotation,
        phase,
    }
}

/// Height of the sole's middle above its lowest point; smooth, and up to [`ROUNDING_M`] too large
/// where heel and toe are equally low.
fn height_above_lowest_point(pitch: f64, toe_x: f64) -> f64 {
    let s = libm::sin(pitch);
    let (mean, half) = (0.5 * (toe_x + HEEL_X), 0.5 * (toe_x - HEEL_X));
    mean * s + (half * half * s * s + ROUNDING_M * ROUNDING_M).sqrt()
}

/// Clearance of the lowest point of the sole over flat ground, m.
fn clearance(to: &Footfall, t: f64) -> f64 {
    let running = RUNNING_CLEARANCE_M * running_share(to.speed);
    let hump = (t / 0.2 * (1.0 - t / 0.4).max(0.0)).min(1.0);
    (to.clearance_m + running) * smooth(t / 0.25) * smooth((1.0 - t) / 0.2)
        + HUMP_M * vigour(to.speed) * hump * hump
}

/// How a foot clears what is between two footfalls.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Avoidance {
    /// Additional height in the middle of the swing, m; 0 on flat ground.
    lift_m: f64,
    /// Share of the swing in which a foot that goes down does not sink yet, and one that goes up
    /// has risen already.
    level: f64,
}

/// Weight of the lift over the swing.
fn bump(t: f64) -> f64 {
    16.0 * (t * (1.0 - t)).powi(2)
}

/// A foot in the air, in a step or a jump, at a time as a ratio of the swing.
pub(super) fn swinging(from: &Footfall, to: &Footfall, avoidance: &Avoidance, t: f64) -> FootState {
    if to.jump_m > 0.0 {
        return FootState {
            position: from.position.lerp(&to.position, t)
                + Vector3::z() * (4.0 * to.jump_m * t * (1.0 - t)),
            rotation: from.rotation,
            phase: Phase::Swing,
        };
    }
    let seconds = to.strike_s - from.off_s;
    let (p0, _) = rolled(from, TIP_X, from.off_pitch_rad);
    let (p1, _) = rolled(to, HEEL_X, to.strike_pitch_rad);
    let rate = off_rate(from);
    let deceleration = OFF_DECELERATION * vigour(from.speed);
    let begin = [
        from.off_pitch_rad,
        rate * seconds,
        -deceleration * seconds * seconds,
    ];
    let pitch = quintic(begin, [to.strike_pitch_rad, 0.0, 0.0], t);

    // Upstairs a foot rises before it goes ahead, downstairs it goes ahead before it sinks.
    let rise = to.position.z - from.position.z;
    let climb = (rise / 0.25).clamp(-1.0, 1.0);
    let level = avoidance.level;
    let up = match climb > 0.0 {
        true => smooth(t / (1.0 - level)),
        false => smooth((t - level) / (1.0 - level)),
    };
    let over = t - (0.12 * climb + to.delay) * bump(t);
    // The velocity of the middle as the foot rotates about its toe.
    let off = from.off_pitch_rad;
    let arm = Vector3::new(libm::sin(off), 0.0, libm::cos(off)) * TIP_X;
    let velocity = from.rotation * arm * (rate * seconds);
    let [x, y] = [0, 1].map(|k| cubic([p0[k], velocity[k]], p1[k], over));

    let toe_x = TIP_X + (TOE_X - TIP_X) * smooth(t / 0.15);
    let base = |pitch: f64, toe_x: f64| height_above_lowest_point(pitch, toe_x);
    let lifted = clearance(to, t) + avoidance.lift_m * bump(t);
    let sole = from.position.z + rise * up + base(pitch, toe_x) + lifted;
    // What the height lacks at its ends: slopes, and the rounding.
    let begins = p0.z - from.position.z - base(off, TIP_X);
    let ends = p1.z - to.position.z - base(to.strike_pitch_rad, TOE_X);
    let z = sole + begins * (1.0 - smooth(t / 0.3)) + ends * smooth((t - 0.6) / 0.4);

    let turn = so3::log(&(from.rotation.inverse() * to.rotation)) * smooth(t);
    FootState {
        position: Vector3::new(x, y, z),
        rotation: from.rotation * so3::exp(turn) * so3::exp(Vector3::y() * pitch),
        phase: Phase::Swing,
    }
}

/// The smallest lift with which a foot clears everything between two footfalls, and when it has to
/// rise or sink for that.
pub(super) fn avoid(from: &Footfall, to: &Footfall, ground: &GroundFn<'_>) -> Avoidance {
    let rise = (to.position.z - from.position.z).abs();
    let needed = |level: f64| Avoidance {
        level,
        lift_m: lift(from, to, level, ground),
    };
    let mut least = needed(0.4 * (rise / 0.25).min(1.0));
    for level in [0.25, 0.4, 0.55, 0.7] {
        if least.lift_m > 0.0 && rise > 0.03 {
            let other = needed(level);
            // An early or late change of height is a fast one.
            if other.lift_m < 0.7 * least.lift_m {
                least = other;
            }
        }
    }
    least
}

fn lift(from: &Footfall, to: &Footfall, level: f64, ground: &GroundFn<'_>) -> f64 {
    let below = from.position.z.max(to.position.z) + 0.5;
    let straight = Avoidance { lift_m: 0.0, level };
    let mut lift = 0.0_f64;
    for k in 6..=37 {
        let t = f64::from(k) / 40.0;
        let foot = swinging(from, to, &straight, t);
        for x in [HEEL_X, 0.0, TOE_X] {
            let p = foot.position + foot.rotation * Vector3::new(x, 0.0, 0.0);
            if let Some(height) = ground(p.x, p.y, below) {
                let needed = height + 0.6 * clearance(to, t) - p.z;
                lift = lift.max(needed / bump(t));
            }
        }
    }
    lift.min(MAX_LIFT_M)
}
