//! Poses as they become known: the causal estimator.
//!
//! Contract: [`Odometry::add_imu`] takes samples in order of time, [`Odometry::add_frames`] frame sets in order of time, after
//! the samples up to their time (what comes later is used for what comes later). Each set gives one [`Estimate`] that
//! depends on what came before it alone. A set whose pictures show too little is carried by the IMU while its sigma stays
//! small; a pose that nothing supports is called lost, and its covariance says how much.

use std::collections::BTreeMap;

use cad_transforms::RigidTransform;
use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3};
use rayon::prelude::*;

use crate::anew::{self, Doubt, HEARD_NS, SILENT_NS};
use crate::doubt::{carried, own_covariance, tilted};
use crate::felt::{ImuInUse, leap};
use crate::input::{FrameSet, ImuSample};
use crate::keyframe::Keyframe;
use crate::pyramid::Pyramid;
use crate::rig::Rig;
use crate::settings::Settings;
use crate::shift::{self, Shift};
use crate::shown::Shown;
use crate::sight::{Camera, Placed};
use crate::solve::{solve, solve_newest};
use crate::start::{LOOK_NS, start};
use crate::state::{SIZE, State, TURN};
use crate::tracker::{Expected, Track, Tracker, moved};
use crate::window::{Frame, Motion, Prior, Window};

mod across;
mod keep;
mod refuse;
#[cfg(test)]
mod tests;

use keep::leave;
use refuse::agreeing;

/// Frame sets in the beginning for which everything is solved: biases and tilt are still to be found.
const SETTLING: u64 = 12;
/// Sights that a pose needs, and their share of all.
const FEWEST: usize = 12;
const LEAST_AGREED: f64 = 0.3;
/// Share of the turn of a camera that was moved by which poses may be turned: it is one of several, and sigmas are told larger
/// than this.
const SHIFT_SHARE: f64 = 0.1;
/// Sigma of a position along its worst direction from which it is no longer known: m, and share of the distance from the
/// start.
const LOST_M: f64 = 0.5;
const OF_WAY: f64 = 0.02;

/// How a pose is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Cameras saw enough.
    Tracked,
    /// The IMU alone, or very few sights.
    DeadReckoned,
    /// Nothing supports it.
    Lost,
}

/// One pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Of the frame set, ns.
    pub time_ns: i64,
    /// The world has z up, and its origin and heading are those of the first pose: of the first IMU where one is used, of the rig
    /// where there is none.
    pub world_from_rig: RigidTransform,
    /// Of a small motion of the rig in its own axes against the first pose: shift m, turn rad.
    pub covariance: Matrix6<f64>,
    /// Of the rig's origin in the world, m/s.
    pub velocity: Vector3<f64>,
    /// How it is known.
    pub status: Status,
    /// Sights that agree.
    pub sights: usize,
    /// Whether it is a keyframe.
    pub is_keyframe: bool,
    /// Bias of the gyroscope in use, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Bias of the accelerometer in use, m/s².
    pub accel_bias: Vector3<f64>,
}

/// See the module.
pub struct Odometry {
    settings: Settings,
    cameras: Vec<Camera>,
    body_from_rig: RigidTransform,
    imu: Option<ImuInUse>,
    trackers: Vec<Tracker>,
    /// What each camera's left eye showed last that was new.
    shown: Vec<Option<Shown>>,
    window: Option<Window>,
    /// Whether the newest frame of the window is a keyframe.
    newest_stays: bool,
    /// Covariance of the last keyframe's state.
    kept: SMatrix<f64, SIZE, SIZE>,
    last: Option<State>,
    /// Whether the way is lost until the window has begun anew.
    is_adrift: bool,
    /// What is in doubt beyond what the window says.
    doubts: Vec<Doubt>,
    shifts: Vec<Shift>,
    /// Length of the way from keyframe to keyframe, m.
    way_m: f64,
    number: u64,
    next_track: u64,
    /// Corners of the last keyframe: camera, number, ray then.
    reference: Vec<(usize, u64, Vector3<f64>)>,
    /// Keyframes that are still in the window, and those that have left it.
    pending: BTreeMap<u64, Keyframe>,
    ready: Vec<Keyframe>,
}

