//! Footfalls: which foot lands when and where.
//!
//! Steps are planned in sequence. The duration of the next one follows from the speed, its position
//! from the future position of the body, corrected slightly where the sole would not rest (edges of
//! kerbs and stairs); the foot lands when the body is there, so on stairs each step takes one tread
//! and the time that this needs. Cadence, stance and their variation are those of the wearer's
//! [`GaitProfile`].

use nalgebra::{UnitQuaternion, Vector3};

use super::curves::{running_share, vigour};
use super::path::Path;
use super::profile::{GaitProfile, StepVariation};
use super::progress::Progress;
use super::side::Side;
use cad_transforms::so3;

/// From the strike until the whole sole is down, s.
const ROLL_DOWN_S: f64 = 0.08;
/// From heel lift until toe-off, s.
const ROLL_OFF_S: f64 = 0.2;
/// Heel of the sole, m in front of its middle.
pub(crate) const HEEL_X: f64 = -0.13;
/// Axis of the roll-off, m: near the toe, since this sole does not bend.
pub(crate) const TIP_X: f64 = 0.135;
/// Front end of the sole, m.
pub(crate) const TOE_X: f64 = 0.15;
/// Half the width of the sole, m.
pub(crate) const HALF_WIDTH: f64 = 0.045;
/// Number of rows in which the ground under a sole is sampled.
const ALONG: usize = 9;
/// Margin around the ends of a sole, m.
const MARGIN_M: f64 = 0.012;
/// Distance behind the heel in which an edge would be scraped, m, its height above the sole, m, and
/// the cost of it, m.
const SCRAPE_M: f64 = 0.06;
const SCRAPE_HEIGHT_M: f64 = 0.04;
const SCRAPE_COST_M: f64 = 0.1;
/// Maximum depth of supporting ground below the highest point under the sole, m.
const EDGE_M: f64 = 0.06;
/// Cost of a sole that juts out with all of its length, m.
const JUTTING_COST_M: f64 = 0.2;
/// Cost of an unstable foothold, m: more than any unevenness.
const UNSTABLE_COST_M: f64 = 1.0;
/// Preferred maximum step height, m: one stair, not two.
const MAX_STEP_UP_M: f64 = 0.22;
/// Minimum walking speed, m/s; below it the wearer stands.
const STANDING: f64 = 0.15;

/// One contact of a foot with the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footfall {
    /// Which foot.
    pub side: Side,
    /// The heel meets the ground, s.
    pub strike_s: f64,
    /// The toe leaves it, s; infinite for the last one.
    pub off_s: f64,
    /// Middle of the sole at rest, in the world, m.
    pub position: Vector3<f64>,
    /// Maps the foot frame (x forward, y left, z up from the sole) at rest to the world.
    pub rotation: UnitQuaternion<f64>,
    /// Speed of walking at the strike, m/s.
    pub speed: f64,
    /// Pitch at the strike, about the heel, rad; negative: toe up.
    pub strike_pitch_rad: f64,
    /// Pitch when the toe leaves the ground, about the toe, rad.
    pub off_pitch_rad: f64,
    /// Smallest height of the toe over flat ground in the middle of the swing before, m.
    pub clearance_m: f64,
    /// Shift of the horizontal speed to later times in the swing before, as a ratio of the swing.
    pub delay: f64,
    /// Height of the jump before, m; 0 for a step.
    pub jump_m: f64,
    /// From the strike until the whole sole is down, and from heel off until toe off, s, unless the
    /// contact is too short for that.
    pub rolls_s: [f64; 2],
}

impl Footfall {
    /// Time span in which the whole sole is down and at rest, s; empty in a quick run.
    pub fn flat_phase(&self) -> (f64, f64) {
        let length = self.off_s - self.strike_s;
        let [down, off] = self.rolls_s;
        let (down, off) = (down.min(0.25 * length), off.min(0.45 * length));
        (self.strike_s + down, self.off_s - off)
    }

