//! A person walking with the rig on the chest: motion of the rig and the feet.
//!
//! Contract: the motion is a function of scene, seed and length. The rig's pose is a twice
//! continuously differentiable spline, so IMU measurements are exact ([`Walker::rig`]). Between the
//! flat phases of [`Footfall`]s feet move smoothly; in a flat phase they are at rest. Time is in
//! seconds from standing still; the first step follows within a second.

mod curves;
mod foot_motion;
mod foot_state;
pub mod gait;
pub mod gait_model;
pub mod path;
pub mod profile;
pub mod progress;
mod side;

use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use self::curves::{running_share, smooth, vigour};
use self::foot_motion::{Avoidance, avoid, standing, swinging};
pub use self::foot_state::{FootState, Phase};
pub use self::gait::Footfall;
use self::gait_model::{FootMotion, GaitModel};
use self::path::Path;
pub use self::profile::GaitProfile;
use self::progress::{Jump, Progress};
pub use self::side::Side;
use crate::faults::{Kind, WearerFaults};
use crate::random;
use crate::scene::Scene;
use crate::spline::{Spline, State};
use cad_transforms::so3;

/// Knot spacing of the spline, s: motion up to about 10 Hz.
pub(crate) const KNOT_S: f64 = 0.025;
/// Height of the rig's datum above the soles of a standing wearer of the reference height, m.
const CHEST_HEIGHT_M: f64 = 1.3;
/// Distance of the rig in front of the line of the hips, m.
const CHEST_AHEAD_M: f64 = 0.14;
/// Position of a person who carries the rig in his hands, m.
const CARRIER_X: f64 = -0.6;
/// Duration of a slide of a foot, s.
const SLIDE_S: f64 = 0.15;
/// Depth of the crouch before and after a jump, m, and its duration, s.
const CROUCH_M: f64 = 0.12;
const CROUCH_S: f64 = 0.5;

/// A walk.
#[derive(Clone, Debug)]
pub struct Walker {
    profile: GaitProfile,
    spline: Spline,
    /// Footfalls of each foot, in the order of time.
    falls: [Vec<Footfall>; 2],
    /// Of the swing after each footfall.
    avoidances: [Vec<Avoidance>; 2],
    /// Of a gait model, from heel off of each footfall to foot flat of the next one.
    motions: [Vec<Option<Arc<dyn FootMotion>>>; 2],
    faults: WearerFaults,
    seconds: f64,
}

impl Walker {
    /// Walks the scene's route for `seconds`; the seed draws the wearer.
    pub fn new(scene: &Scene, seed: u64, seconds: f64) -> Self {
        Self::with_faults(scene, seed, seconds, &WearerFaults::default())
    }

    /// The same with faults. The chest follows jumps, but neither slides nor yielding ground.
    pub fn with_faults(scene: &Scene, seed: u64, seconds: f64, faults: &WearerFaults) -> Self {
        Self::make(scene, seed, seconds, faults, None)
    }

    /// A walk in another gait.
    pub fn with_gait(scene: &Scene, seed: u64, seconds: f64, gait: &dyn GaitModel) -> Self {
        Self::make(scene, seed, seconds, &WearerFaults::default(), Some(gait))
    }

    fn make(
        scene: &Scene,
        seed: u64,
        seconds: f64,
        faults: &WearerFaults,
        gait: Option<&dyn GaitModel>,
    ) -> Self {
        let profile = gait_model::profile(seed, gait);
        let path = Path::closed(&scene.route.points);
        // Slightly longer than required, so that the end is not an edge.
        let progress = Progress::new(&scene.route.legs, seconds + 2.0, &faults.jumps());
        let ground = |x: f64, y: f64, below: f64| Some(scene.ground(x, y, below)?.height);
        let start_below = scene.route.start_below;
        let mut all = gait::plan(&path, &progress, &ground, start_below, &profile);
        if let Some(gait) = gait {
            all.iter_mut()
                .for_each(|fall| fall.rolls_s = gait.rolls_s(fall));
        }
        let spline = chest(&path, &progress, &all, &profile, seed);
        let of = |side| {
            let own = all.iter().copied().filter(|f| f.side == side);
            own.flat_map(|fall| parted(fall, progress.jumps()))
                .collect()
        };
        let falls: [Vec<Footfall>; 2] = [of(Side::Left), of(Side::Right)];
        let avoidances = [0, 1].map(|side| {
            let swings = falls[side].windows(2);
            swings.map(|of| avoid(&of[0], &of[1], &ground)).collect()
        });
        let motions = [0, 1].map(|side| {
            let swings = falls[side].windows(2);
            let motion = |of: &[Footfall]| gait?.motion(&of[0], &of[1], &ground);
            swings.map(motion).collect()
        });
        Self {
            profile,
            spline,
            falls,
            avoidances,
            motions,
            faults: faults.clone(),
            seconds,
        }
    }

