//! Wearers whose feet move by the joint angles of their legs, to examine the motion that crate
//! `feet` assumes with another one.
//!
//! Contract: hip, knee and ankle follow mean curves over the gait cycle, scaled and shifted by
//! wearer and varied by step; the foot hangs at the end of the leg. Between heel off and toe off it
//! turns about its toe, between heel strike and foot flat about its heel, and in between the motion
//! of the leg is corrected smoothly so that it begins and ends there. Nothing here is shared with
//! the simulator's own swing or with `feet::swing`: neither shapes nor numbers.
//!
//! Source of the curves, in the sagittal plane at a self-selected speed, read off to about two
//! degrees: Winter, "The Biomechanics and Motor Control of Human Gait", 2nd ed., 1991, and Kadaba,
//! Ramakrishnan, Wootten, "Measurement of lower extremity kinematics during level walking",
//! J. Orthop. Res. 8, 1990. The thigh is relative to the vertical. Lengths of thigh and shank are
//! 0.245 and 0.246 of the body height: Drillis and Contini, 1966.

use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};
use rig_sim::walker::gait::GroundFn;
use rig_sim::walker::gait_model::{FootMotion, GaitModel};
use rig_sim::walker::{Footfall, GaitProfile, Side};

/// Samples of a cycle, every 5 %.
const SAMPLES: usize = 20;
/// Thigh, degrees: positive with the knee ahead of the hip.
const THIGH: [f64; SAMPLES] = [
    22.5, 22.0, 20.0, 16.0, 11.0, 6.0, 1.0, -4.0, -8.5, -12.5, -15.0, -14.5, -9.0, -0.5, 8.5, 16.0,
    21.5, 24.0, 24.5, 23.5,
];
/// Flexion of the knee, degrees.
const KNEE: [f64; SAMPLES] = [
    4.0, 11.0, 17.0, 18.5, 16.5, 12.5, 9.0, 6.0, 5.0, 7.0, 13.5, 24.5, 40.0, 54.5, 62.0, 59.5,
    47.0, 29.0, 12.0, 3.5,
];
/// Ankle, degrees: positive with the toe up.
const ANKLE: [f64; SAMPLES] = [
    0.5, -5.5, -4.0, 0.5, 4.0, 6.0, 7.5, 8.5, 9.5, 9.5, 5.5, -5.0, -16.5, -17.0, -9.5, -3.5, 0.0,
    1.5, 1.5, 1.0,
];
/// Toe off of the curves, as a share of the cycle.
const TOE_OFF: f64 = 0.62;
/// Lengths of limbs as shares of the body height.
const LIMBS: [f64; 2] = [0.245, 0.246];
/// The ankle in the frame of the foot, m, and the points about which it turns, ahead of its origin.
const ANKLE_M: [f64; 2] = [-0.065, 0.085];
const TOE_PIVOT_M: f64 = 0.145;
const HEEL_PIVOT_M: f64 = -0.13;
/// Points of the sole that have to clear the ground, ahead of its origin, m.
const SOLE_M: [f64; 4] = [-0.13, -0.03, 0.06, 0.15];
/// Speed above which people run and these curves do not hold, m/s.
const RUNNING: f64 = 1.8;
/// Parts of a swing for which the correction of its height is known.
const LIFT_NODES: usize = 50;
/// Share of a swing over which that correction is smoothed: on level ground and from one height to
/// another.
const LIFT_WIDTHS: [f64; 2] = [0.06, 0.22];
/// Difference of the heights of two contacts from which on the second one holds, m.
const STEP_M: f64 = 0.1;
/// Share of a swing at its ends over which it begins and ends.
const LIFT_END: f64 = 0.16;
/// How much higher the sole is at a quarter and at three quarters of a swing than in its middle, m.
const LIFT_SIDES_M: f64 = 0.015;
/// Maximum correction, m.
const MAX_LIFT_M: f64 = 0.4;

/// A wearer.
#[derive(Clone, Copy, Debug)]
pub(super) struct JointGait {
    pub(super) height_m: f64,
    /// Steps per second relative to the mean of people of this height.
    pub(super) cadence_ratio: f64,
    /// Share of stance in a stride minus its mean.
    pub(super) duty_offset: f64,
    /// Angle of both feet outwards, rad.
    pub(super) toe_out_rad: [f64; 2],
    /// Excursions of thigh, knee and ankle relative to the mean curves.
    pub(super) excursions: [f64; 3],
    /// Share of the cycle by which the knee bends later.
    pub(super) knee_delay: f64,
    /// Height of the toe at its lowest in the middle of the swing, m.
    pub(super) clearance_m: f64,
    /// From heel strike to foot flat, and from heel off to toe off, s.
    pub(super) rolls_s: [f64; 2],
    /// How far the foot swings outwards, m, and turns outwards, rad.
    pub(super) circumduction: [f64; 2],
}

