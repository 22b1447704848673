//! The estimator on recordings with ground truth.

use std::thread;

use cad_transforms::RigidTransform;
use camera_models::Eye;

use super::simulate::{Random, Scene, SimulatedRecording, simulate};
use super::*;

/// Errors over sigmas, and the errors themselves: degrees, mm, ms.
#[derive(Debug)]
struct Errors {
    turn_deg: f64,
    shift_mm: f64,
    offset_ms: f64,
    /// Rotation 3, translation 3, offset, gyroscope bias 3, accelerometer bias 3.
    over_sigma: [f64; 13],
}

fn errors(scene: &Scene, truth: &SimulatedRecording, found: &CameraImu) -> Errors {
    let priors = &scene.imu_from_left;
    let turn = (priors.rotation().inverse() * found.imu_from_left.rotation()).scaled_axis();
    let shift = found.imu_from_left.translation() - priors.translation();
    let offset = found.time_offset_s - scene.time_offset_s;
    let s = &found.sigmas;
    let bias = |k: usize, i: usize| {
        let (value, sigma) = [
            (&found.gyro_bias, &s.gyro_bias),
            (&found.accel_bias, &s.accel_bias),
        ][k];
        (value[i] - truth.biases[k][i]) / sigma[i]
    };
    Errors {
        turn_deg: turn.norm().to_degrees(),
        shift_mm: 1e3 * shift.norm(),
        offset_ms: 1e3 * offset.abs(),
        over_sigma: std::array::from_fn(|k| match k {
            0..3 => turn[k] / s.rotation_rad[k],
            3..6 => shift[k - 3] / s.translation_m[k - 3],
            6 => offset / s.time_offset_s,
            7..10 => bias(0, k - 7),
            _ => bias(1, k - 10),
        }),
    }
}

/// Several recordings, on two threads.
fn many(count: u64, scene: impl Fn(u64) -> Scene + Sync) -> Vec<(Errors, CameraImu)> {
    let one = |seed: u64| {
        let scene = scene(seed);
        let truth = simulate(&scene, seed);
        let found = estimate(&truth.recording, &Priors::default(), &Config::default())
            .expect("a good recording");
        (errors(&scene, &truth, &found), found)
    };
    thread::scope(|scope| {
        let workers: Vec<_> = (0..2)
            .map(|worker| {
                let one = &one;
                scope.spawn(move || {
                    let mine = (0..count).filter(|seed| seed % 2 == worker);
                    mine.map(one).collect::<Vec<_>>()
                })
            })
            .collect();
        workers
            .into_iter()
            .flat_map(|worker| worker.join().expect("no panic"))
            .collect()
    })
}

/// A different camera each time: any rotation, some centimetres, some milliseconds.
fn any(seed: u64, seconds: f64) -> Scene {
    let mut random = Random::new(seed ^ 0xabc);
    let mut three = |size: f64| [0, 1, 2].map(|_| size * random.normal());
    let (turn, arm) = (three(1.5), three(0.05));
    Scene {
        imu_from_left: RigidTransform::from_rotation_vector(turn, arm).unwrap(),
        time_offset_s: three(0.03)[0],
        stereo: seed % 4 < 2,
        imu_hz: [200.0, 400.0, 800.0][seed as usize % 3],
        frame_hz: [15.0, 20.0, 30.0][seed as usize / 3 % 3],
        board: ([6, 5], 0.11),
        ..Scene::lively(seconds)
    }
}

#[test]
fn errors_are_small_and_consistent_with_their_sigmas() {
    let all = many(16, |seed| any(seed, 6.0));
    let mut within = 0;
    for (errors, found) in &all {
        // Six seconds; the requirements are for half a minute.
        assert!(errors.turn_deg < 0.08, "{errors:?}");
        assert!(errors.shift_mm < 2.0, "{errors:?}");
        assert!(errors.offset_ms < 0.2, "{errors:?}");
        within += errors.over_sigma.iter().filter(|z| z.abs() < 2.0).count();
        assert_ne!(found.verdict(), Verdict::Fail, "{:#?}", found.gates);
    }
    // Of 208, 95.4 % are expected; 21 or more are outside by chance once in 1700 times (binomial).
    let outside = all.len() * 13 - within;
    assert!(outside <= 20, "{outside}");
    // The sigmas are not too large either: a sigma of a kilometre would pass, too. The sum of 16
    // squares (chi-square) is below 3.2 once in 3500 times and above 43.6 once in 4300 times.
    for k in 3..13 {
        let squares = all.iter().map(|(e, _)| e.over_sigma[k].powi(2));
        let rms = (squares.sum::<f64>() / all.len() as f64).sqrt();
        assert!((0.45..1.65).contains(&rms), "{k}: {rms}");
    }
}

