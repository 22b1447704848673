//! The whole session at once: all keyframes, all that they saw, what the IMU felt between them, and places seen again.
//!
//! Contract. [`Mapping`] is fed with samples and keyframes in order of time, as odometry gave them, and solved once. Poses come
//! out for every keyframe, in the world of the first; [`between`] carries the frame sets between keyframes along. It is no
//! part of causal results: a pose depends on everything that came later. Memory grows with the session: some 40 kB for each keyframe,
//! and ten times as much while it is solved. Same input, same bytes, on any number of threads.

use std::collections::BTreeMap;

use cad_transforms::RigidTransform;
use calib::Eye as Side;
use nalgebra::{Matrix6, UnitQuaternion};

use crate::doubt::{own_covariance, tilted};
use crate::felt::{ImuInUse, leap};
use crate::input::ImuSample;
use crate::keyframe::Keyframe;
use crate::mount::Mount;
use crate::rig::Rig;
use crate::settings::Settings;
use crate::sight::{Camera, Sight};
use crate::solve::LEAST_RHO;
use crate::start::{ANY_TILT, sigmas_of_first};
use crate::state::{POSE, State, TURN};
use crate::window::{Frame, Landmark, Motion, Prior, Window};

mod adjust;
mod loops;
mod ties;

pub use adjust::Progress;
pub use ties::Tie;

/// Landmarks that fewer keyframes saw tell nothing that the window did not.
const FEWEST_SIGHTS: usize = 2;

/// A keyframe's pose with everything known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdjustedPose {
    /// Number of the frame set.
    pub number: u64,
    /// ns.
    pub time_ns: i64,
    /// In the world of the first pose.
    pub world_from_rig: RigidTransform,
    /// Of a small motion of the rig in its own axes against the first pose: shift m, turn rad. Too little where the way broke
    /// in between, see [`Tie`].
    pub covariance: Matrix6<f64>,
}

/// Two keyframes that show the same place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loop {
    /// Numbers of the frame sets, the earlier one first.
    pub frames: [u64; 2],
    /// Marks that agree.
    pub marks: usize,
    /// How far the poses were from closing it before they were adjusted, m and rad.
    pub off: [f64; 2],
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Adjusted {
    /// One for each keyframe.
    pub poses: Vec<AdjustedPose>,
    /// The places seen again that were used.
    pub loops: Vec<Loop>,
    /// Linearisations.
    pub rounds: usize,
    /// Whether the last ones changed next to nothing. If not, neither poses nor mounts are as good as their covariances say.
    pub is_converged: bool,
    /// Landmarks.
    pub landmarks: usize,
    /// Where cameras were found to sit, one for each of the rig.
    pub mounts: Vec<AdjustedMount>,
}

/// Where a camera was found to sit on the rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdjustedMount {
    /// m.
    pub rig_from_left: RigidTransform,
    /// Of a small motion of the left optical frame in its own axes: shift m, turn rad.
    pub covariance: Matrix6<f64>,
    /// How far that is from where it was told to sit, m and rad.
    pub off: [f64; 2],
    /// Whether it is turned by more than three sigmas of what was told: the camera was moved, or its calibration is another
    /// rig's.
    pub is_moved: bool,
}

/// See the module.
pub struct Mapping {
    cameras: Vec<Camera>,
    mounts: Vec<Mount>,
    body_from_rig: RigidTransform,
    imu: Option<ImuInUse>,
    sigma_px: f64,
    keyframes: Vec<Keyframe>,
    motions: Vec<Option<Motion>>,
}

impl Mapping {
    /// For the rig and the settings of the odometry.
    pub fn new(rig: &Rig, settings: &Settings) -> Self {
        let (cameras, body_from_rig, imu) = ImuInUse::of(rig);
        let told = rig.cameras.iter().zip(&cameras);
        Self {
            mounts: told
                .map(|(told, camera)| Mount::new(told, camera))
                .collect(),
            cameras,
            body_from_rig,
            imu,
            sigma_px: settings.sigma_px,
            keyframes: Vec::new(),
            motions: Vec::new(),
        }
    }

    /// Takes a sample of an IMU, given by its place in the rig.
    pub fn add_imu(&mut self, imu: usize, sample: &ImuSample) {
        if let Some(own) = self.imu.as_mut().filter(|own| own.index == imu) {
            own.samples.push(sample, own.range);
        }
    }

