//! The estimator on recordings whose truth is known.

use std::thread;

use super::simulate::{Random, Scene, Simulated, simulate};
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

fn errors(scene: &Scene, truth: &Simulated, found: &CameraImu) -> Errors {
    let told = &scene.imu_from_left;
    let turn = (told.rotation().inverse() * found.imu_from_left.rotation()).scaled_axis();
    let shift = found.imu_from_left.translation() - told.translation();
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

/// Many recordings, on two threads.
fn many(count: u64, scene: impl Fn(u64) -> Scene + Sync) -> Vec<(Errors, CameraImu)> {
    let one = |seed: u64| {
        let scene = scene(seed);
        let truth = simulate(&scene, seed);
        let found = estimate(&truth.recording, &Told::default()).expect("a good recording");
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
        picture_hz: [15.0, 20.0, 30.0][seed as usize / 3 % 3],
        board: ([6, 5], 0.11),
        ..Scene::lively(seconds)
    }
}

#[test]
fn errors_are_small_and_as_large_as_stated() {
    let all = many(40, |seed| any(seed, 8.0));
    let mut within = 0;
    for (errors, found) in &all {
        assert!(errors.turn_deg < 0.05, "{errors:?}");
        assert!(errors.shift_mm < 1.5, "{errors:?}");
        assert!(errors.offset_ms < 0.2, "{errors:?}");
        within += errors.over_sigma.iter().filter(|z| z.abs() < 2.0).count();
        assert_ne!(found.verdict(), Verdict::Fail, "{:#?}", found.gates);
    }
    let share = within as f64 / (all.len() * 13) as f64;
    println!("{share}");
    for k in 0..13 {
        let rms = (all.iter().map(|(e, _)| e.over_sigma[k].powi(2)).sum::<f64>()
            / all.len() as f64)
            .sqrt();
        println!("{k} {rms}");
    }
    let mut mm: Vec<f64> = all.iter().map(|(e, _)| e.shift_mm).collect();
    mm.sort_by(f64::total_cmp);
    println!("{mm:.2?}");
    for (_, f) in &all {
        for g in f.gates.iter().filter(|g| g.verdict != Verdict::Pass) {
            println!("{} {}", g.name, g.text);
        }
    }
    assert!(share > 0.95, "{share}");
}


fn show(name: &str, scene: &Scene, told: &Told, change: impl Fn(&mut Recording)) {
    let mut truth = simulate(scene, 7);
    change(&mut truth.recording);
    println!("=== {name}");
    match estimate(&truth.recording, told) {
        Err(error) => println!("{error}"),
        Ok(found) => {
            let e = errors(scene, &truth, &found);
            println!("{e:.2?}");
            println!("{:?}", found.pictures);
            for g in found.gates.iter().filter(|g| g.verdict != Verdict::Pass) {
                println!("{} {}: {}", g.verdict, g.name, g.text);
            }
        }
    }
}

#[test]
fn explore() {
    let good = || Scene::lively(20.0);
    let told = Told::default();
    let knows = Told {
        imu_from_left: Some(good().imu_from_left),
        ..told
    };
    show("still", &Scene { turn_rad: [0.0; 3], shift_m: [0.0; 3], ..good() }, &told, |_| ());
    show("still, told", &Scene { turn_rad: [0.0; 3], shift_m: [0.0; 3], ..good() }, &knows, |_| ());
    show("shift only", &Scene { turn_rad: [0.0; 3], ..good() }, &told, |_| ());
    show("turn only", &Scene { shift_m: [0.0; 3], ..good() }, &told, |_| ());
    show("one axis", &Scene { turn_rad: [0.0, 0.4, 0.0], ..good() }, &told, |_| ());
    show("one axis told", &Scene { turn_rad: [0.0, 0.4, 0.0], ..good() }, &knows, |_| ());
    show("one axis no shift", &Scene { turn_rad: [0.0, 0.4, 0.0], shift_m: [0.0; 3], ..good() }, &told, |_| ());
    show("slow", &Scene { turn_rad: [0.02; 3], shift_m: [0.02; 3], ..good() }, &told, |_| ());
    
    if std::env::var_os("DBG").is_none() {
    for stereo in [true, false] {
        for scale in [1.002, 1.005, 1.01, 1.03, 1.1] {
            show(&format!("scale {scale} {stereo}"), &Scene { board_scale: scale, stereo, ..good() }, &told, |_| ());
        }
    }
    for drift in [2e-6, 1e-5, 5e-5, 2e-4] {
        show(&format!("drift {drift}"), &Scene { time_drift: drift, ..good() }, &told, |_| ());
    }
    for times in [0.1, 0.33, 3.0, 10.0, 30.0] {
        let mut noise = simulate::ZED_NOISE;
        noise.gyro_noise_density *= times;
        noise.accel_noise_density *= times;
        show(&format!("noise {times}"), &Scene { noise, ..good() }, &told, |_| ());
    }
    for px in [0.05, 0.5, 1.5] {
        show(&format!("corners {px}"), &Scene { corner_px: px, ..good() }, &told, |_| ());
    }
    show("outlier corners", &Scene { corner_outliers: 0.05, ..good() }, &told, |_| ());
    show("shapes", &Scene { scale_and_skew: [5e-3, 1e-3], ..good() }, &told, |_| ());
    show("shapes bad", &Scene { scale_and_skew: [3e-2, 1e-2], ..good() }, &told, |_| ());
    }
    show("jump 1ms", &good(), &told, |r| for p in &mut r.pictures[200..] { p.time_ns += 1_000_000 });
    show("jump 0.2ms", &good(), &told, |r| for p in &mut r.pictures[200..] { p.time_ns += 200_000 });
    show("pictures swapped time", &good(), &told, |r| for p in r.pictures.iter_mut().step_by(9) { p.time_ns += 20_000_000 });
    show("gap", &good(), &told, |r| { r.imu.drain(2000..2400); r.imu.remove(4000); });
    show("saturated", &good(), &told, |r| {
        r.range = [1.2, 30.0];
        for s in &mut r.imu { for v in &mut s.gyro { *v = v.clamp(-1.2, 1.2); } }
    });
    show("saturated, not told", &good(), &told, |r| {
        for s in &mut r.imu { for v in &mut s.gyro { *v = v.clamp(-1.2, 1.2); } }
    });
    show("no board", &good(), &told, |r| for p in &mut r.pictures[100..150] { p.corners.clear() });
    show("g", &good(), &told, |r| for s in &mut r.imu { s.accel = s.accel.map(|v| v / 9.80665) });
    show("deg", &good(), &told, |r| for s in &mut r.imu { s.gyro = s.gyro.map(f64::to_degrees) });
    show("swapped eyes", &good(), &told, |r| for p in &mut r.pictures { for c in &mut p.corners { c.eye = if c.eye == Eye::Left { Eye::Right } else { Eye::Left } } });
    show("lefthanded", &good(), &told, |r| for s in &mut r.imu { s.accel[0] *= -1.0; s.gyro[0] *= -1.0 });
    show("lefthanded accel", &good(), &told, |r| for s in &mut r.imu { s.accel[0] *= -1.0; });
    show("180", &good(), &Told { imu_from_left: Some(good().imu_from_left * RigidTransform::from_rotation_vector([3.14159, 0.0, 0.0], [0.1, 0.0, -0.1]).unwrap()), time_offset_s: 0.05, ..told }, |_| ());
}
