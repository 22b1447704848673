//! Synthetic scene without noise: the solution must equal the ground truth, from a start so far
//! away that wrong Jacobians would not converge.

use std::collections::BTreeMap;

use cad_transforms::{RigidTransform, so3};
use camera_models::{CameraModel, Distortion, Eye as Side};

use super::*;
use crate::backend::extrinsics::ExtrinsicsPrior;
use crate::backend::gyro_scale::GyroScale;
use crate::backend::marginalization::marginalize;
use crate::backend::newest_pose::{pose_by_calibrations, refine_newest};
use crate::backend::observation::{BearingObservation, Camera};
use crate::backend::state::{POSITION, ROTATION, State, VELOCITY};
use crate::backend::stereo::StereoVector;
use crate::backend::window::{Frame, MotionFactor, Prior};
use crate::inertial::imu_buffer::{Preintegration, Reading};
use crate::rig::StereoCamera;

pub(crate) fn camera(yaw: f64, line_s: f64) -> Camera {
    let model = CameraModel {
        width: 672,
        height: 376,
        fx: 350.0,
        fy: 350.0,
        cx: 335.5,
        cy: 187.5,
        distortion: Distortion::RadTan4 {
            k1: -0.05,
            k2: 0.01,
            p1: 0.0,
            p2: 0.0,
        },
    };
    let shift = |x: f64| RigidTransform::from_translation_m([x, 0.0, 0.0]).unwrap();
    let rotation = RigidTransform::from_rotation_vector([0.0, yaw, 0.0], [0.1 * yaw, 0.05, 0.02]);
    Camera::new(
        &StereoCamera {
            name: "camera".to_owned(),
            left: model,
            right: model,
            rig_from_left: rotation.unwrap(),
            covariance: None,
            right_from_left: shift(-0.06),
            right_from_left_covariance: None,
            line_s,
        },
        &RigidTransform::identity(),
    )
}

/// A body that moves sideways and rotates.
fn truth(k: usize) -> State {
    let t = k as f64 * 0.1;
    State {
        position: Vector3::new(1.5 * t, 0.1 * (3.0 * t).sin(), 0.2 * t),
        rotation: so3::exp(Vector3::new(0.1 * t, 0.5 * t, -0.1)),
        velocity: Vector3::new(1.5, 0.3 * (3.0 * t).cos(), 0.2),
        gyro_rate: Vector3::new(0.1, 0.5, 0.0),
        ..State::at_rest((t * 1e9) as i64)
    }
}

/// Noise-free observations of surrounding points by two cameras.
pub(crate) fn window(frames: usize, line_s: f64) -> Window {
    window_of(vec![camera(-0.5, 0.0), camera(0.4, line_s)], frames)
}