impl GaitModel for JointGait {
    fn profile(&self, drawn: GaitProfile) -> GaitProfile {
        let mut profile = drawn;
        profile.height_m = self.height_m;
        profile.cadence_ratio = self.cadence_ratio;
        profile.duty_offset = self.duty_offset;
        profile.toe_out_rad = self.toe_out_rad;
        profile
    }

    fn rolls_s(&self, fall: &Footfall) -> [f64; 2] {
        let vary = |stream: u64| 1.0 + 0.08 * variation(fall, stream);
        [self.rolls_s[0] * vary(1), self.rolls_s[1] * vary(2)]
    }

    fn motion(
        &self,
        from: &Footfall,
        to: &Footfall,
        ground: &GroundFn<'_>,
    ) -> Option<Arc<dyn FootMotion>> {
        if from.speed.max(to.speed) > RUNNING || to.jump_m > 0.0 {
            return None;
        }
        Some(Arc::new(Step::new(self, from, to, ground)))
    }
}

/// Between -1 and 1 and about 0.5 in the mean square, by footfall and stream.
fn variation(fall: &Footfall, stream: u64) -> f64 {
    // Mixing of Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014.
    let mut bits = fall.position.x.to_bits() ^ fall.position.y.to_bits().rotate_left(17);
    bits = bits.wrapping_add(stream.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^= bits >> 31;
    2.0 * (bits >> 11) as f64 / (1_u64 << 53) as f64 - 1.0
}

/// Ankle relative to the hip (forward, up), m, and the angle of the foot, toe up, rad.
#[derive(Clone, Copy, Debug)]
struct Hanging {
    ahead: f64,
    up: f64,
    pitch: f64,
}

/// Motion from one footfall to the next of the same foot.
#[derive(Clone, Debug)]
struct Step {
    from: Footfall,
    to: Footfall,
    flat_to_s: f64,
    flat_from_s: f64,
    excursions: [f64; 3],
    knee_delay: f64,
    limbs_m: [f64; 2],
    /// Horizontal displacement, and its direction.
    stride_m: f64,
    ahead: Vector3<f64>,
    outward: Vector3<f64>,
    /// Bend of the phase over time, so that toe off comes at its phase of the curves.
    bend: f64,
    /// Position of the middle of the sole minus that by the leg, at toe off and heel strike, and
    /// the derivative of that by the share of the swing.
    corrections: [[Vector3<f64>; 2]; 2],
    circumduction: [f64; 2],
    /// Corrections of the height over a swing, m, and the share of it over which they are smoothed.
    lifts_m: Vec<f64>,
    lift_width: f64,
    clearance_m: f64,
}

impl Step {
    fn new(wearer: &JointGait, from: &Footfall, to: &Footfall, ground: &GroundFn<'_>) -> Self {
        let level = |v: Vector3<f64>| Vector3::new(v.x, v.y, 0.0);
        let stride = level(to.position - from.position);
        let toe = level(from.rotation * Vector3::x());
        let ahead = match stride.norm() > 0.15 {
            true => stride.normalize(),
            false => toe.normalize(),
        };
        let left = Vector3::z().cross(&ahead);
        let vary = |stream: u64, size: f64| 1.0 + size * variation(from, stream);
        // Short steps bend the hip less, and the knee a little.
        let stride_m = stride.norm();
        let long = (stride_m / (0.75 * wearer.height_m)).min(1.15);
        let off_share = (from.off_s - from.strike_s) / (to.strike_s - from.strike_s);
        let rise_m = (to.position.z - from.position.z).abs();
        let mut step = Self {
            from: *from,
            to: *to,
            flat_to_s: from.flat_phase().1,
            flat_from_s: to.flat_phase().0,
            excursions: [
                wearer.excursions[0] * long * vary(3, 0.05),
                wearer.excursions[1] * (0.55 + 0.45 * long) * vary(4, 0.05),
                wearer.excursions[2] * (0.4 + 0.6 * long) * vary(5, 0.08),
            ],
            knee_delay: wearer.knee_delay + 0.008 * variation(from, 6),
            limbs_m: LIMBS.map(|share| share * wearer.height_m),
            stride_m,
            ahead,
            outward: match from.side {
                Side::Left => left,
                Side::Right => -left,
            },
            bend: bend(off_share),
            corrections: [[Vector3::zeros(); 2]; 2],
            circumduction: wearer.circumduction.map(|size| size * vary(7, 0.3)),
            lifts_m: Vec::new(),
            lift_width: LIFT_WIDTHS[usize::from(rise_m > STEP_M)],
            clearance_m: wearer.clearance_m * vary(8, 0.25),
        };
        step.corrections = step.corrections();
        step.lifts_m = step.lifts(ground);
        step
    }

    /// Phase of the cycle at a time; beyond 1 after the next heel strike.
    fn phase(&self, time_s: f64) -> f64 {
        let share = (time_s - self.from.strike_s) / (self.to.strike_s - self.from.strike_s);
        // The first contact of a walk has lasted for long.
        let share = share.max(0.0);
        share + self.bend * share * (1.0 - share)
    }

    fn hanging(&self, time_s: f64) -> Hanging {
        let phase = self.phase(time_s);
        let [a, b, c] = self.excursions;
        let thigh = a * curve(&THIGH, phase);
        let shank = thigh - b * curve(&KNEE, phase - self.knee_delay);
        let [l, m] = self.limbs_m;
        Hanging {
            ahead: l * libm::sin(thigh) + m * libm::sin(shank),
            up: -l * libm::cos(thigh) - m * libm::cos(shank),
            pitch: shank + c * curve(&ANKLE, phase),
        }
    }

    /// Angle of the foot to the ground, toe up.
    fn pitch(&self, time_s: f64) -> f64 {
        let own = |t: f64| self.hanging(t).pitch;
        let (off_s, strike_s) = (self.from.off_s, self.to.strike_s);
        let rest = own(self.flat_to_s);
        let landed = own(self.flat_from_s);
        let leaving = 1.0 - ease((time_s - self.flat_to_s) / (off_s - self.flat_to_s));
        let landing = ease((time_s - strike_s) / (self.flat_from_s - strike_s));
        let pitch = own(time_s) - rest * leaving - landed * landing;
        match time_s {
            t if t <= off_s => pitch.min(0.0),
            t if t >= strike_s => pitch.max(0.0) * (1.0 - landing),
            _ => pitch,
        }
    }

    fn swing_share(&self, time_s: f64) -> f64 {
        (time_s - self.from.off_s) / (self.to.strike_s - self.from.off_s)
    }

    fn rotation(&self, time_s: f64) -> UnitQuaternion<f64> {
        let share = ease(self.swing_share(time_s));
        let level = self.from.rotation.slerp(&self.to.rotation, share);
        let side = match self.from.side {
            Side::Left => 1.0,
            Side::Right => -1.0,
        };
        let yaw = side * self.circumduction[1] * bump(self.swing_share(time_s));
        level
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw)
            * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -self.pitch(time_s))
    }

    /// Middle of the sole of a foot that turns about a point of it on the ground.
    fn pivoted(&self, fall: &Footfall, pivot_m: f64, time_s: f64) -> Vector3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -self.pitch(time_s));
        let pivot = Vector3::x() * pivot_m;
        fall.position + fall.rotation * (pivot - turn * pivot)
    }

    /// Middle of the sole at the end of the leg, whose hip goes ahead steadily.
    fn hung(&self, time_s: f64) -> Vector3<f64> {
        let share = (time_s - self.from.strike_s) / (self.to.strike_s - self.from.strike_s);
        let leg = self.hanging(time_s);
        let ankle = self.from.position
            + self.ahead * (self.stride_m * share.max(0.0) + leg.ahead)
            + Vector3::z() * leg.up;
        ankle - self.rotation(time_s) * Vector3::new(ANKLE_M[0], 0.0, ANKLE_M[1])
    }

    fn corrections(&self) -> [[Vector3<f64>; 2]; 2] {
        const STEP_S: f64 = 1e-4;
        let seconds = self.to.strike_s - self.from.off_s;
        let rise = Vector3::z() * (self.to.position.z - self.from.position.z);
        let off = |t: f64| self.pivoted(&self.from, TOE_PIVOT_M, t) - self.hung(t);
        let landed = |t: f64| self.pivoted(&self.to, HEEL_PIVOT_M, t) - self.hung(t) - rise;
        let (off_s, strike_s) = (self.from.off_s, self.to.strike_s);
        let leaving = (off(off_s) - off(off_s - STEP_S)) * (seconds / STEP_S);
        // The heel comes down with some speed: its horizontal one is what the leg says.
        let landing = (landed(strike_s + STEP_S) - landed(strike_s)) * (0.6 * seconds / STEP_S);
        [[off(off_s), leaving], [landed(strike_s), landing]]
    }

    fn swung(&self, time_s: f64) -> Vector3<f64> {
        let t = self.swing_share(time_s);
        let [[a, da], [b, db]] = self.corrections;
        let (t2, t3) = (t * t, t * t * t);
        let correction = a * (2.0 * t3 - 3.0 * t2 + 1.0)
            + da * (t3 - 2.0 * t2 + t)
            + b * (3.0 * t2 - 2.0 * t3)
            + db * (t3 - t2);
        let rise = self.to.position.z - self.from.position.z;
        let early = 0.45 * (rise.abs() / 0.15).min(1.0);
        let risen = match rise > 0.0 {
            true => ease(t / (1.0 - early)),
            false => ease((t - early) / (1.0 - early)),
        };
        self.hung(time_s)
            + correction
            + self.outward * (self.circumduction[0] * bump(t))
            + Vector3::z() * (rise * risen + self.lift(t))
    }

    /// Corrections of the height with which the lowest point of the sole is as high as the
    /// wearer's usually is over the ground and its edges; negative where the leg lifts it higher.
    fn lifts(&self, ground: &GroundFn<'_>) -> Vec<f64> {
        let below = self.from.position.z.max(self.to.position.z) + 0.5;
        let seconds = self.to.strike_s - self.from.off_s;
        let missing = |k: usize| {
            let share = k as f64 / LIFT_NODES as f64;
            let time_s = self.from.off_s + share * seconds;
            let (middle, rotation) = (self.swung(time_s), self.rotation(time_s));
            let of_point = |x: &f64| {
                let point = middle + rotation * (Vector3::x() * *x);
                Some(ground(point.x, point.y, below)? - point.z)
            };
            let quarters = libm::sin(2.0 * std::f64::consts::PI * share).powi(2);
            let clearance = self.clearance_m + LIFT_SIDES_M * quarters;
            let deepest = SOLE_M.iter().filter_map(of_point).reduce(f64::max);
            deepest.map_or(0.0, |deepest| deepest + clearance)
        };
        let missing: Vec<f64> = (0..=LIFT_NODES).map(missing).collect();
        // Over edges the highest neighbor counts.
        let around = (0.5 * self.lift_width * LIFT_NODES as f64).round() as usize;
        let highest = |k: usize| {
            let near = &missing[k.saturating_sub(around)..=(k + around).min(LIFT_NODES)];
            near.iter().copied().fold(f64::NEG_INFINITY, f64::max)
        };
        (0..=LIFT_NODES)
            .map(|k| highest(k).clamp(-MAX_LIFT_M, MAX_LIFT_M))
            .collect()
    }

    /// Correction of the height at a share of the swing.
    fn lift(&self, share: f64) -> f64 {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (k, lift) in self.lifts_m.iter().enumerate() {
            let distance = share - k as f64 / LIFT_NODES as f64;
            let weight = 1.0 - ease(distance.abs() / self.lift_width);
            sum += weight * lift;
            weights += weight;
        }
        let ends = ease(share / LIFT_END) * ease((1.0 - share) / LIFT_END);
        match weights > 0.0 {
            true => ends * sum / weights,
            false => 0.0,
        }
    }
}