impl Odometry {
    /// For a rig.
    pub fn new(rig: &Rig, settings: Settings) -> Self {
        let (cameras, body_from_rig, imu) = ImuInUse::of(rig);
        Self {
            settings,
            cameras,
            body_from_rig,
            imu,
            trackers: vec![Tracker::default(); rig.cameras.len()],
            shown: vec![None; rig.cameras.len()],
            window: None,
            newest_stays: true,
            kept: SMatrix::zeros(),
            last: None,
            is_adrift: false,
            doubts: Vec::new(),
            shifts: Vec::new(),
            way_m: 0.0,
            number: 0,
            next_track: 0,
            reference: Vec::new(),
            pending: BTreeMap::new(),
            ready: Vec::new(),
        }
    }

    /// Takes a sample of an IMU, given by its place in the rig.
    pub fn add_imu(&mut self, imu: usize, sample: &ImuSample) {
        if let Some(own) = self.imu.as_mut().filter(|own| own.index == imu) {
            own.samples.push(sample, own.range);
        }
    }

    /// Takes a frame set.
    pub fn add_frames(&mut self, set: &FrameSet<'_>) -> Estimate {
        let time_ns = set.time_ns;
        self.number += 1;
        let pyramids: Vec<Option<(Pyramid, Pyramid)>> = (set.views.par_iter())
            .map(|view| {
                let view = view.as_ref()?;
                Some(rayon::join(
                    || Pyramid::new(&view.left),
                    || Pyramid::new(&view.right),
                ))
            })
            .collect();
        for (tracker, view) in self.trackers.iter_mut().zip(&set.views) {
            tracker.may_use(view.as_ref().and_then(|v| v.usable));
        }
        let after_s: Vec<f64> = (set.views.iter())
            .map(|view| {
                view.as_ref()
                    .map_or(0.0, |v| (v.time_ns - time_ns) as f64 * 1e-9)
            })
            .collect();
        let Some(mut window) = self.window.take() else {
            return self.begin(time_ns, pyramids, &after_s);
        };
        if !self.newest_stays {
            window.drop_newest();
        }
        let (motion, guess) = self.predict(&window, time_ns);
        // Corners are expected where the last pose, whether or not it stays, and the guess put them.
        let last = self.last.unwrap_or(window.newest().state);
        self.follow(pyramids, (&last, &guess), &after_s);
        window.frames.push(Frame {
            number: self.number,
            state: guess,
            motion: Some(motion),
        });
        self.look(&mut window, &after_s);
        let mut information = self.locate(&mut window);
        if let Some(shift) = shift::find(&window) {
            let sigma = SHIFT_SHARE * shift.turned;
            self.doubts
                .push(Doubt::of_turn(window.newest().state, sigma));
            self.shifts.push(shift);
        }
        let (_, looked) = agreeing(&window);
        let sights = self.reject(&mut window);
        let is_enough = sights >= FEWEST && sights as f64 >= LEAST_AGREED * looked as f64;
        let is_seen = is_enough && !self.is_adrift;
        let mut is_tied = true;
        if !is_seen {
            // A few that agree by chance would be believed: the frame goes by what was felt.
            is_tied = self.overlook(&mut window, guess);
            information = solve_newest(&mut window, &self.kept, 1);
        }
        let is_keyframe = self.is_keyframe(&window, is_seen);
        let mut own = information.and_then(|h| h.cholesky()).map(|c| c.inverse());
        let mut joint = None;
        if is_keyframe || self.settings.every || self.number <= SETTLING {
            joint = solve(&mut window, self.settings.rounds).1;
        }
        if let Some(joint) = joint {
            if is_keyframe {
                self.kept = joint;
            }
            own = None;
        }
        let kept = || {
            let from = &window.frames[window.frames.len() - 2].state;
            let covariance = self.kept.fixed_view::<6, 6>(0, 0).into_owned();
            carried(from, &window.newest().state, &covariance)
        };
        let covariance = match (joint, own) {
            (Some(joint), _) => joint.fixed_view::<6, 6>(0, 0).into_owned(),
            (None, Some(own)) => kept() + own.fixed_view::<6, 6>(0, 0),
            (None, None) => kept() + Matrix6::identity(),
        };
        if is_keyframe {
            let before = &window.frames[window.frames.len() - 2].state;
            self.way_m += (window.newest().state.position - before.position).norm();
            self.prune(&mut window);
            self.keep(&mut window, &after_s);
        }
        self.newest_stays = is_keyframe;
        self.is_adrift |= !is_tied && anew::is_lost(&covariance);
        let estimate = self.estimate(&window, &covariance, sights, is_seen, is_keyframe);
        if self.is_adrift {
            self.begin_again(&mut window, &covariance);
        }
        let mut state = window.newest().state;
        if self.read_rate(time_ns).is_none() {
            // A body without a gyroscope goes on as it went.
            let seconds = (state.time_ns - last.time_ns) as f64 * 1e-9;
            let turned = crate::so3::log(&(last.turn.inverse() * state.turn));
            state.read_rate = turned / seconds.max(1e-3) + state.gyro_bias;
            if let Some(newest) = window.frames.last_mut() {
                newest.state.read_rate = state.read_rate;
            }
        }
        self.last = Some(state);
        if let (Some(imu), Some(first)) = (&mut self.imu, window.frames.last()) {
            // The window integrates anew from its last keyframe.
            let from = if self.newest_stays {
                first.state.time_ns
            } else {
                window.frames[window.frames.len() - 2].state.time_ns
            };
            imu.samples.forget_before(from.min(time_ns) - LOOK_NS);
        }
        self.window = Some(window);
        estimate
    }

