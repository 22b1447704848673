//! The back end alone, on feature tracks of one camera and IMU samples, beside another smoother
//! (`cargo xtask bench gtsam`). Hidden from the documentation: odometry takes stereo images, and
//! this is no mode of it.
//!
//! Every set of bearings is a keyframe, and the first state is given. A landmark starts at a
//! guessed range; its inverse range is free.

use std::collections::{BTreeMap, BTreeSet};

use cad_transforms::RigidTransform;
use nalgebra::{DMatrix, Matrix6};

use super::keyframes::frame_to_marginalize;
use crate::backend::covariance::in_rig_frame;
use crate::backend::marginalization::marginalize;
use crate::backend::motion_factor;
use crate::backend::observation::{BearingObservation, Camera, CameraPose, transfer};
use crate::backend::solver::{Damping, for_each_residual, linearize, optimize_window};
use crate::backend::state::{STATE_DIM, State};
use crate::backend::window::{Frame, Landmark, MotionFactor, Prior, Window};
use crate::config::{Config, KeyframeConfig};
use crate::inertial::imu_set::body_frame;
use crate::inertial::propagation::ImuPropagator;
use crate::rig::Rig;
use camera_models::{Eye, ImuSample};

/// Inverse range of a new landmark, 1/m, if its bearings do not determine it.
const INITIAL_INVERSE_RANGE_PER_M: f64 = 0.2;
/// Standard deviation of an inverse range from bearings at known poses below which it is used, 1/m.
const MAX_INVERSE_RANGE_SIGMA_PER_M: f64 = 0.1;
/// Number of observations up to which an inverse range is computed again from the bearings.
const NEW_LANDMARK_OBSERVATIONS: usize = 5;
/// Observations from which a landmark continues when its host leaves: fewer do not keep its range.
const MIN_CONTINUED_OBSERVATIONS: usize = 4;
/// Minimum ratio of a landmark's range from its new host to that from its old one.
const MIN_RANGE_RATIO: f64 = 1e-3;
/// Number of solver iterations over all keyframes.
const ADJUSTMENT_ITERATIONS: usize = 40;

/// Bearings of one instant.
#[derive(Clone, Debug)]
pub struct Bearings {
    /// Time, ns.
    pub time_ns: i64,
    /// Track id, and position in the left image of the first camera, px.
    pub tracks: Vec<(u64, [f32; 2])>,
}

/// First state, with zero biases.
#[derive(Clone, Copy, Debug)]
pub struct FirstState {
    /// Pose of the first IMU.
    pub world_from_imu: RigidTransform,
    /// Velocity in the world, m/s.
    pub velocity: [f64; 3],
    /// Standard deviations of position m, rotation rad, velocity m/s, gyroscope bias rad/s and
    /// accelerometer bias m/s².
    pub sigmas: [f64; 5],
}

/// Pose at one set of bearings.
#[derive(Clone, Copy, Debug)]
pub struct TrackPose {
    /// Time, ns.
    pub time_ns: i64,
    /// Pose of the first IMU.
    pub world_from_imu: RigidTransform,
    /// Reported covariance of a small motion of the IMU in its own axes: m, rad.
    pub covariance: Matrix6<f64>,
    /// Covariance of the solver, without inflation, of the same motion.
    pub solver_covariance: Matrix6<f64>,
}

