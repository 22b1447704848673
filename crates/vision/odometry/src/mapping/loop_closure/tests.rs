//! Two noise-free keyframes of a place, from cameras with exposure offsets.

use super::*;
use crate::backend::solver::tests::camera;
use crate::backend::window::{Frame, Prior};

/// State of a moving body.
fn state_of(position: Vector3<f64>, yaw: f64) -> State {
    State {
        position,
        rotation: so3::exp(Vector3::new(0.0, yaw, 0.0)),
        velocity: Vector3::new(1.2, 0.0, -0.3),
        gyro_rate: Vector3::new(0.05, 0.8, 0.0),
        ..State::at_rest(0)
    }
}

fn window_of(states: [State; 2], cameras: Vec<Camera>) -> Window {
    let frames = states.iter().zip(1..).map(|(state, number)| Frame {
        number,
        state: *state,
        motion: None,
    });
    Window {
        frames: frames.collect(),
        cameras,
        landmarks: std::collections::BTreeMap::new(),
        prior: Prior::of(1, states[0], &[1e-4; crate::backend::state::STATE_DIM]),
        config: Default::default(),
    }
}

fn keyframe(number: u64, state: &State, cameras: &[Camera], late_s: &[f64]) -> Keyframe {
    let mut keypoints = Vec::new();
    for id in 0..90_u64 {
        let part = |by: f64| (id as f64 * by).fract();
        let x_in_world = Vector3::new(
            6.0 * part(0.618) - 3.0,
            2.0 * part(0.414) - 1.0,
            2.0 + 4.0 * part(0.732),
        );
        for (index, camera) in cameras.iter().enumerate() {
            // The time of a row depends on the pixel, and the pixel on the time.
            let mut exposure_offset_s = late_s[index];
            let mut observations = None;
            for _ in 0..20 {
                let then = observation::CameraPose::new(state, exposure_offset_s);
                let (body_from_left, arm) = &camera.body_from_left;
                let in_body = then.rotation.transpose() * (x_in_world - then.position);
                let x = body_from_left.transpose() * (in_body - arm);
                observations = (camera.left.project(x.into())).filter(|p| {
                    x.z > 0.3 && (1.0..671.0).contains(&p[0]) && (1.0..375.0).contains(&p[1])
                });
                let Some(pixel) = observations else { break };
                exposure_offset_s = late_s[index] + camera.row_after_s(Side::Left, pixel[1] as f32);
                observations = Some(pixel);
            }
            let then = observation::CameraPose::new(state, exposure_offset_s);
            let (body_from_left, arm) = &camera.body_from_left;
            let from_left = x_in_world - then.position - then.rotation * arm;
            keypoints.extend(observations.map(|pixel| Keypoint {
                camera: index as u8,
                left: pixel.map(|v| v as f32),
                rho: (1.0 / (body_from_left.transpose() * from_left).norm()) as f32,
                descriptor: std::array::from_fn(|k| {
                    (id * 4 + k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15)
                }),
            }));
        }
    }
    Keyframe {
        number,
        state: state.into(),
        imu_valid: false,
        stereo_errors: vec![[0.0; 7]; cameras.len()],
        extrinsics_errors: vec![[0.0; 6]; cameras.len()],
        exposure_offset_s: late_s.to_vec(),
        observations: Vec::new(),
        keypoints,
    }
}

/// Loop closure of the two frames of a window.
fn closed([from, to]: [&Keyframe; 2], window: &Window) -> Closure {
    let config = Default::default();
    close(&config, from, to, [0, 1], window, &[0.0, 0.0]).expect("a loop closure")
}

