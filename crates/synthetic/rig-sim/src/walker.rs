//! A person walking with the rig on the chest: motion of the rig and the feet.
//!
//! Contract: the motion is a function of scene, seed and length. The rig's pose is a twice
//! continuously differentiable spline, so IMU measurements are exact ([`Walker::rig`]). Between the
//! flat phases of [`Footfall`]s feet move smoothly; in a flat phase they are at rest. Time is in
//! seconds from standing still; the first step follows within a second.

pub mod gait;
pub mod path;
pub mod progress;

use nalgebra::{UnitQuaternion, Vector3};

pub use self::gait::{Footfall, Side};
use self::gait::{HEEL_X, TIP_X, TOE_X};
use self::path::Path;
use self::progress::Progress;
use crate::random;
use crate::scene::Scene;
use crate::spline::{Spline, State};
use cad_transforms::so3;

/// Knot spacing of the spline, s: motion up to about 10 Hz.
pub(crate) const KNOT_S: f64 = 0.025;
/// Height of the rig's datum above the soles of a standing wearer, m.
const CHEST_HEIGHT_M: f64 = 1.3;
/// Distance of the rig in front of the line of the hips, m.
const CHEST_AHEAD_M: f64 = 0.14;
/// Position of a person who carries the rig in his hands, m.
const CARRIER_X: f64 = -0.6;
/// From the strike until the whole sole is down, s.
const ROLL_DOWN_S: f64 = 0.08;
/// From heel lift until toe-off, s.
const ROLL_OFF_S: f64 = 0.2;
/// Pitch of the toe at the strike and of the heel at the end, rad, at a usual speed.
const STRIKE_PITCH: f64 = -0.3;
const OFF_PITCH: f64 = 0.75;
/// Minimum clearance of a swinging foot, m.
const CLEARANCE_M: f64 = 0.025;

/// A walk.
#[derive(Clone, Debug)]
pub struct Walker {
    spline: Spline,
    /// Footfalls of each foot, in the order of time.
    falls: [Vec<Footfall>; 2],
    /// Lift of a foot in the swing after a footfall, m.
    lifts: [Vec<f64>; 2],
    seconds: f64,
}

/// Pose of a foot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootState {
    /// Middle of the sole, in the world, m.
    pub position: Vector3<f64>,
    /// Maps the foot frame (x forward, y left, z up from the sole) to the world.
    pub rotation: UnitQuaternion<f64>,
    /// Whether a part of the sole is on the ground.
    pub contact: bool,
    /// Whether the whole sole is on the ground and at rest.
    pub flat: bool,
}

impl Walker {
    /// Walks the scene's route for `seconds`.
    pub fn new(scene: &Scene, seed: u64, seconds: f64) -> Self {
        let path = Path::closed(&scene.route.points);
        // Slightly longer than required, so that the end is not an edge.
        let progress = Progress::new(&scene.route.legs, seconds + 2.0);
        let ground = |x: f64, y: f64, below: f64| Some(scene.ground(x, y, below)?.height);
        let all = gait::plan(&path, &progress, &ground, scene.route.start_below);
        let spline = chest(&path, &progress, &all, seed);
        let of = |side| all.iter().copied().filter(|f| f.side == side).collect();
        let falls: [Vec<Footfall>; 2] = [of(Side::Left), of(Side::Right)];
        let lifts = [0, 1].map(|side| {
            falls[side]
                .windows(2)
                .map(|pair| lift(&pair[0], &pair[1], &ground))
                .collect()
        });
        Self {
            spline,
            falls,
            lifts,
            seconds,
        }
    }

    /// A person who stands on the floor behind the rig and carries it along a spline whose second
    /// control is at the beginning.
    pub(crate) fn carrying(spline: Spline, seconds: f64) -> Self {
        let standing = |side| Footfall {
            side,
            strike_s: -1.0,
            off_s: f64::INFINITY,
            position: Vector3::new(CARRIER_X, if side == Side::Left { 0.1 } else { -0.1 }, 0.0),
            rotation: UnitQuaternion::identity(),
            speed: 0.0,
        };
        Self {
            spline,
            falls: [Side::Left, Side::Right].map(|side| vec![standing(side)]),
            lifts: [Vec::new(), Vec::new()],
            seconds,
        }
    }

    /// Length, s.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Pose of the rig in the world, and its derivatives.
    pub fn rig(&self, time_s: f64) -> State {
        self.spline.at(time_s + KNOT_S)
    }

    /// Contacts of a foot with the ground, in the order of time.
    pub fn contacts(&self, side: Side) -> &[Footfall] {
        &self.falls[side as usize]
    }