    /// A foot that stands flat from the beginning to the end.
    pub(crate) fn at_rest(
        side: Side,
        position: Vector3<f64>,
        rotation: UnitQuaternion<f64>,
    ) -> Self {
        Self {
            side,
            strike_s: -1.0,
            off_s: f64::INFINITY,
            position,
            rotation,
            speed: 0.0,
            strike_pitch_rad: 0.0,
            off_pitch_rad: 0.0,
            clearance_m: 0.0,
            delay: 0.0,
            jump_m: 0.0,
            rolls_s: [ROLL_DOWN_S, ROLL_OFF_S],
        }
    }

    /// The same foothold in the gait of a wearer.
    fn in_gait(self, speed: f64, profile: &GaitProfile, step: &StepVariation) -> Self {
        let usual = vigour(speed);
        let [strike, off] = step.pitch_rad;
        Self {
            speed,
            strike_pitch_rad: (profile.strike_pitch_rad + strike)
                * usual
                * (1.0 - running_share(speed)),
            off_pitch_rad: (profile.off_pitch_rad + off) * usual,
            clearance_m: profile.toe_clearance_m * step.clearance_ratio,
            delay: step.delay,
            ..self
        }
    }
}

/// Height of the ground under a point, looking down from a height.
pub type GroundFn<'a> = dyn Fn(f64, f64, f64) -> Option<f64> + 'a;

/// All footfalls from standing at time 0 until `seconds`, in the order of their strikes.
pub fn plan(
    path: &Path,
    progress: &Progress,
    ground: &GroundFn<'_>,
    start_below: f64,
    profile: &GaitProfile,
) -> Vec<Footfall> {
    let seconds = progress.seconds();
    let mut level = start_below;
    let mut falls: Vec<Footfall> = Vec::new();
    let mut last: [Option<usize>; 2] = [None; 2];
    let mut at_m = [0.0_f64; 2];
    for side in [Side::Left, Side::Right] {
        let wish = Wish {
            side,
            distance_m: progress.at(0.0).0,
            half_width_m: profile.half_step_width_m,
            toe_out_rad: profile.toe_out_rad[side as usize],
            below: level,
        };
        let (_, fall) = foothold(path, &wish, None, ground);
        last[side as usize] = Some(falls.len());
        falls.push(fall);
        level = fall.position.z + 0.6;
    }
    let mut t = 0.05;
    // The left foot stands first, so that even strikes after the two at the start are the right
    // one's.
    let mut side = Side::Right;
    while t < seconds {
        let speed = progress.at(t + 0.25).1;
        let apart = (at_m[0] - at_m[1]).abs();
        let closing = speed < STANDING && apart > 0.12;
        if speed < STANDING && !closing {
            t += 0.02;
            continue;
        }
        let step = profile.step(falls.len() as u64);
        let period = match closing {
            true => 0.6,
            false => step.duration_ratio / profile.cadence(speed),
        };
        let land = t + period;
        let (gone, speed_then) = progress.at(land);
        let stumbles = progress.stumbles().iter().any(|&s| (t..land).contains(&s));
        let ahead = match speed_then > STANDING && !closing {
            true => 0.5 * speed_then / profile.cadence(speed_then) + step.place_m[0],
            false => 0.0,
        };
        let short = if stumbles { 0.35 } else { 1.0 };
        if let Some(i) = last[side as usize] {
            let off = t + (2.0 * profile.duty(speed) - 1.0) * period;
            falls[i].off_s = off.max(falls[i].strike_s + 0.15);
        }
        let other = falls.last().map(|f| f.position.z);
        let wish = Wish {
            side,
            distance_m: (gone + short * ahead).max(at_m[side as usize]),
            half_width_m: profile.half_step_width_m * (1.0 - 0.4 * running_share(speed_then))
                + step.place_m[1],
            toe_out_rad: profile.toe_out_rad[side as usize] + step.toe_out_rad,
            below: level,
        };
        let (off, fall) = foothold(path, &wish, other, ground);
        let mut fall = fall.in_gait(speed_then, profile, &step);
        let later = off / speed_then.max(0.3);
        let land = land + later.clamp(-0.4 * period, 0.4 * period);
        fall.strike_s = land;
        at_m[side as usize] = wish.distance_m + off;
        level = fall.position.z + 0.6;
        last[side as usize] = Some(falls.len());
        falls.push(fall);
        side = match side {
            Side::Left => Side::Right,
            Side::Right => Side::Left,
        };
        t = land;
    }
    falls
}