    /// Follows all corners into new pictures, from where the body was to where it is taken to be.
    fn follow(
        &mut self,
        pyramids: Vec<Option<(Pyramid, Pyramid)>>,
        (last, guess): (&State, &State),
        after_s: &[f64],
    ) {
        for (k, (tracker, pyramids)) in self.trackers.iter_mut().zip(pyramids).enumerate() {
            let camera = &self.cameras[k];
            let shown = &mut self.shown[k];
            let fresh = pyramids
                .as_ref()
                .map_or(0, |(left, _)| Shown::take(shown, left, guess, camera));
            let (Some((left, right)), 1..) = (pyramids, fresh) else {
                tracker.clear();
                continue;
            };
            tracker.may_use_rows(fresh, left.levels[0].width, left.levels[0].height);
            let (then, now) = (
                left_eye(camera, &Placed::new(last, after_s[k])),
                left_eye(camera, &Placed::new(guess, after_s[k])),
            );
            let back = now.0.transpose();
            let now_from_then = (back * then.0, back * (then.1 - now.1));
            tracker.follow(camera, left, right, |track| {
                let rho = track.rho.unwrap_or(0.0);
                let expected = moved(camera, &now_from_then, &track.left.ray, rho);
                expected.map_or(
                    Expected {
                        at: track.at,
                        rho: track.rho,
                    },
                    |e| Expected {
                        rho: track.rho.and(e.rho),
                        ..e
                    },
                )
            });
        }
    }

