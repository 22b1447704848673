//! Both formulations on the same recordings.

use std::time::Instant;

use super::super::ImuSample;
use super::super::problem::spline::{Motion, Whole};
use super::super::simulate::{Scene, simulate};
use super::super::so3;
use super::super::track::Raw;
use super::*;

/// Error of rotation in mrad, of the lever arm in mm, of the offset in us, with their sigmas' norm.
#[derive(Clone, Copy, Debug, Default)]
struct Off {
    error: [f64; 3],
    sigma: [f64; 3],
    misfit: f64,
    seconds: f64,
    iterations: usize,
}

fn off(scene: &Scene, shared: &Shared, covariance: &SMatrix<f64, 7, 7>) -> Off {
    let told = scene.imu_from_left.rotation().to_rotation_matrix();
    let turn = so3::log(&(told.matrix().transpose() * shared.rotation));
    let shift = shared.translation - scene.imu_from_left.translation();
    let part = |at: usize, n: usize| covariance.view((at, at), (n, n)).trace().sqrt();
    Off {
        error: [
            1e3 * turn.norm(),
            1e3 * shift.norm(),
            1e6 * (shared.offset_s - scene.time_offset_s).abs(),
        ],
        sigma: [1e3 * part(0, 3), 1e3 * part(3, 3), 1e6 * part(6, 1)],
        ..Off::default()
    }
}

/// The preintegrated fit, and splines with these knots, of one recording.
#[allow(clippy::disallowed_methods)] // What is measured here is time.
fn both(scene: &Scene, seed: u64, knots_s: &[f64]) -> Vec<Off> {
    let recording = simulate(scene, seed).recording;
    let told = Told::default();
    let result = estimate(&recording, &told).unwrap();
    let seen = Seen::of(&recording).unwrap();
    let work = Work {
        recording: &recording,
        told: &told,
        track: &seen.track,
        views: &seen.views,
        poses: &seen.poses,
        fits: &seen.fits,
    };
    // Both begin at the same place, a little off.
    let turn = Vector3::new(5e-3, -5e-3, 5e-3);
    let rotation = *result
        .imu_from_left
        .rotation()
        .to_rotation_matrix()
        .matrix();
    let shared = Shared {
        rotation: rotation * so3::exp(&turn),
        translation: result.imu_from_left.translation() + Vector3::new(5e-3, 0.0, -5e-3),
        offset_s: result.time_offset_s + 5e-4,
        drift: 0.0,
        gravity: Vector3::from(result.gravity_in_target),
        board_scale: 1.0,
        gyro_shape: Matrix3::identity(),
        accel_shape: Matrix3::identity(),
    };
    let links = work.links(shared.offset_s);
    let problem = Problem {
        cameras: &recording.cameras,
        views: &seen.views,
        poses: &seen.poses,
        track: &seen.track,
        links: &links,
        noise: recording.noise,
        prior: work.prior(&shared, excite::Held::default()),
        corner_scale: 1.0,
        factors: Factors {
            poses: 1.0,
            gyro: 1.0,
            accel: 1.0,
            gyro_walk: 1.0,
            accel_walk: 1.0,
        },
        robust: true,
        middle_s: 0.5 * seen.views[seen.views.len() - 1].time_s,
    };
    let mut out = Vec::new();
    let states = work.states(&shared, Vector3::zeros(), Vector3::zeros());
    let begun = Instant::now();
    let fitted = problem.fit(states, shared).unwrap();
    let seconds = begun.elapsed().as_secs_f64();
    let covariance = fitted.covariance.shared.fixed_view::<7, 7>(0, 0).into();
    let squares: f64 = fitted.sums.iter().map(|s| s.squares).sum();
    out.push(Off {
        misfit: squares / fitted.sums.iter().map(|s| s.redundancy).sum::<f64>(),
        seconds,
        ..off(scene, &fitted.shared, &covariance)
    });
    let zero_ns = recording.pictures[0].time_ns;
    let raw: Vec<Raw> = recording
        .imu
        .iter()
        .map(|s: &ImuSample| Raw {
            time_s: (s.time_ns - zero_ns) as f64 * 1e-9,
            gyro: Vector3::from(s.gyro),
            accel: Vector3::from(s.accel),
        })
        .collect();
    let poses: Vec<_> = (seen.poses.iter().zip(&seen.views))
        .map(|(pose, view)| {
            let (rotation, position) = shared.imu(pose);
            (view.time_s, rotation, position)
        })
        .collect();
    for &knot_s in knots_s {
        let whole = Whole {
            motion: Motion::near(knot_s, &poses, 0.0),
            shared,
            biases: [Vector3::zeros(); 2],
        };
        let begun = Instant::now();
        let Some(fit) = problem.fit_spline(&raw, whole) else {
            out.push(Off {
                error: [f64::NAN; 3],
                ..Off::default()
            });
            continue;
        };
        out.push(Off {
            misfit: fit.misfit,
            seconds: begun.elapsed().as_secs_f64(),
            iterations: fit.iterations,
            ..off(
                scene,
                &fit.whole.shared,
                &fit.covariance.fixed_view::<7, 7>(0, 0).into(),
            )
        });
    }
    out
}

fn scene(seconds: f64) -> Scene {
    Scene {
        board: ([6, 5], 0.11),
        ..Scene::lively(seconds)
    }
}

#[test]
fn the_twin_agrees() {
    let found = both(&scene(5.0), 3, &[0.03]);
    let (ours, twin) = (found[0], found[1]);
    for k in 0..3 {
        let apart = (ours.error[k] - twin.error[k]).abs();
        assert!(apart < ours.sigma[k], "{ours:?} {twin:?}");
        // A spline with knots this far apart leaves a little less room for noise.
        let ratio = twin.sigma[k] / ours.sigma[k];
        assert!((0.6..1.1).contains(&ratio), "{ours:?} {twin:?}");
    }
}

/// The figures of docs/decisions/0006-camera-imu.md:
/// `cargo test --release -p calib --lib formulations -- --ignored --nocapture`.
#[test]
#[ignore = "minutes; prints a table"]
fn formulations() {
    let knots = [0.01, 0.02, 0.03, 0.05, 0.1, 0.2];
    for (name, scene) in [
        ("lively, 400 Hz", scene(20.0)),
        (
            "lively, 200 Hz",
            Scene {
                imu_hz: 200.0,
                ..scene(20.0)
            },
        ),
    ] {
        let runs: Vec<Vec<Off>> = (0..6).map(|seed| both(&scene, seed, &knots)).collect();
        println!("{name}: rms error, rms sigma (mrad, mm, us), misfit, s, iterations");
        for k in 0..=knots.len() {
            let rms = |of: &dyn Fn(&Off) -> f64| {
                (runs.iter().map(|r| of(&r[k]).powi(2)).sum::<f64>() / runs.len() as f64).sqrt()
            };
            let name = match k {
                0 => "preintegrated".to_owned(),
                k => format!("spline {} ms", 1e3 * knots[k - 1]),
            };
            println!(
                "| {name} | {:.3} {:.3} {:.2} | {:.3} {:.3} {:.2} | {:.3} | {:.2} | {:.1} |",
                rms(&|o| o.error[0]),
                rms(&|o| o.error[1]),
                rms(&|o| o.error[2]),
                rms(&|o| o.sigma[0]),
                rms(&|o| o.sigma[1]),
                rms(&|o| o.sigma[2]),
                rms(&|o| o.misfit),
                rms(&|o| o.seconds),
                rms(&|o| o.iterations as f64),
            );
        }
    }
}