impl FootMotion for Step {
    fn pose(&self, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let position = match time_s {
            t if t <= self.from.off_s => self.pivoted(&self.from, TOE_PIVOT_M, t),
            t if t >= self.to.strike_s => self.pivoted(&self.to, HEEL_PIVOT_M, t),
            t => self.swung(t),
        };
        (position, self.rotation(time_s))
    }
}

/// Bend of the phase that maps a share of the stride to toe off of the curves.
fn bend(off_share: f64) -> f64 {
    let off_share = off_share.clamp(0.3, 0.9);
    ((TOE_OFF - off_share) / (off_share * (1.0 - off_share))).clamp(-0.7, 0.7)
}

/// Periodic cubic interpolation of a curve, rad.
fn curve(samples: &[f64; SAMPLES], phase: f64) -> f64 {
    let place = phase.rem_euclid(1.0) * SAMPLES as f64;
    let k = place as usize % SAMPLES;
    let t = place - place.floor();
    let at = |offset: usize| samples[(k + SAMPLES + offset - 1) % SAMPLES];
    let [a, b, c, d] = [0, 1, 2, 3].map(at);
    let value =
        b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)));
    value.to_radians()
}

/// From 0 to 1 without speed at the ends.
fn ease(t: f64) -> f64 {
    0.5 - 0.5 * libm::cos(std::f64::consts::PI * t.clamp(0.0, 1.0))
}

/// 0 at the ends without speed, 1 in the middle.
fn bump(t: f64) -> f64 {
    libm::sin(std::f64::consts::PI * t.clamp(0.0, 1.0)).powi(2)
}

#[cfg(test)]
mod tests;