/// Where a foot should come down.
struct Wish {
    side: Side,
    /// Distance along the path, m.
    distance_m: f64,
    /// Distance from the path, m.
    half_width_m: f64,
    toe_out_rad: f64,
    /// Height below which the ground is searched, m.
    below: f64,
}

/// Best foothold near the wish, and its offset from there along the path, m. `other` is the height
/// of the standing foot.
fn foothold(
    path: &Path,
    wish: &Wish,
    other: Option<f64>,
    ground: &GroundFn<'_>,
) -> (f64, Footfall) {
    let mut best: Option<(f64, f64, Footfall)> = None;
    for k in 0..17_i32 {
        // 0, 2, -2, 4, -4 … cm
        let off = 0.02 * f64::from((k + 1) / 2) * if k % 2 == 0 { -1.0 } else { 1.0 };
        let Some((uneven, fall)) = rest(path, wish, off, ground) else {
            continue;
        };
        let rise = other.map_or(0.0, |z| (fall.position.z - z).abs());
        let cost = uneven + 0.05 * off.abs() + (rise - MAX_STEP_UP_M).max(0.0);
        if best.as_ref().is_none_or(|(least, _, _)| cost < *least) {
            best = Some((cost, off, fall));
        }
    }
    best.map_or_else(
        || {
            // No ground at all: a hole in the scene, which the scene's test finds.
            let ([x, y], _) = path.at(wish.distance_m);
            let position = Vector3::new(x, y, wish.below - 0.6);
            let fall = Footfall::at_rest(wish.side, position, UnitQuaternion::identity());
            (0.0, fall)
        },
        |(_, off, fall)| (off, fall),
    )
}

/// The ground under the sole: `(x, y)` in the foot's axes and the height there, m.
type Sample = ((f64, f64), f64);