    /// The first frame set.
    fn begin(
        &mut self,
        time_ns: i64,
        pyramids: Vec<Option<(Pyramid, Pyramid)>>,
        after_s: &[f64],
    ) -> Estimate {
        let mut readings = Vec::new();
        if let Some(imu) = &self.imu {
            // What was heard without a gap up to now; a single reading tells nothing of rest, but roughly where up is.
            let since = imu.samples.heard_since(time_ns).unwrap_or(time_ns);
            if since < time_ns {
                let from = since.max(time_ns - LOOK_NS);
                imu.samples.between(from, time_ns, &mut readings);
            } else {
                let near = imu.samples.at(time_ns);
                let near = near.filter(|(reading, is_near)| *is_near && !reading.clipped);
                readings.extend(near.map(|(reading, _)| reading));
            }
        }
        let (state, sigmas) = start(time_ns, &readings, self.imu.is_some());
        let mut window = self.window_of(state, &sigmas);
        for (k, (tracker, pyramids)) in self.trackers.iter_mut().zip(pyramids).enumerate() {
            if let Some((left, right)) = pyramids {
                Shown::take(&mut self.shown[k], &left, &state, &self.cameras[k]);
                tracker.follow(&self.cameras[k], left, right, |track| Expected {
                    at: track.at,
                    rho: None,
                });
            }
        }
        self.keep(&mut window, after_s);
        self.newest_stays = true;
        self.last = Some(state);
        self.kept = window.prior.covariance();
        let covariance = self.kept.fixed_view::<6, 6>(0, 0).into_owned();
        let sights = window.landmarks.len();
        let estimate = self.estimate(&window, &covariance, sights, sights >= FEWEST, true);
        self.window = Some(window);
        estimate
    }

    /// A window of the newest frame alone. Its place and heading are known, by definition.
    fn window_of(&self, state: State, sigmas: &[f64; SIZE]) -> Window {
        let mut prior = Prior::of(self.number, state, sigmas);
        let up = state.turn.inverse() * Vector3::z();
        let pinned = up * up.transpose() * (1e8 - 1.0 / (sigmas[TURN] * sigmas[TURN])).max(0.0);
        let mut view = prior.information.fixed_view_mut::<3, 3>(TURN, TURN);
        view += pinned;
        Window {
            cameras: self.cameras.clone(),
            mounts: Vec::new(),
            frames: vec![Frame {
                number: self.number,
                state,
                motion: None,
            }],
            landmarks: BTreeMap::new(),
            prior,
            sigma_px: self.settings.sigma_px,
        }
    }

    /// The newest frame begins a window of its own, once enough is seen and felt; see [`anew`]. `covariance` is that of its pose
    /// in the window so far, which nothing that it sees is tied to.
    fn begin_again(&mut self, window: &mut Window, covariance: &Matrix6<f64>) {
        let guess = window.newest().state;
        let mut readings = Vec::new();
        if let Some(imu) = &self.imu {
            let until = guess.time_ns;
            let heard = imu.samples.heard_since(until);
            let is_silent = (imu.samples.last_ns()).is_none_or(|last| until - last > SILENT_NS);
            match heard {
                Some(since) if until - since >= HEARD_NS => {
                    let from = since.max(until - LOOK_NS);
                    imu.samples.between(from, until, &mut readings);
                }
                _ if is_silent => {}
                _ => return,
            }
        }
        if window.landmarks.len() < FEWEST {
            return;
        }
        let covariance = self.with_doubt(&guess, *covariance);
        let (state, sigmas, doubt) =
            anew::begin(&guess, &covariance, &readings, self.imu.is_some());
        for frame in &window.frames[..window.frames.len() - 1] {
            self.ready.extend(leave(&mut self.pending, frame));
        }
        if let Some(keyframe) = self.pending.get_mut(&self.number) {
            keyframe.state = (&state).into();
        }
        // All landmarks are the newest frame's own.
        let landmarks = std::mem::take(&mut window.landmarks);
        *window = Window {
            landmarks,
            ..self.window_of(state, &sigmas)
        };
        self.kept = window.prior.covariance();
        // What was in doubt before is in this one.
        self.doubts = vec![doubt];
        self.is_adrift = false;
    }

    /// A covariance of a pose in the window with what was in doubt when the window began.
    fn with_doubt(&self, state: &State, covariance: Matrix6<f64>) -> Matrix6<f64> {
        let each = self.doubts.iter().map(|doubt| doubt.at(state));
        each.fold(covariance, |sum, more| sum + more)
    }