/// Sensors with misaligned axes: the IMU frame is only as well defined as they are.
#[test]
fn rotation_sigma_covers_sensor_misalignment() {
    let all = many(12, |seed| Scene {
        scale_and_skew: [5e-3, 1e-3],
        ..any(seed, 6.0)
    });
    let squares = (all.iter())
        .flat_map(|(e, _)| e.over_sigma[..3].iter().map(|z| z * z))
        .sum::<f64>();
    let rms = (squares / 36.0).sqrt();
    assert!((0.6..1.4).contains(&rms), "{rms}");
    for (errors, _) in &all {
        assert!(
            errors.shift_mm < 2.0 && errors.offset_ms < 0.2,
            "{errors:?}"
        );
    }
}

/// A short scene, with loose priors around the ground truth.
fn short() -> (Scene, Priors) {
    let scene = Scene {
        board: ([6, 5], 0.11),
        ..Scene::lively(8.0)
    };
    let priors = Priors {
        imu_from_left: Some(scene.imu_from_left),
        ..Priors::default()
    };
    (scene, priors)
}

fn found(scene: &Scene, priors: &Priors, change: impl Fn(&mut Recording)) -> (Errors, CameraImu) {
    let mut truth = simulate(scene, 7);
    change(&mut truth.recording);
    let found = estimate(&truth.recording, priors, &Config::default()).expect("a result");
    (errors(scene, &truth, &found), found)
}

fn verdict(found: &CameraImu, name: &str) -> Verdict {
    let gate = found.gates.iter().find(|gate| gate.name == name);
    gate.unwrap_or_else(|| panic!("no gate {name}")).verdict
}

#[test]
fn unobservable_direction_is_named_and_keeps_its_prior() {
    let (good, priors) = short();
    let weak = |turn_rad: [f64; 3], shift_m: [f64; 3]| {
        let scene = Scene {
            turn_rad,
            shift_m,
            ..good.clone()
        };
        let (errors, found) = found(&scene, &priors, |_| ());
        assert_eq!(verdict(&found, "observability"), Verdict::Warn);
        let mut counts = [0; 3];
        for weak in &found.unobservable {
            counts[match weak {
                UnobservableDirection::Rotation { .. } => 0,
                UnobservableDirection::Translation { .. } => 1,
                UnobservableDirection::TimeOffset { .. } => 2,
            }] += 1;
        }
        (counts, errors, found)
    };
    let still = [0.0; 3];
    let (counts, errors, _) = weak(still, still);
    assert_eq!(counts, [3, 3, 1]);
    assert!(
        errors.turn_deg < 1e-3 && errors.shift_mm < 1e-2,
        "{errors:?}"
    );

    // Translation without rotation: the accelerometer determines the rotation, nothing determines
    // the lever arm.
    let (counts, errors, _) = weak(still, good.shift_m);
    assert_eq!(counts[1], 3);
    assert!(errors.shift_mm < 1e-2, "{errors:?}");

    // Rotation about y alone: the lever arm along y keeps its prior.
    let (counts, errors, found) = weak([0.0, 0.4, 0.0], good.shift_m);
    assert_eq!(counts[1], 1, "{:?}", found.unobservable);
    let direction = found.unobservable.iter().find_map(|weak| match weak {
        UnobservableDirection::Translation { direction, .. } => Some(direction[1]),
        _ => None,
    });
    assert!(direction.is_some_and(|y| y > 0.99), "{direction:?}");
    assert!(errors.shift_mm < 2.0, "{errors:?}");
}