    /// A person who stands on the floor behind the rig and carries it along a spline whose second
    /// control is at the beginning.
    pub(crate) fn carrying(spline: Spline, seed: u64, seconds: f64) -> Self {
        let standing = |side| {
            let y = if side == Side::Left { 0.1 } else { -0.1 };
            let position = Vector3::new(CARRIER_X, y, 0.0);
            Footfall::at_rest(side, position, UnitQuaternion::identity())
        };
        Self {
            profile: GaitProfile::draw(seed),
            spline,
            falls: [Side::Left, Side::Right].map(|side| vec![standing(side)]),
            avoidances: [Vec::new(), Vec::new()],
            motions: [Vec::new(), Vec::new()],
            faults: WearerFaults::default(),
            seconds,
        }
    }

    /// Length, s.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// What is typical of the wearer.
    pub fn profile(&self) -> &GaitProfile {
        &self.profile
    }

    /// Pose of the rig in the world, and its derivatives.
    pub fn rig(&self, time_s: f64) -> State {
        self.spline.at(time_s + KNOT_S)
    }

    /// Faults of the wearer.
    pub(crate) fn faults(&self) -> &WearerFaults {
        &self.faults
    }

    /// Contacts of a foot with the ground, in the order of time.
    pub fn contacts(&self, side: Side) -> &[Footfall] {
        &self.falls[side as usize]
    }

    /// Pose of a foot.
    pub fn foot(&self, side: Side, time_s: f64) -> FootState {
        let falls = &self.falls[side as usize];
        let next = falls.partition_point(|f| f.strike_s <= time_s).max(1);
        if let Some(state) = self.modelled(side, next - 1, time_s) {
            return state;
        }
        let fall = self.displaced(&falls[next - 1], time_s);
        if time_s <= fall.off_s {
            return standing(&fall, time_s);
        }
        let Some(to) = falls.get(next) else {
            return standing(&fall, fall.off_s);
        };
        let t = (time_s - fall.off_s) / (to.strike_s - fall.off_s);
        swinging(&fall, to, &self.avoidances[side as usize][next - 1], t)
    }

    /// The motion of a gait model since or after a footfall; `None` while the foot is flat or moves
    /// as the simulator's own do.
    fn modelled(&self, side: Side, at: usize, time_s: f64) -> Option<FootState> {
        let fall = &self.falls[side as usize][at];
        let motions = &self.motions[side as usize];
        let (flat_from, flat_to) = fall.flat_phase();
        let motion = match time_s {
            t if t < flat_from => motions.get(at.checked_sub(1)?)?,
            t if t > flat_to => motions.get(at)?,
            _ => return None,
        };
        let (position, rotation) = motion.as_ref()?.pose(time_s);
        Some(FootState {
            position,
            rotation,
            phase: match time_s {
                t if t < flat_from => Phase::Heel,
                t if t <= fall.off_s => Phase::Toe,
                _ => Phase::Swing,
            },
        })
    }

    /// A footfall where slides and yielding ground have moved it until a time.
    fn displaced(&self, fall: &Footfall, time_s: f64) -> Footfall {
        let strength = |kind| self.faults.strength(kind, fall.side, fall.strike_s);
        let (flat, _) = fall.flat_phase();
        let slide = strength(Kind::FootSlip) * smooth((time_s - flat) / SLIDE_S);
        let sunk =
            strength(Kind::SoftGround) * smooth((time_s - fall.strike_s) / (flat - fall.strike_s));
        let forward = fall.rotation * Vector3::x();
        Footfall {
            position: fall.position + forward * slide - Vector3::z() * sunk,
            ..*fall
        }
    }
}

/// A footfall, or the two before and after a jump.
fn parted(fall: Footfall, jumps: &[Jump]) -> Vec<Footfall> {
    let mut parts = vec![fall];
    for jump in jumps {
        let last = parts[parts.len() - 1];
        let land_s = jump.at_s + jump.flight_s();
        if last.strike_s < jump.at_s && land_s < last.off_s {
            let at = parts.len() - 1;
            parts[at].off_s = jump.at_s;
            parts[at].off_pitch_rad = 0.0;
            parts.push(Footfall {
                strike_s: land_s,
                strike_pitch_rad: 0.0,
                jump_m: jump.height_m,
                ..last
            });
        }
    }
    parts
}

/// Motion of the chest over the footfalls.
fn chest(
    path: &Path,
    progress: &Progress,
    falls: &[Footfall],
    profile: &GaitProfile,
    seed: u64,
) -> Spline {
    let chest_m = CHEST_HEIGHT_M * profile.scale();
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
        let (gone, _) = progress.at(t);
        let ([x, y], [dx, dy]) = path.at(gone);
        let (phase, level) = stride(falls, t);
        let g = lively(t).min(1.8);
        let run = running_share(1.35 * lively(t));
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
        for jump in progress.jumps() {
            up += jump.height_at(t);
            for middle in [
                jump.at_s - 0.5 * CROUCH_S,
                jump.at_s + jump.flight_s() + 0.5 * CROUCH_S,
            ] {
                let s = (t - middle) / CROUCH_S + 0.5;
                if (0.0..1.0).contains(&s) {
                    up -= CROUCH_M * libm::sin(std::f64::consts::PI * s).powi(2);
                }
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
            level + chest_m + up + sway(4, 0.002),
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