    /// What lies between the newest frame of the window and now, and where that puts the body.
    fn predict(&self, window: &Window, time_ns: i64) -> (Motion, State) {
        let from = &window.newest().state;
        let seconds = (time_ns - from.time_ns) as f64 * 1e-9;
        let felt = self.imu.as_ref().and_then(|imu| imu.felt(from, time_ns));
        let has_gravity = felt.is_some();
        let felt = felt.unwrap_or_else(|| leap(from, self.rate(), time_ns));
        let gravity = if has_gravity {
            Vector3::new(0.0, 0.0, -crate::state::GRAVITY)
        } else {
            Vector3::zeros()
        };
        let read_rate = self.read_rate(time_ns).unwrap_or(from.read_rate);
        let guess = State {
            time_ns,
            position: from.position
                + from.velocity * seconds
                + gravity * (0.5 * seconds * seconds)
                + from.turn * felt.displacement,
            turn: from.turn * felt.turn,
            velocity: from.velocity + gravity * seconds + from.turn * felt.velocity,
            read_rate,
            ..*from
        };
        let walk = self.imu.as_ref().map_or([1e-6; 2], ImuInUse::walk);
        let motion = Motion {
            felt,
            has_gravity,
            walk,
        };
        (motion, guess)
    }

    /// The rate that the gyroscope reads at a time, rad/s; none where it is silent or at its end.
    fn read_rate(&self, time_ns: i64) -> Option<Vector3<f64>> {
        let (reading, is_near) = self.imu.as_ref()?.samples.at(time_ns)?;
        (is_near && !reading.clipped).then_some(reading.gyro)
    }

    /// How it turned last, about its own axes, rad/s.
    fn rate(&self) -> Vector3<f64> {
        self.last.as_ref().map_or(Vector3::zeros(), State::rate)
    }

    /// Enters what the newest frame sees of landmarks.
    fn look(&self, window: &mut Window, after_s: &[f64]) {
        for (k, tracker) in self.trackers.iter().enumerate() {
            for track in &tracker.tracks {
                if let Some(landmark) = window.landmarks.get_mut(&track.id) {
                    let sight = track.sight(k, &self.cameras[k], after_s[k]);
                    landmark.sights.push((self.number, sight));
                }
            }
        }
    }

    fn estimate(
        &self,
        window: &Window,
        covariance: &Matrix6<f64>,
        sights: usize,
        is_seen: bool,
        is_keyframe: bool,
    ) -> Estimate {
        let state = &window.newest().state;
        let covariance = self.with_doubt(state, *covariance);
        let mut covariance = own_covariance(state, &self.body_from_rig, self.way_m, &covariance);
        let status = if is_seen {
            Status::Tracked
        } else {
            let unsure = covariance
                .fixed_view::<3, 3>(0, 0)
                .symmetric_eigenvalues()
                .amax();
            let is_near = unsure.sqrt() < LOST_M + OF_WAY * state.position.norm();
            if is_near && !self.is_adrift {
                Status::DeadReckoned
            } else {
                Status::Lost
            }
        };
        let arm = self.body_from_rig.translation();
        let velocity = state.velocity + state.turn * state.rate().cross(arm);
        let world_from_rig = state.world_from_rig(&self.body_from_rig);
        if self.imu.is_none() {
            covariance += tilted(&world_from_rig);
        }
        Estimate {
            time_ns: state.time_ns,
            world_from_rig,
            covariance,
            velocity,
            status,
            sights,
            is_keyframe,
            gyro_bias: state.gyro_bias,
            accel_bias: state.accel_bias,
        }
    }

    /// Cameras that were moved on their plate, as it seemed when it happened, in order of time.
    pub fn shifts(&self) -> &[Shift] {
        &self.shifts
    }

    /// What is followed now in one camera's left picture: number and place, for pictures of how it goes.
    pub fn followed(&self, camera: usize) -> Vec<(u64, [f32; 2])> {
        let tracks = &self.trackers[camera].tracks;
        tracks.iter().map(|t: &Track| (t.id, t.at)).collect()
    }
}

/// World from left eye.
fn left_eye(camera: &Camera, placed: &Placed) -> (Matrix3<f64>, Vector3<f64>) {
    let (turn, arm) = &camera.body_from_left;
    (placed.turn * turn, placed.position + placed.turn * arm)
}
