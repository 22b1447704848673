//! The estimator on recordings whose truth is known.

use super::simulate::{Scene, Simulated, simulate};
use super::*;

/// Errors over sigmas, and the errors themselves: degrees, mm, ms.
struct Errors {
    turn_deg: f64,
    shift_mm: f64,
    offset_ms: f64,
    /// Seven normal numbers: rotation 3, translation 3, offset.
    over_sigma: [f64; 7],
}

fn errors(scene: &Scene, found: &CameraImu) -> Errors {
    let told = &scene.imu_from_left;
    let turn = (told.rotation().inverse() * found.imu_from_left.rotation()).scaled_axis();
    let shift = found.imu_from_left.translation() - told.translation();
    let offset = found.time_offset_s - scene.time_offset_s;
    let s = &found.sigmas;
    Errors {
        turn_deg: turn.norm().to_degrees(),
        shift_mm: 1e3 * shift.norm(),
        offset_ms: 1e3 * offset.abs(),
        over_sigma: std::array::from_fn(|k| match k {
            0..3 => turn[k] / s.rotation_rad[k],
            3..6 => shift[k - 3] / s.translation_m[k - 3],
            _ => offset / s.time_offset_s,
        }),
    }
}

#[test]
fn first() {
    let scene = Scene::lively(20.0);
    for seed in 0..4 {
        let Simulated { recording, .. } = simulate(&scene, seed);
        let start = std::time::SystemTime::now();
        let found = estimate(&recording, &Told::default()).unwrap();
        let e = errors(&scene, &found);
        println!(
            "{:.4} deg {:.3} mm {:.4} ms; {:.2?}; {:?} {:?}",
            e.turn_deg, e.shift_mm, e.offset_ms, e.over_sigma, found.noises, start.elapsed()
        );
        println!("{:?} {} {:?}", found.sigmas, found.board_scale, found.pictures);
        for g in &found.gates {
            println!("{} {} {}", g.verdict, g.name, g.text);
        }
    }
}