/// Pose of the sole at rest `off` m beyond the wish, and its cost, m.
fn rest(path: &Path, wish: &Wish, off: f64, ground: &GroundFn<'_>) -> Option<(f64, Footfall)> {
    let ([x, y], [dx, dy]) = path.at(wish.distance_m + off);
    let sign = match wish.side {
        Side::Left => 1.0,
        Side::Right => -1.0,
    };
    let out = sign * wish.half_width_m;
    let (x, y) = (x - dy * out, y + dx * out);
    let yaw = libm::atan2(dy, dx) + sign * wish.toe_out_rad;
    let (s, c) = (libm::sin(yaw), libm::cos(yaw));
    let height = |fx: f64, fy: f64| ground(x + c * fx - s * fy, y + s * fx + c * fy, wish.below);
    let mut samples: Vec<Sample> = Vec::with_capacity(ALONG * 3);
    for i in 0..ALONG {
        let (heel, toe) = (HEEL_X - MARGIN_M, TOE_X + MARGIN_M);
        let fx = heel + (toe - heel) * i as f64 / (ALONG - 1) as f64;
        for fy in [-HALF_WIDTH, 0.0, HALF_WIDTH] {
            samples.push(((fx, fy), height(fx, fy)?));
        }
    }
    // Ground far below the highest point does not support: the sole juts out over an edge there.
    // That is how a foot stands on a stair, unless heel or ball have too little support.
    let highest = samples.iter().map(|s| s.1).fold(f64::MIN, f64::max);
    let mut carrying = samples.clone();
    carrying.retain(|s| s.1 > highest - EDGE_M);
    let share = carrying.len() as f64 / samples.len() as f64;
    let is_carried = |fx: f64| carrying.iter().any(|s| (s.0.0 - fx).abs() < 0.03);
    let jutting = if share > 0.6 && is_carried(-0.03) && is_carried(0.07) {
        JUTTING_COST_M * (1.0 - share)
    } else {
        carrying = samples;
        UNSTABLE_COST_M
    };
    let (middle, slope_x, slope_y) = support(&carrying)?;
    let gap = |((fx, fy), z): &Sample| middle + slope_x * fx + slope_y * fy - z;
    let hollow = carrying.iter().map(gap).fold(0.0, f64::max);
    let forward = Vector3::new(c, s, slope_x);
    let left = Vector3::new(-s, c, slope_y);
    let up = forward.cross(&left).normalize();
    let tilt = Vector3::z().cross(&up);
    let angle = libm::atan2(tilt.norm(), up.z);
    let lean = match angle > 1e-9 {
        true => so3::exp(tilt.normalize() * angle),
        false => UnitQuaternion::identity(),
    };
    let steep = (slope_x.abs() - 0.35).max(0.0) + (slope_y.abs() - 0.35).max(0.0);
    // Stepping down, the heel passes the edge while it sinks.
    let behind = height(HEEL_X - SCRAPE_M, 0.0)?;
    let scraped = match behind > middle + SCRAPE_HEIGHT_M {
        true => SCRAPE_COST_M,
        false => 0.0,
    };
    let position = Vector3::new(x, y, middle);
    let rotation = lean * so3::exp(Vector3::z() * yaw);
    Some((
        hollow + 0.3 * steep + jutting + scraped,
        Footfall::at_rest(wish.side, position, rotation),
    ))
}

/// The plane on which a rigid sole rests: through three samples around its middle, with no sample
/// above it. Height at the foot's origin, slopes along and across; `None` if the samples are not
/// around the origin.
fn support(samples: &[Sample]) -> Option<(f64, f64, f64)> {
    for (i, a) in samples.iter().enumerate() {
        for (j, b) in samples.iter().enumerate().skip(i + 1) {
            for c in &samples[j + 1..] {
                let Some((z, slope_x, slope_y)) = plane(a, b, c) else {
                    continue;
                };
                let is_below =
                    |((x, y), height): &Sample| *height < z + slope_x * x + slope_y * y + 1e-9;
                if samples.iter().all(is_below) {
                    return Some((z, slope_x, slope_y));
                }
            }
        }
    }
    None
}

/// The plane through three samples; `None` if they are on a line or the origin is not between them.
fn plane(a: &Sample, b: &Sample, c: &Sample) -> Option<(f64, f64, f64)> {
    let cross = |p: &Sample, q: &Sample| p.0.0 * q.0.1 - p.0.1 * q.0.0;
    // Areas of the triangles with the origin: its barycentric coordinates.
    let weights = [cross(b, c), cross(c, a), cross(a, b)];
    let sum: f64 = weights.iter().sum();
    if sum.abs() < 1e-6 || weights.iter().any(|w| w / sum < -1e-9) {
        return None;
    }
    let z = (weights[0] * a.1 + weights[1] * b.1 + weights[2] * c.1) / sum;
    let [u, v] = [b, c].map(|p| (p.0.0 - a.0.0, p.0.1 - a.0.1, p.1 - a.1));
    let determinant = u.0 * v.1 - u.1 * v.0;
    let slope_x = (u.2 * v.1 - v.2 * u.1) / determinant;
    let slope_y = (u.0 * v.2 - v.0 * u.2) / determinant;
    Some((z, slope_x, slope_y))
}