    /// Takes a keyframe, after the samples up to its time.
    pub fn add_keyframe(&mut self, keyframe: Keyframe) {
        let to = &keyframe.state;
        let motion = self.keyframes.last().map(|from| {
            let from = State::from(&from.state);
            let imu = self.imu.as_ref().filter(|_| keyframe.is_felt);
            let felt = imu.and_then(|imu| imu.felt(&from, to.time_ns));
            let seconds = (to.time_ns - from.time_ns) as f64 * 1e-9;
            Motion {
                has_gravity: felt.is_some(),
                walk: self.imu.as_ref().map_or([1e-6; 2], ImuInUse::walk),
                felt: felt.unwrap_or_else(|| {
                    let turned = from.turn.inverse() * to.turn;
                    let rate = crate::so3::log(&turned) / seconds.max(1e-3);
                    leap(&from, rate, to.time_ns)
                }),
            }
        });
        if let Some(imu) = &mut self.imu {
            imu.samples.forget_before(to.time_ns - 50_000_000);
        }
        self.motions.push(motion);
        self.keyframes.push(keyframe);
    }

    /// How many keyframes there are.
    pub fn len(&self) -> usize {
        self.keyframes.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.keyframes.is_empty()
    }

    /// Adjusts everything. `progress` is told what is being done.
    pub fn solve(&self, mut progress: impl FnMut(Progress)) -> Adjusted {
        let Some(first) = self.keyframes.first() else {
            return Adjusted {
                poses: Vec::new(),
                loops: Vec::new(),
                rounds: 0,
                is_converged: true,
                landmarks: 0,
                mounts: Vec::new(),
            };
        };
        let mut window = self.window(&State::from(&first.state));
        // By causal poses and by ranges of one pair of eyes. It also takes away right sights, of far things from far on, and those are the
        // ones that strayed longest: with ranges that fit all sights first, errors nearly double where light is bad.
        adjust::prune(&mut window);
        let mut found = loops::find(&self.keyframes, &window, &mut progress);
        // And from here on with the mounts of the cameras.
        window.mounts.clone_from(&self.mounts);
        // A long way is far off where it closes: what loops want is believed first, and doubted when they agree as well as they can.
        let far = adjust::adjust(&mut window, &found, 12, &mut progress);
        found.iter_mut().for_each(loops::Closure::narrow);
        let near = adjust::adjust(&mut window, &found, 12, &mut progress);
        adjust::prune(&mut window);
        let last = adjust::adjust(&mut window, &found, 30, &mut progress);
        let covariances = adjust::covariances(&window, &found);
        let poses = window.frames.iter().zip(&covariances.poses);
        Adjusted {
            poses: poses
                .map(|(frame, covariance)| {
                    let world_from_rig = frame.state.world_from_rig(&self.body_from_rig);
                    let mut covariance =
                        own_covariance(&frame.state, &self.body_from_rig, 0.0, covariance);
                    if self.imu.is_none() {
                        covariance += tilted(&world_from_rig);
                    }
                    AdjustedPose {
                        number: frame.number,
                        time_ns: frame.state.time_ns,
                        world_from_rig,
                        covariance,
                    }
                })
                .collect(),
            loops: found.iter().map(loops::Closure::told).collect(),
            rounds: far.rounds + near.rounds + last.rounds,
            is_converged: last.is_converged,
            landmarks: window.landmarks.len(),
            mounts: self.found_mounts(&window, &covariances.mounts),
        }
    }

    fn found_mounts(&self, window: &Window, covariances: &[Matrix6<f64>]) -> Vec<AdjustedMount> {
        let rig_from_body = self.body_from_rig.inverse();
        let each = self.mounts.iter().zip(&window.cameras).zip(covariances);
        each.map(|((mount, camera), covariance)| {
            let off = mount.off(camera);
            let sigmas = mount.sigmas();
            let is_beyond = |k: usize| off[k].abs() > 3.0 * sigmas[k];
            let turns = 3..POSE;
            let (turn, arm) = &camera.body_from_left;
            let turn = UnitQuaternion::from_matrix(turn);
            let body_from_left =
                RigidTransform::from_wxyz([turn.w, turn.i, turn.j, turn.k], (*arm).into())
                    .expect("a mount is finite, since steps that are not are not taken");
            AdjustedMount {
                rig_from_left: rig_from_body * body_from_left,
                covariance: mount.honest(covariance),
                off: [off.fixed_rows::<3>(0).norm(), off.fixed_rows::<3>(3).norm()],
                is_moved: turns.into_iter().any(is_beyond),
            }
        })
        .collect()
    }

