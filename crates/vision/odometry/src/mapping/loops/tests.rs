//! Two keyframes of a place, without noise, by cameras whose pictures have times of their own.

use super::*;
use crate::solve::tests::camera;
use crate::window::{Frame, Prior};

/// Of a body on its way.
fn state_of(position: Vector3<f64>, yaw: f64) -> State {
    State {
        position,
        turn: so3::exp(&Vector3::new(0.0, yaw, 0.0)),
        velocity: Vector3::new(1.2, 0.0, -0.3),
        read_rate: Vector3::new(0.05, 0.8, 0.0),
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
        mounts: Vec::new(),
        landmarks: std::collections::BTreeMap::new(),
        prior: Prior::of(1, states[0], &[1e-4; crate::state::SIZE]),
        sigma_px: 0.5,
    }
}

fn keyframe(number: u64, state: &State, cameras: &[Camera], late_s: &[f64]) -> Keyframe {
    let mut marks = Vec::new();
    for id in 0..90_u64 {
        let part = |by: f64| (id as f64 * by).fract();
        let x_in_world = Vector3::new(
            6.0 * part(0.618) - 3.0,
            2.0 * part(0.414) - 1.0,
            2.0 + 4.0 * part(0.732),
        );
        for (index, camera) in cameras.iter().enumerate() {
            // The time of a row depends on where it is seen, and that on the time.
            let mut after_s = late_s[index];
            let mut seen = None;
            for _ in 0..20 {
                let then = sight::Placed::new(state, after_s);
                let (eye, arm) = &camera.body_from_left;
                let in_body = then.turn.transpose() * (x_in_world - then.position);
                let x = eye.transpose() * (in_body - arm);
                seen = (camera.left.project(x.into())).filter(|p| {
                    x.z > 0.3 && (1.0..671.0).contains(&p[0]) && (1.0..375.0).contains(&p[1])
                });
                let Some(pixel) = seen else { break };
                after_s = late_s[index] + camera.row_after_s(Side::Left, pixel[1] as f32);
                seen = Some(pixel);
            }
            let then = sight::Placed::new(state, after_s);
            let (eye, arm) = &camera.body_from_left;
            let from_eye = x_in_world - then.position - then.turn * arm;
            marks.extend(seen.map(|pixel| Mark {
                camera: index as u8,
                left: pixel.map(|v| v as f32),
                rho: (1.0 / (eye.transpose() * from_eye).norm()) as f32,
                looks: std::array::from_fn(|k| {
                    (id * 4 + k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15)
                }),
            }));
        }
    }
    Keyframe {
        number,
        state: state.into(),
        is_felt: false,
        after_s: late_s.to_vec(),
        seen: Vec::new(),
        marks,
    }
}

#[test]
fn pictures_of_other_times_close_as_well() {
    let cameras = vec![camera(-0.2, 2e-5), camera(0.3, 0.0)];
    let truth = [
        state_of(Vector3::zeros(), 0.0),
        state_of(Vector3::new(0.4, 0.1, -0.2), 0.15),
    ];
    let from = keyframe(1, &truth[0], &cameras, &[0.0, 0.033]);
    let to = keyframe(2, &truth[1], &cameras, &[-0.015, 0.02]);
    let mut told = truth;
    told[1].position += Vector3::new(0.1, -0.05, 0.08);
    told[1].turn *= so3::exp(&Vector3::new(0.02, -0.03, 0.01));
    let window = window_of(told, cameras);
    let closure = close(&from, &to, [0, 1], &window, &[0.0, 0.0]).expect("the place is the same");
    let [a, b] = truth;
    let shift = a.turn.inverse() * (b.position - a.position);
    // The camera that is 33 ms late is 40 mm on by then. Which way it went is only known as well as the told turn.
    let off = (closure.shift - shift).norm();
    assert!(off < 1e-3, "{off}");
    let turned = closure.turn.angle_to(&(a.turn.inverse() * b.turn));
    assert!(turned < 3e-4, "{turned}");
    // Each pair of marks counts once, and it is seen both ways.
    let found = matches(&from, &to, (&told[0], &told[1]), &window.cameras);
    assert!(found.len() > 100 && found.len().is_multiple_of(2));
    let pairs: f64 = found.iter().map(|m| m.share).sum();
    assert_eq!(pairs, found.len() as f64 / 2.0);
    assert!(
        closure.marks > 40.0 && closure.marks <= pairs,
        "{}",
        closure.marks
    );
}

#[test]
fn what_is_far_off_pulls_more_before_it_is_narrowed() {
    let states = [state_of(Vector3::zeros(), 0.0), state_of(Vector3::x(), 0.0)];
    let window = window_of(states, vec![camera(0.0, 0.0)]);
    let mut closure = Closure {
        frames: [0, 1],
        numbers: [1, 2],
        turn: UnitQuaternion::identity(),
        shift: Vector3::zeros(),
        information: PoseMatrix::identity() * 1e4,
        marks: 30.0,
        off: [1.0, 0.0],
        reach: CAUCHY_FAR,
    };
    // A hundred sigmas: half of its pull.
    let far = closure.linearise(&window).pull_other.norm();
    assert!((far / 1e4 - 0.5).abs() < 1e-9, "{far}");
    closure.narrow();
    let near = closure.linearise(&window).pull_other.norm();
    assert!(near < 0.01 * far, "{near}");
}