/// The same by these cameras.
pub(crate) fn window_of(cameras: Vec<Camera>, frames: usize) -> Window {
    let mut landmarks: BTreeMap<u64, Landmark> = BTreeMap::new();
    for id in 0..240_u64 {
        let a = (id as f64 * 0.618).fract() * 2.4 - 1.2;
        let b = (id as f64 * 0.414).fract() - 0.5;
        let range = 1.5 + 6.0 * (id as f64 * 0.732).fract();
        let x_in_world = Vector3::new(range * a.sin(), range * b, range * a.cos());
        for k in 0..frames {
            for (c, camera) in cameras.iter().enumerate() {
                // The time of a row depends on the pixel, and the pixel on the time.
                let after_camera = 0.004 * c as f64;
                let mut exposure_offset_s = after_camera;
                let mut observation = None;
                for _ in 0..20 {
                    let camera_pose = CameraPose::new(&truth(k), exposure_offset_s);
                    let (rotation, arm) = &camera.body_from_left;
                    let in_body =
                        camera_pose.rotation.transpose() * (x_in_world - camera_pose.position);
                    let x = rotation.transpose() * (in_body - arm);
                    let Some(pixel) = camera.left.project(x.into()) else {
                        break;
                    };
                    let inside =
                        (0.0..671.0).contains(&pixel[0]) && (0.0..375.0).contains(&pixel[1]);
                    if !inside || x.z < 0.3 {
                        observation = None;
                        break;
                    }
                    let y = pixel[1] as f32;
                    exposure_offset_s = after_camera + camera.row_after_s(Side::Left, y);
                    let (rl, tl) = &camera.right_from_left;
                    let right = camera.right.project((rl * x + tl).into()).unwrap();
                    observation = Some((pixel, right, x.norm()));
                }
                let Some((pixel, right, range)) = observation else {
                    continue;
                };
                // Directly to bearings: pixels have single precision.
                let exact = |side: Side, pixel: [f64; 2]| {
                    let lens = if side == Side::Left {
                        &camera.left
                    } else {
                        &camera.right
                    };
                    let mut bearing = camera.bearing(side, pixel.map(|v| v as f32)).unwrap();
                    let ray = Vector3::from(lens.unproject(pixel).unwrap()).normalize();
                    let first = ray.cross(&Vector3::y()).normalize();
                    let rows = [first.transpose(), ray.cross(&first).transpose()];
                    bearing.basis = nalgebra::Matrix2x3::from_rows(&rows) * 350.0;
                    bearing.ray = ray;
                    bearing
                };
                let observation = BearingObservation {
                    camera: c,
                    left: exact(Side::Left, pixel),
                    right: Some(exact(Side::Right, right)),
                    exposure_offset_s,
                };
                landmarks
                    .entry(id)
                    .or_insert_with(|| Landmark {
                        rho: 1.0 / range,
                        observations: Vec::new(),
                    })
                    .observations
                    .push((k as u64, observation));
            }
        }
    }
    Window {
        frames: (0..frames)
            .map(|k| Frame {
                number: k as u64,
                state: truth(k),
                motion: None,
            })
            .collect(),
        landmarks,
        prior: Prior::of(0, truth(0), &[1e-4; STATE_DIM]),
        cameras,
        config: Default::default(),
    }
}

/// Perturbs all states and landmarks.
fn shaken(window: &Window, by: f64) -> Window {
    let mut shaken = window.clone();
    for (k, frame) in shaken.frames.iter_mut().enumerate().skip(1) {
        let mut error = Error::zeros();
        for i in 0..3 {
            error[POSITION + i] = by * ((k * 3 + i) as f64 * 1.7).sin();
            error[ROTATION + i] = 0.3 * by * ((k * 5 + i) as f64 * 1.3).cos();
        }
        frame.state = frame.state.plus(&error);
    }
    for (k, landmark) in shaken.landmarks.values_mut().enumerate() {
        landmark.rho *= 1.0 + by * (k as f64 * 0.9).sin();
    }
    shaken
}

fn farthest(window: &Window) -> f64 {
    let residual = |frame: &Frame| {
        let error = frame.state.minus(&truth(frame.number as usize));
        error.fixed_rows::<POSE_DIM>(0).amax()
    };
    window.frames.iter().map(residual).fold(0.0, f64::max)
}

/// Covariance of an earlier state: 1 in all units, an exact gyroscope scale.
pub(crate) fn start_covariance() -> NewestCovariance {
    NewestCovariance {
        joint: DMatrix::identity(STATE_DIM, STATE_DIM),
        gyro_scale: nalgebra::Matrix3::zeros(),
    }
}

#[test]
fn window_converges_to_the_ground_truth_from_a_distant_start() {
    for line_s in [0.0, 2e-5] {
        let exact = window(5, line_s);
        assert!(exact.landmarks.len() > 100);
        let mut moved = shaken(&exact, 0.1);
        assert!(farthest(&moved) > 0.05);
        let (solved, _) = optimize_window(&mut moved, 20, Damping::SETTLED);
        // At the ground truth the ray at the time of a rolling-shutter row is exact up to rounding.
        assert!(farthest(&moved) < 1e-6, "{} {solved:?}", farthest(&moved));
        assert!(solved.cost[1] < 1e-6, "{solved:?}");
    }
}

/// Velocity and biases are not observed: a constant-velocity factor constrains them weakly.
pub(crate) fn add_constant_velocity(window: &mut Window) {
    connect(window, window.frames.len() - 1);
}