#[test]
fn cameras_with_exposure_offsets_close_loops() {
    let cameras = vec![camera(-0.2, 2e-5), camera(0.3, 0.0)];
    let truth = [
        state_of(Vector3::zeros(), 0.0),
        state_of(Vector3::new(0.4, 0.1, -0.2), 0.15),
    ];
    let from = keyframe(1, &truth[0], &cameras, &[0.0, 0.033]);
    let to = keyframe(2, &truth[1], &cameras, &[-0.015, 0.02]);
    let mut report = truth;
    report[1].position += Vector3::new(0.1, -0.05, 0.08);
    report[1].rotation *= so3::exp(Vector3::new(0.02, -0.03, 0.01));
    let window = window_of(report, cameras);
    let closure = closed([&from, &to], &window);
    let truth = RelativePose::between(&truth[0], &truth[1]);
    // The camera with an offset of 33 ms has moved by 40 mm. The direction of that motion is only
    // as accurate as the given rotation.
    let initial_error = (closure.translation - truth.translation).norm();
    assert!(initial_error < 1e-3, "{initial_error}");
    let rotation_error = closure.rotation.angle_to(&truth.rotation);
    assert!(rotation_error < 3e-4, "{rotation_error}");
    // Each pair of keypoints counts once, and is observed in both directions.
    let found = matches(
        &Default::default(),
        &from,
        &to,
        (&report[0], &report[1]),
        &RelativePose::between(&report[0], &report[1]),
        &window.cameras,
    );
    assert!(found.len() > 100 && found.len().is_multiple_of(2));
    let pairs: f64 = found.iter().map(|m| m.weight).sum();
    assert_eq!(pairs, found.len() as f64 / 2.0);
    assert!(
        closure.inliers > 40.0 && closure.inliers <= pairs,
        "{}",
        closure.inliers
    );
}

/// A right eye rotated by 3 mrad makes ranges of two metres a fourth too long, until the window has
/// estimated it.
#[test]
fn ranges_are_those_of_the_latest_calibration() {
    let nominal = camera(0.0, 0.0);
    let mut rotated = nominal.clone();
    let error = StereoVector::from([0.0, 3e-3, 0.0, 0.0, 0.0, 0.0, 0.0]);
    stereo::apply_error(&mut rotated, &error);
    let states = [
        state_of(Vector3::zeros(), 0.0),
        state_of(Vector3::new(0.8, 0.1, -0.5), 0.15),
    ];
    let cameras = vec![rotated.clone()];
    let [mut from, mut to] = [(1, states[0]), (2, states[1])]
        .map(|(number, state)| keyframe(number, &state, &cameras, &[0.0]));
    for keypoint in from.keypoints.iter_mut().chain(&mut to.keypoints) {
        let left = nominal.bearing(Side::Left, keypoint.left).expect("inside");
        let right = rotated.project_right(&left.ray, f64::from(keypoint.rho));
        let right = right.and_then(|pixel| nominal.bearing(Side::Right, pixel));
        let (rho, _) = nominal.triangulate(&left, &right.expect("inside"));
        assert!((rho - f64::from(keypoint.rho)).abs() > 0.03, "{rho}");
        keypoint.rho = rho as f32;
    }
    let window = window_of(states, cameras);
    let closure = closed([&from, &to], &window);
    let truth = RelativePose::between(&states[0], &states[1]);
    let error = (closure.translation - truth.translation).norm();
    assert!(error < 1e-3, "{error}");
}

#[test]
fn large_residual_has_more_weight_before_the_loss_is_tightened() {
    let states = [state_of(Vector3::zeros(), 0.0), state_of(Vector3::x(), 0.0)];
    let window = window_of(states, vec![camera(0.0, 0.0)]);
    let mut closure = Closure {
        frames: [0, 1],
        numbers: [1, 2],
        rotation: UnitQuaternion::identity(),
        translation: Vector3::zeros(),
        information: PoseMatrix::identity() * 1e4,
        inliers: 30.0,
        initial_error: [1.0, 0.0],
        loss_scale: LoopClosureConfig::default().cauchy_sigma_first,
    };
    // At a hundred sigmas the weight is one half.
    let far = closure.linearize(&window).gradient_other.norm();
    assert!((far / 1e4 - 0.5).abs() < 1e-9, "{far}");
    closure.tighten_loss(LoopClosureConfig::default().cauchy_sigma);
    let near = closure.linearize(&window).gradient_other.norm();
    assert!(near < 0.01 * far, "{near}");
}