    /// Pose of a foot.
    pub fn foot(&self, side: Side, time_s: f64) -> FootState {
        let falls = &self.falls[side as usize];
        let next = falls.partition_point(|f| f.strike_s <= time_s).max(1);
        let fall = &falls[next - 1];
        if time_s <= fall.off_s {
            return standing(fall, time_s);
        }
        let Some(to) = falls.get(next) else {
            return standing(fall, fall.off_s);
        };
        let t = (time_s - fall.off_s) / (to.strike_s - fall.off_s);
        swinging(fall, to, self.lifts[side as usize][next - 1], t)
    }

    /// Time span in which a footfall's whole sole is down and at rest, s; empty in a quick run.
    pub(crate) fn flat_phase(fall: &Footfall) -> (f64, f64) {
        let length = fall.off_s - fall.strike_s;
        let (down, off) = (
            ROLL_DOWN_S.min(0.25 * length),
            ROLL_OFF_S.min(0.45 * length),
        );
        (fall.strike_s + down, fall.off_s - off)
    }
}

/// 0 to 1 with no speed and no acceleration at the ends.
fn smooth(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

/// Fraction of the usual roll of a foot at a speed.
fn vigour(speed: f64) -> f64 {
    (speed / 1.3).clamp(0.0, 1.2)
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

/// Pitch of a foot at its strike.
fn strike_pitch(fall: &Footfall) -> f64 {
    STRIKE_PITCH * vigour(fall.speed) * (1.0 - gait::running_share(fall.speed))
}

fn standing(fall: &Footfall, time_s: f64) -> FootState {
    let (flat_from, flat_to) = Walker::flat_phase(fall);
    let (position, rotation, flat) = if time_s < flat_from {
        let t = (time_s - fall.strike_s) / (flat_from - fall.strike_s);
        let (p, r) = rolled(fall, HEEL_X, strike_pitch(fall) * (1.0 - smooth(t)));
        (p, r, false)
    } else if time_s <= flat_to || fall.off_s.is_infinite() {
        (fall.position, fall.rotation, true)
    } else {
        let t = (time_s - flat_to) / (fall.off_s - flat_to);
        let pitch = OFF_PITCH * vigour(fall.speed) * smooth(t);
        let (p, r) = rolled(fall, TIP_X, pitch);
        (p, r, false)
    };
    FootState {
        position,
        rotation,
        contact: true,
        flat,
    }
}

fn swinging(from: &Footfall, to: &Footfall, lift: f64, t: f64) -> FootState {
    let (p0, r0) = rolled(from, TIP_X, OFF_PITCH * vigour(from.speed));
    let (p1, r1) = rolled(to, HEEL_X, strike_pitch(to));
    let s = smooth(t);
    let bump = 64.0 * (t * (1.0 - t)).powi(3);
    // Upstairs a foot rises before it goes ahead, downstairs it goes ahead before it sinks.
    let way = p1 - p0;
    let climb = (way.z / 0.25).clamp(-1.0, 1.0);
    let early = |share: f64| smooth(t / (1.0 - share));
    let late = |share: f64| smooth((t - share) / (1.0 - share));
    let (over, up) = match climb > 0.0 {
        true => (late(0.25 * climb), early(0.4 * climb)),
        false => (early(-0.25 * climb), late(-0.4 * climb)),
    };
    FootState {
        position: p0 + Vector3::new(way.x * over, way.y * over, way.z * up + lift * bump),
        rotation: r0 * so3::exp(so3::log(&(r0.inverse() * r1)) * s),
        contact: false,
        flat: false,
    }
}

/// Lift that a foot needs to clear everything between two footfalls.
fn lift(from: &Footfall, to: &Footfall, ground: &gait::GroundFn<'_>) -> f64 {
    let below = from.position.z.max(to.position.z) + 0.5;
    let mut lift: f64 = 0.02 + 0.03 * vigour(to.speed);
    for k in 6..=34 {
        let t = f64::from(k) / 40.0;
        let foot = swinging(from, to, 0.0, t);
        let bump = 64.0 * (t * (1.0 - t)).powi(3);
        for x in [HEEL_X, 0.0, TOE_X] {
            let p = foot.position + foot.rotation * Vector3::new(x, 0.0, 0.0);
            if let Some(height) = ground(p.x, p.y, below) {
                let needed = height + CLEARANCE_M.min(0.5 * bump) - p.z;
                lift = lift.max(needed / bump);
            }
        }
    }
    lift.min(0.45)
}

/// Motion of the chest over the footfalls.
fn chest(path: &Path, progress: &Progress, falls: &[Footfall], seed: u64) -> Spline {
    let seconds = progress.seconds();
    let count = (seconds / KNOT_S).ceil() as usize + 4;
    // Intensity of the gait: the speed, smoothed over half a second to both sides.
    let lively = |t: f64| {
        let at = |k: i32| progress.at(t + 0.1 * f64::from(k)).1;
        (-5..=5).map(at).sum::<f64>() / 11.0 / 1.35
    };
    let mut controls = Vec::with_capacity(count);
    for i in 0..count {
        // The first control is before the start.
        let t = (i as f64 - 1.0) * KNOT_S;
        let (gone, speed) = progress.at(t);
        let ([x, y], [dx, dy]) = path.at(gone);
        let (phase, level) = stride(falls, t);
        let g = lively(t).min(1.8);
        let run = gait::running_share(speed);
        let turn = 2.0 * std::f64::consts::PI * phase;
        let (s1, c1) = (libm::sin(0.5 * turn), libm::cos(0.5 * turn));
        let c2 = libm::cos(turn - 2.0 * run);
        let s2 = libm::sin(turn);

        // Lowest in double support, towards the standing foot, a little ahead and behind.
        let mut up = -0.02 * g * (1.0 + 1.3 * run) * c2;
        let mut ahead = CHEST_AHEAD_M - 0.01 * g * s2;
        let aside = -0.022 * g.min(1.0) * (1.0 - 0.6 * run) * s1;
        let mut pitch = 0.05 + 0.05 * run + 0.018 * g * libm::cos(turn + 0.6);
        let mut yaw = 0.05 * g * c1;
        let roll = 0.022 * g * s1;
        // Shock of a strike: a damped oscillation of 9 Hz.
        let last = falls.partition_point(|f| f.strike_s <= t);
        for fall in &falls[last.saturating_sub(2)..last] {
            let since = t - fall.strike_s;
            if since < 0.4 {
                let ring = libm::sin(2.0 * std::f64::consts::PI * 9.0 * since);
                up -= 0.0035 * vigour(fall.speed) * (1.0 + run) * libm::exp(-since / 0.05) * ring;
            }
        }
        for &at in progress.stumbles() {
            let s = (t - at) / 0.9;
            if (0.0..1.0).contains(&s) {
                let shape = libm::sin(std::f64::consts::PI * s).powi(2);
                pitch += 0.3 * shape;
                up -= 0.06 * shape;
                ahead += 0.1 * shape;
            }
        }
        // Slow sway, and looking around.
        let sway = |k: u64, size: f64| {
            (0..3_u64).fold(0.0, |sum, j| {
                let draw = |n| random::uniform(seed, random::WALK + k, 2 * j + n);
                let hz = 0.07 + 0.4 * draw(0);
                sum + size * libm::sin(2.0 * std::f64::consts::PI * (hz * t + draw(1)))
            })
        };
        yaw += sway(0, 0.025);
        pitch += sway(1, 0.012);
        let roll = roll + sway(2, 0.006);
        let position = Vector3::new(
            x + dx * ahead - dy * (aside + sway(3, 0.003)),
            y + dy * ahead + dx * (aside + sway(3, 0.003)),
            level + CHEST_HEIGHT_M + up + sway(4, 0.002),
        );
        let rotation = so3::from_yaw_pitch_roll(libm::atan2(dy, dx) + yaw, pitch, roll);
        controls.push((position, rotation));
    }
    Spline::new(KNOT_S, controls)
}

/// Steps so far, including the fraction of the current one (even: the right foot lands next), and
/// the mean height of the feet that carry the body, m.
fn stride(falls: &[Footfall], t: f64) -> (f64, f64) {
    // The first two are the stance before the start.
    let next = falls.partition_point(|f| f.strike_s <= t).max(2);
    let level = |k: usize| 0.5 * (falls[k - 1].position.z + falls[k - 2].position.z);
    let steps = next as f64 - 2.0;
    let Some(fall) = falls.get(next) else {
        return (steps, level(next));
    };
    let since = match next {
        2 => 0.0,
        _ => falls[next - 1].strike_s,
    };
    // While standing before a step, the phase waits.
    let begin = since.max(fall.strike_s - 0.8);
    let part = ((t - begin) / (fall.strike_s - begin)).clamp(0.0, 1.0);
    let height = level(next) + (level(next + 1) - level(next)) * smooth(part);
    (steps + part, height)
}

#[cfg(test)]
mod tests;