    /// Everything as a window of all keyframes.
    fn window(&self, first: &State) -> Window {
        let mut sigmas = sigmas_of_first(self.imu.is_some());
        let is_levelled = self.motions.iter().flatten().any(|m| m.has_gravity);
        if self.imu.is_some() && !is_levelled {
            sigmas[TURN..TURN + 3].fill(ANY_TILT);
        }
        let mut prior = Prior::of(self.keyframes[0].number, *first, &sigmas);
        let up = first.turn.inverse() * nalgebra::Vector3::z();
        let mut view = prior.information.fixed_view_mut::<3, 3>(TURN, TURN);
        view += up * up.transpose() * 1e8;
        let mut frames = Vec::with_capacity(self.keyframes.len());
        let mut sights: BTreeMap<u64, Vec<(u64, Sight)>> = BTreeMap::new();
        for (keyframe, motion) in self.keyframes.iter().zip(&self.motions) {
            frames.push(Frame {
                number: keyframe.number,
                state: (&keyframe.state).into(),
                motion: motion.clone(),
            });
            for seen in &keyframe.seen {
                let index = usize::from(seen.camera);
                let camera = &self.cameras[index];
                let Some(left) = camera.bearing(Side::Left, seen.left) else {
                    continue;
                };
                let right = seen.right.and_then(|at| camera.bearing(Side::Right, at));
                let sight = Sight {
                    camera: index,
                    left,
                    right,
                    after_s: keyframe.after_s[index] + camera.row_after_s(Side::Left, seen.left[1]),
                };
                sights
                    .entry(seen.id)
                    .or_default()
                    .push((keyframe.number, sight));
            }
        }
        let numbers: Vec<u64> = self.keyframes.iter().map(|k| k.number).collect();
        let mut landmarks = BTreeMap::new();
        for (id, mut sights) in sights {
            // The first that both eyes saw is the host; what was seen before is given up.
            let Some(host) = sights.iter().position(|(_, s)| s.right.is_some()) else {
                continue;
            };
            sights.drain(..host);
            if sights.len() < FEWEST_SIGHTS {
                continue;
            }
            widen(&mut sights, &numbers);
            let sight = &sights[0].1;
            let Some(right) = &sight.right else { continue };
            let (rho, _) = self.cameras[sight.camera].triangulate(&sight.left, right);
            let landmark = Landmark {
                rho: rho.max(LEAST_RHO),
                sights,
            };
            landmarks.insert(id, landmark);
        }
        Window {
            cameras: self.cameras.clone(),
            mounts: Vec::new(),
            frames,
            landmarks,
            prior,
            sigma_px: self.sigma_px,
        }
    }
}

/// A corner is followed from picture to picture and strays from where it began: what is wrong of a place adds up, by as much from
/// one keyframe to the next as a place is wrong by itself.
fn widen(sights: &mut [(u64, Sight)], keyframes: &[u64]) {
    let place = |number: u64| keyframes.partition_point(|k| *k < number);
    let host = place(sights[0].0);
    for (number, sight) in sights {
        let age = place(*number) - host;
        *sight = sight.widened((1.0 + age as f64).sqrt());
    }
}

/// Poses at all times from those of keyframes that were adjusted: each frame set keeps its place between its two keyframes.
/// `causal` are the times and poses of all frame sets, `adjusted` those of some of them, both rising. Before the first and behind the
/// last keyframe a pose keeps its place to the nearest one. Keyframes that are no frame set are left out.
pub fn between(
    causal: &[(i64, RigidTransform)],
    adjusted: &[(i64, RigidTransform)],
) -> Vec<RigidTransform> {
    let place = |time: i64| causal.binary_search_by_key(&time, |c| c.0).ok();
    let keys: Vec<(usize, &RigidTransform)> = adjusted
        .iter()
        .filter_map(|(time, pose)| Some((place(*time)?, pose)))
        .collect();
    let mut out = Vec::with_capacity(causal.len());
    let mut next = 0;
    for (k, (time, pose)) in causal.iter().enumerate() {
        while next < keys.len() && keys[next].0 <= k {
            next += 1;
        }
        let carried = |(at, adjusted): &(usize, &RigidTransform)| {
            **adjusted * (causal[*at].1.inverse() * *pose)
        };
        let before = next.checked_sub(1).map(|b| &keys[b]);
        let behind = keys.get(next);
        out.push(match (before, behind) {
            (None, None) => *pose,
            (Some(one), None) | (None, Some(one)) => carried(one),
            (Some(a), Some(b)) => {
                let (from, to) = (causal[a.0].0, causal[b.0].0);
                let share = (time - from) as f64 / (to - from) as f64;
                blended(&carried(a), &carried(b), share)
            }
        });
    }
    out
}

fn blended(a: &RigidTransform, b: &RigidTransform, share: f64) -> RigidTransform {
    let off = a.inverse() * *b;
    let turn = off.rotation().scaled_axis() * share;
    let shift = off.translation() * share;
    let part = RigidTransform::from_rotation_vector(turn.into(), shift.into());
    part.map_or(*a, |part| *a * part)
}

#[cfg(test)]
mod tests;