/// Poses at all sets of bearings: causal ones of the sliding window, and those of one optimization
/// over all of them. `None` without an IMU, or where samples are missing.
pub fn estimate(
    rig: &Rig,
    config: &Config,
    first: &FirstState,
    imu: &[ImuSample],
    sets: &[Bearings],
) -> Option<[Vec<TrackPose>; 2]> {
    let (cameras, _) = body_frame(rig);
    let body_from_imu = RigidTransform::identity();
    let mut propagator = ImuPropagator::new(rig.imus.first()?, &body_from_imu, &config.inertial);
    for sample in imu {
        propagator.push(sample);
    }
    let mut state = State::at_rest(sets.first()?.time_ns);
    state.position = *first.world_from_imu.translation();
    state.rotation = *first.world_from_imu.rotation();
    state.velocity = first.velocity.into();
    let sigmas: [f64; STATE_DIM] = std::array::from_fn(|k| first.sigmas[k / 3]);
    let mut window = Window {
        cameras,
        frames: vec![Frame {
            number: 0,
            state,
            motion: None,
        }],
        landmarks: BTreeMap::new(),
        prior: Prior::of(0, state, &sigmas),
        config: config.backend,
    };
    let mut all = window.clone();
    let mut outliers = BTreeSet::new();
    let mut poses = Vec::new();
    let mut states = Vec::new();
    let mut joint = window.prior.covariance();
    for (number, set) in (0..).zip(sets) {
        if number > 0 {
            let from = window.newest().state;
            window
                .frames
                .push(next_frame(&propagator, &from, number, set.time_ns)?);
            add_bearings(&mut window, number, set, &outliers);
            triangulate_new(&mut window);
            preintegrate_again(&mut window, &propagator)?;
            if let (_, Some(covariance)) =
                optimize_window(&mut window, config.backend.max_iterations, Damping::SETTLED)
            {
                joint = covariance;
            }
            outliers.extend(remove_outliers(&mut window));
        } else {
            add_bearings(&mut window, number, set, &outliers);
        }
        let newest = window.newest().state;
        let covariance = joint.pose();
        poses.push(pose(config, &newest, &covariance));
        states.push(newest);
        while window.frames.len() > config.backend.window_size {
            marginalize_one(&mut window, &config.estimator.keyframes);
        }
    }
    all.frames.truncate(1);
    for (number, (set, state)) in (0..).zip(sets.iter().zip(&states)) {
        if number > 0 {
            let from = all.newest().state;
            let mut frame = next_frame(&propagator, &from, number, set.time_ns)?;
            frame.state = *state;
            all.frames.push(frame);
        }
        add_bearings(&mut all, number, set, &BTreeSet::new());
    }
    // The last biases are the best ones.
    let last = all.newest().state;
    for frame in &mut all.frames {
        (frame.state.gyro_bias, frame.state.accel_bias) = (last.gyro_bias, last.accel_bias);
    }
    preintegrate_again(&mut all, &propagator)?;
    let adjusted = adjust(config, all)?;
    Some([poses, adjusted])
}

/// Poses of all frames after optimizations over all of them: outliers leave after the first one.
/// The host of a landmark is in the middle of its track: a tracked corner drifts, and the host has
/// no error of its own.
fn adjust(config: &Config, mut window: Window) -> Option<Vec<TrackPose>> {
    for landmark in window.landmarks.values_mut() {
        let middle = landmark.observations.len() / 2;
        landmark.observations[..=middle].rotate_right(1);
    }
    for landmark in window.landmarks.clone().keys() {
        let rho = triangulate(&window, &window.landmarks[landmark]);
        if let (Some(rho), Some(landmark)) = (rho, window.landmarks.get_mut(landmark)) {
            landmark.rho = rho;
        }
    }
    for _ in 0..2 {
        optimize_window(&mut window, ADJUSTMENT_ITERATIONS, Damping::SETTLED);
        remove_outliers(&mut window);
    }
    optimize_window(&mut window, ADJUSTMENT_ITERATIONS, Damping::SETTLED);
    let landmarks: Vec<&Landmark> = window.landmarks.values().collect();
    let information = linearize(&window, &landmarks, |_| true, 0.0).information;
    let covariance: DMatrix<f64> = information.cholesky()?.inverse();
    let poses = window.frames.iter().enumerate().map(|(k, frame)| {
        let own = covariance
            .fixed_view::<6, 6>(k * STATE_DIM, k * STATE_DIM)
            .into_owned();
        pose(config, &frame.state, &own)
    });
    Some(poses.collect())
}

fn pose(config: &Config, state: &State, covariance: &Matrix6<f64>) -> TrackPose {
    let body = RigidTransform::identity();
    let mut none = config.backend.covariance;
    (none.sigma_inflation, none.position_sigma_floor_m) = (1.0, 0.0);
    none.rotation_sigma_floor_rad = 0.0;
    let of = |settings| in_rig_frame(settings, state, &body, covariance);
    TrackPose {
        time_ns: state.time_ns,
        world_from_imu: state.world_from_rig(&body),
        covariance: of(&config.backend.covariance),
        solver_covariance: of(&none),
    }
}

/// The next frame, propagated by the IMU.
fn next_frame(imu: &ImuPropagator, from: &State, number: u64, time_ns: i64) -> Option<Frame> {
    let (preintegrated, has_gravity) = imu.preintegrate(from, time_ns, from.gyro_rate)?;
    let motion = MotionFactor {
        preintegrated,
        has_gravity,
        bias_walk: imu.bias_walk(),
    };
    Some(Frame {
        number,
        state: motion_factor::predict(&motion, from, &nalgebra::Vector3::zeros(), time_ns),
        motion: Some(motion),
    })
}

/// Preintegrates again where the estimated biases of a motion factor have changed: biases are not
/// known at the start, and a factor is linear in them. `None` where samples are missing.
fn preintegrate_again(window: &mut Window, imu: &ImuPropagator) -> Option<()> {
    for k in 1..window.frames.len() {
        let from = window.frames[k - 1].state;
        let to_ns = window.frames[k].state.time_ns;
        if let Some(motion) = &mut window.frames[k].motion {
            motion.preintegrated = imu.preintegrate(&from, to_ns, from.gyro_rate)?.0;
        }
    }
    Some(())
}