#[test]
fn deviation_from_nominal_values_is_flagged() {
    let (good, priors) = short();
    let check = |name: &str, scene: Scene, change: &dyn Fn(&mut Recording)| {
        let (errors, found) = found(&scene, &priors, change);
        let worst = verdict(&found, name);
        assert!(
            worst > Verdict::Pass,
            "{name}: {errors:?} {:#?}",
            found.gates
        );
        worst
    };
    let as_it_is = |_: &mut Recording| ();
    for stereo in [true, false] {
        let larger = Scene {
            board_scale: 1.015,
            stereo,
            ..good.clone()
        };
        let verdict = check("size of the board", larger, &as_it_is);
        assert_eq!(verdict, Verdict::Fail);
    }
    let drifting = Scene {
        time_drift: 2e-4,
        ..good.clone()
    };
    let verdict = check("drift of the clocks", drifting, &as_it_is);
    assert_eq!(verdict, Verdict::Fail);
    let mut noise = simulate::ZED_NOISE;
    noise.gyro_noise_density *= 12.0;
    noise.accel_noise_density *= 12.0;
    let noisy = Scene {
        noise,
        ..good.clone()
    };
    check("gyroscope noise", noisy.clone(), &as_it_is);
    check("accelerometer noise", noisy, &as_it_is);
    let blurred = Scene {
        corner_px: 0.5,
        ..good.clone()
    };
    check("corner noise", blurred, &as_it_is);
    check("outlier views", good.clone(), &|r| {
        for observation in r.observations.iter_mut().step_by(9) {
            observation.time_ns += 20_000_000;
        }
    });
    check("first half against second", good.clone(), &|r| {
        for observation in &mut r.observations[80..] {
            observation.time_ns += 3_000_000;
        }
    });
    // Saturation at an undeclared range.
    check("gyroscope noise", good.clone(), &|r| {
        for sample in &mut r.imu {
            sample.gyro = sample.gyro.map(|v| v.clamp(-0.8, 0.8));
        }
    });
}

#[test]
fn gaps_and_outliers_do_no_harm() {
    let (good, _) = short();
    let check = |change: &dyn Fn(&mut Recording)| {
        let (errors, found) = found(&good, &Priors::default(), change);
        assert!(
            errors.turn_deg < 0.05 && errors.shift_mm < 2.0,
            "{errors:?}"
        );
        assert!(errors.offset_ms < 0.1, "{errors:?}");
        assert!(found.verdict() < Verdict::Fail, "{:#?}", found.gates);
    };
    check(&|r| {
        r.imu.drain(1000..1200);
        r.imu.remove(2000);
    });
    check(&|r| {
        r.observations[60..90]
            .iter_mut()
            .for_each(|p| p.corners.clear())
    });
    check(&|r| {
        r.range = [1.0, 100.0];
        for sample in &mut r.imu {
            sample.gyro = sample.gyro.map(|v| v.clamp(-1.0, 1.0));
        }
    });
    check(&|r| {
        let mut random = Random::new(1);
        for corner in r.observations.iter_mut().flat_map(|p| &mut p.corners) {
            if random.uniform() < 0.03 {
                corner.pixel[0] += 15.0;
            }
        }
    });
}

#[test]
fn rolling_shutter_with_known_line_time_does_no_harm() {
    let (good, priors) = short();
    let scene = Scene {
        line_s: 2e-5,
        ..good.clone()
    };
    let (errors, compensated) = found(&scene, &priors, |_| ());
    assert!(
        errors.turn_deg < 0.05 && errors.shift_mm < 2.0,
        "{errors:?}"
    );
    assert!(
        compensated.verdict() < Verdict::Fail,
        "{:#?}",
        compensated.gates
    );
    // At a low frame rate the views alone do not determine the motion during readout.
    let slow = Scene {
        frame_hz: 8.0,
        line_s: 2.3e-5,
        seconds: 16.0,
        ..good
    };
    let (errors, _) = found(&slow, &priors, |_| ());
    let over = errors.over_sigma[..7]
        .iter()
        .fold(0.0, |most: f64, z| most.max(z.abs()));
    assert!(over < 3.0 && errors.offset_ms < 0.05, "{errors:?}");
    // A line time that is not given distorts the board in every view.
    let (_, uncompensated) = found(&scene, &priors, |r| r.cameras.line_s = 0.0);
    assert!(
        uncompensated.verdict() > Verdict::Pass,
        "{:#?}",
        uncompensated.gates
    );
}