/// Connects a frame to the one before by a constant-velocity factor.
fn connect(window: &mut Window, frame: usize) {
    window.frames[frame].motion = Some(MotionFactor {
        preintegrated: crate::inertial::propagation::constant_velocity(
            &Default::default(),
            &window.frames[frame - 1].state,
            truth(frame - 1).rate(),
            window.frames[frame].state.time_ns,
        ),
        has_gravity: false,
        bias_walk: [1e-6; 2],
    });
}

/// As after a time without images: nothing but motion connects the first frame to the others, which
/// all have the same error.
#[test]
fn weakly_connected_frames_move_together() {
    let mut window = window(6, 0.0);
    for landmark in window.landmarks.values_mut() {
        landmark.observations.retain(|(number, _)| *number > 0);
    }
    (window.landmarks).retain(|_, landmark| !landmark.observations.is_empty());
    for landmark in window.landmarks.values_mut() {
        let host = &landmark.observations[0].1;
        let right = host.right.expect("a stereo match");
        landmark.rho = window.cameras[host.camera]
            .triangulate(&host.left, &right)
            .0;
    }
    let mut sigmas = [1e-4; STATE_DIM];
    sigmas[VELOCITY..VELOCITY + 3].fill(3.0);
    window.prior = Prior::of(0, truth(0), &sigmas);
    for frame in 1..window.frames.len() {
        connect(&mut window, frame);
    }
    let mut optimum = window.clone();
    optimize_window(&mut optimum, 40, Damping::SETTLED);
    let mut moved = window;
    for frame in &mut moved.frames[1..] {
        frame.state.position.x += 1.0;
    }
    optimize_window(&mut moved, 4, Damping::SETTLED);
    for (frame, expected) in moved.frames.iter().zip(&optimum.frames) {
        let error = frame.state.position - expected.state.position;
        assert!(error.norm() < 0.02, "{}: {error}", frame.number);
    }
}

#[test]
fn newest_state_alone_converges_to_the_ground_truth() {
    let exact = window(4, 0.0);
    let mut moved = exact.clone();
    let mut error = Error::zeros();
    error[0] = 0.03;
    error[4] = -0.01;
    let last = moved.frames.len() - 1;
    moved.frames[last].state = moved.frames[last].state.plus(&error);
    add_constant_velocity(&mut moved);
    assert!(farthest(&moved) > 0.02);
    let information = refine_newest(&mut moved, &start_covariance(), 8, |_| true);
    let information = information.expect("hundreds of observations determine the pose");
    assert!(farthest(&moved) < 1e-4, "{}", farthest(&moved));
    let sigma = |times| {
        let covariance = information.pose_covariance(times).expect("a covariance");
        covariance[(POSITION, POSITION)].sqrt()
    };
    assert!(sigma(1.0) < 0.01, "{}", sigma(1.0));
    // Images alone determine the pose here.
    let ratio = sigma(2.0) / sigma(1.0);
    assert!(ratio > 1.9 && ratio < 2.0 + 1e-9, "{ratio}");
}

#[test]
fn newest_pose_depends_on_the_calibrations_as_its_derivative_says() {
    let mut exact = window(4, 0.0);
    add_constant_velocity(&mut exact);
    let estimate = |window: &mut Window| refine_newest(window, &start_covariance(), 8, |_| true);
    let information = estimate(&mut exact).expect("hundreds of observations determine the pose");
    let derivative = pose_by_calibrations(&exact, &information).expect("a derivative");
    let check = |column: usize, error: f64, mut other: Window| {
        estimate(&mut other).expect("as determined");
        let change = other.newest().state.minus(&exact.newest().state);
        let change = change.fixed_rows::<POSE_DIM>(0);
        let expected = derivative.column(column) * error;
        let deviation = (change - expected).norm();
        assert!(
            deviation < 0.1 * expected.norm() + 1e-7,
            "{column}: {change} instead of {expected}"
        );
    };
    let cameras = exact.cameras.len();
    for column in 0..cameras * POSE_DIM {
        let mut error = nalgebra::Vector6::zeros();
        error[column % POSE_DIM] = 2e-5;
        let mut other = exact.clone();
        extrinsics::apply_error(&mut other.cameras[column / POSE_DIM].body_from_left, &error);
        check(column, 2e-5, other);
    }
    // The decentering, which is last, hardly changes inverse ranges.
    for component in 0..STEREO_DIM - 1 {
        let mut error = StereoVector::zeros();
        error[component] = 2e-5;
        let mut other = exact.clone();
        stereo::apply_error(&mut other.cameras[0], &error);
        // Inverse ranges follow the calibration of the host.
        for landmark in other.landmarks.values_mut() {
            let host = &landmark.observations[0].1;
            if let (0, Some(right)) = (host.camera, &host.right) {
                landmark.rho = other.cameras[0].triangulate(&host.left, right).0;
            }
        }
        check(cameras * POSE_DIM + component, 2e-5, other);
    }
}