/// Adds the bearings of a frame to the landmarks of their tracks, or as hosts of new ones.
fn add_bearings(window: &mut Window, number: u64, set: &Bearings, outliers: &BTreeSet<u64>) {
    for (id, at) in set.tracks.iter().filter(|(id, _)| !outliers.contains(id)) {
        let Some(left) = window.cameras[0].bearing(Eye::Left, *at) else {
            continue;
        };
        let observation = BearingObservation {
            camera: 0,
            left,
            right: None,
            exposure_offset_s: 0.0,
        };
        let landmark = window.landmarks.entry(*id).or_insert_with(|| Landmark {
            rho: INITIAL_INVERSE_RANGE_PER_M,
            observations: Vec::new(),
        });
        landmark.observations.push((number, observation));
    }
}

/// Inverse range from the bearings of a landmark at the poses of the window, if they determine it.
fn triangulate(window: &Window, landmark: &Landmark) -> Option<f64> {
    let camera: &Camera = &window.cameras[0];
    let pose = |number: u64| {
        let frame = &window.frames[window.position(number)?];
        Some(CameraPose::new(&frame.state, 0.0))
    };
    let (host, observation) = &landmark.observations[0];
    let (host, ray) = (pose(*host)?, observation.left.ray);
    let (mut information, mut gradient) = (0.0, 0.0);
    for (number, observation) in &landmark.observations[1..] {
        let to = pose(*number)?;
        let point = transfer(&ray, 0.0, (camera, &host), (camera, &to));
        let by_rho = observation.left.basis * point.by_rho;
        information += by_rho.norm_squared();
        gradient += by_rho.dot(&(observation.left.basis * point.x));
    }
    let sigma = window.config.observation_sigma_px / information.sqrt();
    let rho = -gradient / information;
    (sigma < MAX_INVERSE_RANGE_SIGMA_PER_M && rho > 0.0).then_some(rho)
}

fn triangulate_new(window: &mut Window) {
    let ids: Vec<u64> = window.landmarks.keys().copied().collect();
    for id in ids {
        let landmark = &window.landmarks[&id];
        if landmark.observations.len() > NEW_LANDMARK_OBSERVATIONS {
            continue;
        }
        let rho = triangulate(window, landmark);
        if let (Some(rho), Some(landmark)) = (rho, window.landmarks.get_mut(&id)) {
            landmark.rho = rho;
        }
    }
}

/// Removes outliers, and landmarks of which more than a third are; returns the ids of these.
fn remove_outliers(window: &mut Window) -> Vec<u64> {
    let limit = window.config.outlier_sigma.powi(2);
    let mut removed = Vec::new();
    for id in window.landmarks.keys().copied().collect::<Vec<_>>() {
        let mut entries = Vec::new();
        for_each_residual(
            window,
            &window.landmarks[&id],
            |k, side, squared_residual| {
                if squared_residual > limit {
                    entries.push((k, side));
                }
            },
        );
        let Some(landmark) = window.landmarks.get_mut(&id) else {
            continue;
        };
        if 3 * entries.len() > landmark.observations.len() {
            window.landmarks.remove(&id);
            removed.push(id);
        } else {
            landmark.drop_observations(&entries);
        }
    }
    removed
}

/// Marginalizes a frame, as keyframes are: the oldest, or at rest the second newest. A landmark
/// that it hosts and that enough later frames observe continues with the next of them as host:
/// without stereo its range would have to be found again. Only its first bearing is lost.
fn marginalize_one(window: &mut Window, config: &KeyframeConfig) {
    let leaving = frame_to_marginalize(config, window);
    let number = window.frames[leaving].number;
    let ids: Vec<u64> = window.landmarks.keys().copied().collect();
    for id in ids {
        let landmark = &window.landmarks[&id];
        let hosts = landmark.observations[0].0 == number;
        if !hosts || landmark.observations.len() < MIN_CONTINUED_OBSERVATIONS {
            continue;
        }
        let to = landmark.observations[1].0;
        let pose = |number: u64| {
            let frame = window.position(number)?;
            Some(CameraPose::new(&window.frames[frame].state, 0.0))
        };
        let (Some(from), Some(to)) = (pose(number), pose(to)) else {
            continue;
        };
        let camera = &window.cameras[0];
        let ray = landmark.observations[0].1.left.ray;
        let point = transfer(&ray, landmark.rho, (camera, &from), (camera, &to));
        let rho = landmark.rho / point.x.norm().max(MIN_RANGE_RATIO);
        if let Some(landmark) = window.landmarks.get_mut(&id) {
            landmark.rho = rho;
            landmark.observations.remove(0);
        }
    }
    marginalize(window, leaving);
}

#[cfg(test)]
mod tests;