/// A board that is nearly outside the image has no usable pose; the rest of the recording has.
#[test]
fn views_of_a_single_row_do_no_harm() {
    let (good, priors) = short();
    for line_s in [0.0, 2e-5] {
        let scene = Scene {
            line_s,
            board: ([12, 5], 0.06),
            ..good.clone()
        };
        let (errors, _) = found(&scene, &priors, |r| {
            for (n, observation) in r.observations.iter_mut().enumerate().step_by(3) {
                let rows = [0.0, 0.06 * (n % 2) as f64];
                observation
                    .corners
                    .retain(|c| rows.iter().any(|y| (c.x_in_target[1] - y).abs() < 1e-6));
            }
        });
        assert!(
            errors.turn_deg < 0.05 && errors.shift_mm < 2.0,
            "{errors:?}"
        );
    }
}

#[test]
fn result_does_not_depend_on_initial_values() {
    let (good, priors) = short();
    let (plain, first) = found(&good, &Priors::default(), |_| ());
    let wrong = RigidTransform::from_rotation_vector([3.1, 0.0, 0.2], [0.1, 0.0, -0.1]).unwrap();
    let priors = Priors {
        imu_from_left: priors.imu_from_left.map(|t| t * wrong),
        time_offset_s: -0.05,
        ..priors
    };
    let (errors, second) = found(&good, &priors, |_| ());
    assert!(
        errors.turn_deg < 0.05 && errors.shift_mm < 2.0,
        "{errors:?}"
    );
    assert!((errors.offset_ms - plain.offset_ms).abs() < 1e-2);
    let apart = first.imu_from_left.inverse() * second.imu_from_left;
    assert!(apart.distance_m() < 1e-4, "{apart:?}");
    // Same input, same bits.
    let (_, again) = found(&good, &priors, |_| ());
    assert_eq!(format!("{again:?}"), format!("{second:?}"));
}

#[test]
fn impossible_input_is_an_error() {
    let (good, _) = short();
    let fails = |change: &dyn Fn(&mut Recording)| {
        let mut recording = simulate(&good, 7).recording;
        change(&mut recording);
        estimate(&recording, &Priors::default(), &Config::default()).expect_err("no result")
    };
    use CameraImuError as E;
    let error = fails(&|r| {
        r.imu
            .iter_mut()
            .for_each(|s| s.accel = s.accel.map(|v| v / GRAVITY))
    });
    assert!(matches!(error, E::Gravity { .. }), "{error}");
    let error = fails(&|r| {
        r.imu
            .iter_mut()
            .for_each(|s| s.gyro = s.gyro.map(f64::to_degrees))
    });
    assert!(matches!(error, E::RateMismatch { .. }), "{error}");
    let error = fails(&|r| r.observations[3].corners[2].pixel[1] = f64::NAN);
    assert_eq!(
        error,
        E::NotFinite {
            what: "view",
            index: 3
        }
    );
    let error = fails(&|r| r.imu.swap(10, 11));
    assert_eq!(
        error,
        E::Order {
            what: "IMU sample",
            index: 11
        }
    );
    let error = fails(&|r| {
        r.imu
            .iter_mut()
            .for_each(|s| s.time_ns += 3_600_000_000_000)
    });
    assert!(matches!(error, E::NoOverlap { .. }), "{error}");
    let error = fails(&|r| {
        r.observations
            .iter_mut()
            .for_each(|p| p.corners.truncate(5))
    });
    assert!(matches!(error, E::TooFewViews { found: 0, .. }), "{error}");
    let swap = |eye: Eye| match eye {
        Eye::Left => Eye::Right,
        Eye::Right => Eye::Left,
    };
    let error = fails(&|r| {
        let corners = r.observations.iter_mut().flat_map(|p| &mut p.corners);
        corners.for_each(|c| c.eye = swap(c.eye));
    });
    assert!(matches!(error, E::TooFewViews { .. }), "{error}");
}
