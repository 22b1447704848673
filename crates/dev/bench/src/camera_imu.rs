//! `camera_imu`: camera–IMU extrinsics and time offset, by preintegration between images and by a
//! spline.
//!
//! Corners and samples are simulated (20 s, 20 frames per second, six recordings for each sample
//! rate); both formulations start from the same values with the same nominal noise. Then a minute
//! with 144 corners in each image, for the run time. Figures of docs/decisions/0006-camera-imu.md.

use std::fmt::Write as _;
use std::fs;

use anyhow::{Context, Result};
use calib::camera_imu::simulate::{Scene, simulate};
use calib::camera_imu::{Config, FormulationResult, Formulations, Priors, estimate};
use nalgebra::{Rotation3, Vector3};
use serde_json::{Value, json};

use crate::arguments::Arguments;
use crate::meter::timed;
use crate::stamp;

/// Knots of splines, s.
const KNOTS_S: &[f64] = &[0.01, 0.02, 0.05, 0.1, 0.2];

/// Result of one formulation on some recordings: sums of squares.
#[derive(Clone, Copy, Default)]
struct Sums {
    runs: f64,
    /// Rotation, rad; lever arm, m; offset, s: errors, and stated sigmas.
    errors: [f64; 3],
    sigmas: [f64; 3],
    misfit: f64,
    seconds: f64,
    failed: u32,
}

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. A target that is missed is a result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let stamp = stamp::stamp("camera_imu", args)?;
    let (seconds, seeds) = if quick { (5.0, 1) } else { (20.0, 6) };
    let mut rates = Vec::new();
    for imu_hz in [400.0, 200.0] {
        eprintln!("{imu_hz} samples a second ...");
        let scene = Scene {
            board: ([6, 5], 0.11),
            imu_hz,
            ..Scene::lively(seconds)
        };
        let rows = formulations(&scene, seeds)?;
        println!("{imu_hz} samples a second\n{}", table(&rows));
        let rows = rows.iter().map(|(name, sums)| sums.json(name));
        rates.push(json!({ "imu_hz": imu_hz, "formulations": rows.collect::<Vec<_>>() }));
    }
    let minute = minute(if quick { 10.0 } else { 60.0 })?;
    println!("a minute: {minute}");
    let report = json!({
        "benchmark": "camera_imu",
        "stamp": stamp,
        "recordings": { "seconds": seconds, "count": seeds },
        "rates": rates,
        "minute": minute,
    });
    let path = out.join("camera_imu.json");
    fs::write(&path, format!("{report:#}\n")).with_context(|| format!("writing {}", path.display()))
}

/// Every formulation on the same recordings.
fn formulations(scene: &Scene, seeds: u64) -> Result<Vec<(String, Sums)>> {
    let mut rows = vec![("preintegrated".to_owned(), Sums::default())];
    rows.extend(KNOTS_S.iter().map(|knot_s| {
        let name = format!("spline, knots at {} ms", 1e3 * knot_s);
        (name, Sums::default())
    }));
    for seed in 0..seeds {
        let recording = simulate(scene, seed).recording;
        let both = Formulations::new(&recording)?;
        for (n, (_, sums)) in rows.iter_mut().enumerate() {
            let (found, took) = timed(|| match n {
                0 => both.preintegrated(),
                n => both.spline(KNOTS_S[n - 1]),
            });
            match found {
                Some(found) => sums.add(scene, &found, took.cpu_s),
                None => sums.failed += 1,
            }
        }
    }
    Ok(rows)
}

impl Sums {
    fn add(&mut self, scene: &Scene, found: &FormulationResult, seconds: f64) {
        let truth = scene.imu_from_left.rotation().to_rotation_matrix();
        let turn = Rotation3::from_matrix_unchecked(truth.matrix().transpose() * found.rotation);
        let shift: Vector3<f64> = found.translation - scene.imu_from_left.translation();
        let late = found.time_offset_s - scene.time_offset_s;
        let squares = [turn.angle().powi(2), shift.norm_squared(), late * late];
        for (k, (at, n)) in [(0, 3), (3, 3), (6, 1)].into_iter().enumerate() {
            self.errors[k] += squares[k];
            self.sigmas[k] += found.covariance.view((at, at), (n, n)).trace();
        }
        self.misfit += found.misfit;
        self.seconds += seconds;
        self.runs += 1.0;
    }

    /// Roots of the mean squares in mrad, mm and us.
    fn shown(&self, squares: [f64; 3]) -> [f64; 3] {
        let unit = [1e3, 1e3, 1e6];
        std::array::from_fn(|k| unit[k] * (squares[k] / self.runs).sqrt())
    }

    fn json(&self, name: &str) -> Value {
        let named = |[turn, shift, late]: [f64; 3]| json!({ "turn_mrad": turn, "shift_mm": shift, "offset_us": late });
        json!({
            "name": name,
            "error": named(self.shown(self.errors)),
            "sigma": named(self.shown(self.sigmas)),
            "misfit": self.misfit / self.runs,
            "cpu_s": self.seconds / self.runs,
            "failed": self.failed,
        })
    }
}

/// As docs have it.
fn table(rows: &[(String, Sums)]) -> String {
    let head = "| | rotation, mrad | lever arm, mm | offset, us | chi-squared per number | s |";
    let mut text = format!("{head}\n|---|---|---|---|---|---|\n");
    for (name, sums) in rows {
        let (error, sigma) = (sums.shown(sums.errors), sums.shown(sums.sigmas));
        let _ = write!(text, "| {name} |");
        for (k, digits) in [2, 2, 1].into_iter().enumerate() {
            let _ = write!(text, " {:.digits$} ({:.digits$}) |", error[k], sigma[k]);
        }
        let (misfit, seconds) = (sums.misfit / sums.runs, sums.seconds / sums.runs);
        let _ = writeln!(text, " {misfit:.2} | {seconds:.1} |");
    }
    text
}

/// A recording with 144 corners in each image, as in practice.
fn minute(seconds: f64) -> Result<Value> {
    let scene = Scene {
        board: ([12, 12], 0.05),
        ..Scene::lively(seconds)
    };
    let recording = simulate(&scene, 1).recording;
    let (found, took) = timed(|| estimate(&recording, &Priors::default(), &Config::default()));
    let found = found?;
    let shift: Vector3<f64> = found.imu_from_left.translation() - scene.imu_from_left.translation();
    Ok(json!({
        "seconds": seconds,
        "cpu_s": took.cpu_s,
        "shift_mm": 1e3 * shift.norm(),
        "offset_us": 1e6 * (found.time_offset_s - scene.time_offset_s),
    }))
}