#[test]
fn saturated_observation_does_not_block_convergence() {
    let exact = window(5, 0.0);
    let mut moved = shaken(&exact, 0.05);
    // A bearing that points behind the camera.
    let landmark = moved.landmarks.values_mut().next().expect("landmarks");
    let (_, observation) = landmark.observations.last_mut().expect("observations");
    observation.left.ray = -observation.left.ray;
    observation.left.basis = -observation.left.basis;
    let all: Vec<&Landmark> = moved.landmarks.values().collect();
    let linear = linearize(&moved, &all, |_| true, 0.0);
    let sum = cost(&moved, &all);
    assert!(
        (linear.cost - sum).abs() < 1e-9 * sum,
        "{} {sum}",
        linear.cost
    );
    let (solved, _) = optimize_window(&mut moved, 20, Damping::SETTLED);
    assert!(farthest(&moved) < 1e-5, "{} {solved:?}", farthest(&moved));
}

#[test]
fn result_does_not_depend_on_the_number_of_threads() {
    let moved = shaken(&window(5, 0.0), 0.05);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let mut window = moved.clone();
        pool.install(|| optimize_window(&mut window, 3, Damping::SETTLED));
        window.frames.iter().map(|f| f.state).collect::<Vec<_>>()
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn marginalized_frame_remains_in_the_prior() {
    // With noise-free observations a prior does not change the solution.
    let mut small = window(5, 0.0);
    marginalize(&mut small, 0);
    assert_eq!(small.frames.len(), 4);
    let mut moved = shaken(&small, 0.03);
    let (_, covariance) = optimize_window(&mut moved, 20, Damping::SETTLED);
    assert!(farthest(&moved) < 1e-5, "{}", farthest(&moved));
    // The position of the marginalized frame is known to a tenth of a millimeter, and its landmarks
    // connect the next one to it.
    let sigma = 1.0 / small.prior.information[(POSITION, POSITION)].sqrt();
    assert!(sigma > 1e-6 && sigma < 0.02, "{sigma}");
    // Without an IMU velocities are unknown, and the covariance states it.
    assert!(covariance.is_none());
}

/// Connects frames by a gyroscope with these scale errors, in sigmas; its biases are known.
fn add_gyroscope(window: &mut Window, scale: &Vector3<f64>) {
    let config = crate::config::InertialConfig::default();
    let noise = camera_models::ImuNoise {
        gyro_noise_density: 1e-5,
        gyro_random_walk: 1e-9,
        accel_noise_density: 10.0,
        accel_random_walk: 1e-9,
    };
    let zero = Vector3::zeros();
    for k in 1..window.frames.len() {
        let [from, to] = [k - 1, k].map(truth);
        let seconds = (to.time_ns - from.time_ns) as f64 * 1e-9;
        let angle = so3::log(&(from.rotation.inverse() * to.rotation));
        let reading = angle.component_mul(&scale.map(|s| 1.0 + s * config.gyro_scale_sigma));
        let readings = [from.time_ns, to.time_ns].map(|time_ns| Reading {
            time_ns,
            gyro: reading / seconds,
            accel: zero,
            saturated: [false; 2],
        });
        window.frames[k].motion = Some(MotionFactor {
            preintegrated: Preintegration::new(&readings, &zero, &zero, &noise, &config),
            has_gravity: false,
            bias_walk: [1e-9; 2],
        });
    }
    let inflation = window.config.covariance.sigma_inflation;
    let information = GyroScale::prior_information(inflation);
    window.prior = (window.prior.clone()).with_gyro_scale(Vector3::zeros(), information);
}

#[test]
fn gyroscope_scale_is_estimated_and_remains_after_marginalization() {
    // The window rotates about y, so that only this error is determined.
    let scale = Vector3::new(0.0, 2.0, 0.0);
    let mut whole = window(12, 0.0);
    add_gyroscope(&mut whole, &scale);
    let mut small = whole.clone();
    optimize_window(&mut whole, 20, Damping::SETTLED);
    let found = whole.prior.gyro_scale.error;
    assert!((1.6..2.05).contains(&found.y), "{found}");
    assert!(found.x.abs() < 0.3 && found.z.abs() < 0.3, "{found}");
    assert!(farthest(&whole) < 2e-3, "{}", farthest(&whole));

    optimize_window(&mut small, 20, Damping::SETTLED);
    for _ in 0..6 {
        marginalize(&mut small, 0);
    }
    // What the prior knows is independent of where the iteration starts.
    small.prior.gyro_scale.error = Vector3::zeros();
    let (_, covariance) = optimize_window(&mut small, 20, Damping::SETTLED);
    let of_prior = small.prior.gyro_scale.error;
    assert!((of_prior - found).amax() < 0.05, "{of_prior} {found}");
    assert!(covariance.is_some());
}

#[test]
fn extrinsics_are_estimated_and_remain_after_marginalization() {
    let exact = window(6, 0.0);
    let config = &exact.config;
    let both = [0.06, 0.06].map(crate::test_rig::stereo);
    let priors = ExtrinsicsPrior::of_rig(&config.extrinsics, &both, &exact.cameras);
    let stereo = stereo::prior_information(config, &both);
    let information = extrinsics::joint_information(&priors, 1.0, &stereo);
    let mut moved = exact.clone();
    moved.prior = moved.prior.with_calibrations(&exact.cameras, &information);
    add_gyroscope(&mut moved, &Vector3::zeros());
    let error = nalgebra::Vector6::new(0.0, 0.0, 0.0, 3e-3, -2e-3, 4e-3);
    // The nominal extrinsics of one camera are wrong.
    extrinsics::apply_error(&mut moved.cameras[1].body_from_left, &error);
    moved.prior.extrinsics[1] = moved.cameras[1].body_from_left;
    let relative_error = |window: &Window| {
        let relative = |cameras: &[Camera]| {
            let [a, b] = [0, 1].map(|k| cameras[k].body_from_left.0);
            a.transpose() * b
        };
        (relative(&window.cameras) - relative(&exact.cameras)).norm()
    };
    let prior_sigma = priors[1].sigmas()[3];
    let before = relative_error(&moved);
    for leaving in 0..3 {
        let (_, covariance) = optimize_window(&mut moved, 8, Damping::SETTLED);
        let calibrations = covariance.expect("a covariance").calibrations();
        assert_eq!(calibrations.nrows(), 2 * CALIBRATION_DIM);
        // Of the second camera against the first one.
        let mut difference = DVector::zeros(calibrations.nrows());
        (difference[3], difference[POSE_DIM + 3]) = (-1.0, 1.0);
        let sigma = difference.dot(&(&calibrations * &difference)).sqrt();
        assert!(sigma < 0.3 * prior_sigma, "{leaving}: {sigma}");
        let after = relative_error(&moved);
        assert!(after < 0.02 * before, "{leaving}: {after} of {before}");
        marginalize(&mut moved, 0);
        // What the prior knows is independent of where the iteration starts.
        extrinsics::apply_error(&mut moved.cameras[0].body_from_left, &error);
    }
}

#[test]
fn observations_across_cameras_count_less() {
    let landmark = (window(2, 0.0).landmarks.into_values())
        .find(|landmark| landmark.observations.iter().any(|(_, o)| o.camera == 1))
        .expect("a landmark of both cameras");
    let host = landmark.observations[0].1.camera;
    for (number, observation) in &landmark.observations {
        let mut copy = landmark.clone();
        copy.observe(*number, *observation, 3.0);
        let times = if observation.camera == host { 1.0 } else { 3.0 };
        let basis = copy.observations.last().expect("the new one").1.left.basis;
        assert!((basis * times - observation.left.basis).amax() < 1e-9);
    }
}
