//! `calib_verify`: detection of calibration errors in ordinary walks.
//!
//! Walks of one minute through all scenes in all lights, with the noise of cameras and IMUs. The
//! first 24 were used to set the tolerances, the others were not. Each is evaluated as it is (an
//! inconsistency is then a false alarm) and with one nominal value falsified at a time: each camera
//! rotated on the plate, right cameras rotated, images stamped late, clocks shifted. Every such
//! point is one of:
//!
//! - *named*: inconsistent, with the right camera;
//! - *flagged*: inconsistent, but another camera, or one of several;
//! - *undetermined*: the walk does not constrain the parameter;
//! - *within*: consistent, and smaller than the stated minimum detectable error;
//! - *silent*: consistent, although larger than that. There should be none.
//!
//! The same with right cameras rotated in real recordings ([`real`]).
//!
//! Walks take most of the time. With `--cache DIR` their observations are stored there.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use calib::verify::{CameraEstimate, Finding, Parameter, Status, Verification};
use harness::walks::{NominalError, Plan, Walk};
use rig_sim::scene::{Kind, Lighting};
use serde::Serialize;
use serde_json::json;

mod charts;
mod infinity;
mod real;

use crate::meter::timed;
use crate::stamp;

/// Number of walks, and the seed of the first.
const WALKS: usize = 100;
const QUICK_WALKS: usize = 6;
const FIRST_SEED: u64 = 5000;
/// Rotations of cameras and of right cameras (degrees), time offsets (ms).
const ROTATIONS_DEG: [f64; 9] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.0];
const STEREO_ROTATIONS_DEG: [f64; 6] = [0.05, 0.1, 0.2, 0.3, 0.5, 1.0];
const TIME_OFFSETS_MS: [f64; 6] = [0.5, 1.0, 2.0, 3.0, 5.0, 10.0];

/// Outcome of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Named,
    Flagged,
    Undetermined,
    Within,
    Silent,
}

/// One falsified value in one walk.
#[derive(Clone, Debug)]
struct Point {
    walk: usize,
    what: Parameter,
    camera: String,
    /// Degrees or ms.
    size: f64,
    outcome: Outcome,
    /// Error of the estimate over its sigma, largest of three axes, of a right camera.
    score: Option<f64>,
}

/// One unmodified walk.
#[derive(Clone, Debug, Serialize)]
struct Clean {
    scene: &'static str,
    light: &'static str,
    seed: u64,
    /// Inconsistent findings: false alarms.
    alarms: Vec<String>,
    /// Per camera: whether its rotation is determined, and whether its image times are.
    determined: Vec<[bool; 2]>,
    /// Errors over their sigmas: of stereo and of IMU rotations (three axes each), of time offsets.
    scores: [Vec<f64>; 3],
    /// Sigma of a camera's rotation against its IMU (worst axis, degrees), of its time offset (ms)
    /// and its error, per camera, with all, half and a quarter of the bursts.
    by_bursts: Vec<Vec<[f64; 3]>>,
    seconds: f64,
}

/// Runs the benchmark: `[--quick] [--walks N] [--cache DIR] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. Findings are a result and not an error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let mut walks = WALKS;
    let mut out = PathBuf::from("docs/benchmarks");
    let mut cache = None;
    let mut rest = args.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--quick" => walks = QUICK_WALKS,
            "--walks" => walks = rest.next().context("--walks needs a number")?.parse()?,
            "--cache" => {
                cache = Some(PathBuf::from(
                    rest.next().context("--cache needs a folder")?,
                ))
            }
            "--out" => out = rest.next().context("--out needs a folder")?.into(),
            other => bail!(
                "unknown argument {other:?}, expected --quick, --walks N, --cache DIR or --out DIR"
            ),
        }
    }
    let stamp = stamp::stamp("calib_verify", args)?;
    let mut clean = Vec::new();
    let mut points = Vec::new();
    for number in 0..walks {
        let (kind, light) = scene_and_light(number);
        let seed = FIRST_SEED + number as u64;
        let walk = walk(kind, light, seed, cache.as_deref())?;
        let (found, took) = timed(|| walk.compare());
        let mut as_it_is = clean_walk(&walk, &found);
        as_it_is.seconds = took.wall_s;
        (as_it_is.scene, as_it_is.light, as_it_is.seed) = (kind.name(), light.name(), seed);
        println!("{number:3} {}", as_it_is.line());
        clean.push(as_it_is);
        points.extend(wrong_points(&walk, &found, number));
    }
    let real = real::run()?;
    let report = json!({
        "benchmark": "calib_verify",
        "stamp": stamp,
        "real": real,
        "walks": clean,
        "false_alarms": clean.iter().filter(|c| !c.alarms.is_empty()).count(),
        "wrong": table(&points),
    });
    for row in table(&points) {
        println!("{}", row.line());
    }
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let mut files = vec![("calib_verify.json".to_owned(), format!("{report:#}\n"))];
    files.extend(charts::draw(&clean, &points, &stamp::line(&stamp)));
    for (name, text) in files {
        let path = out.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        println!("wrote {}", path.display());
    }
    Ok(())
}

/// Scenes and lights cycled, so that all combinations occur.
fn scene_and_light(number: usize) -> (Kind, Lighting) {
    let kinds = Kind::ALL.len();
    let light = (number + number / kinds) % Lighting::ALL.len();
    (Kind::ALL[number % kinds], Lighting::ALL[light])
}

fn walk(kind: Kind, light: Lighting, seed: u64, cache: Option<&Path>) -> Result<Walk> {
    let file = cache.map(|dir| dir.join(format!("{}-{}-{seed}.json", kind.name(), light.name())));
    if let Some(path) = &file
        && let Ok(bytes) = fs::read(path)
    {
        return serde_json::from_slice(&bytes)
            .with_context(|| format!("reading {}", path.display()));
    }
    let walk = Walk::make(kind, light, seed, &Plan::MINUTE)?;
    if let (Some(dir), Some(path)) = (cache, &file) {
        fs::create_dir_all(dir).with_context(|| format!("making {}", dir.display()))?;
        fs::write(path, serde_json::to_vec(&walk)?)
            .with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(walk)
}

fn clean_walk(walk: &Walk, found: &[CameraEstimate]) -> Clean {
    let verification = walk.verify(&NominalError::None, found);
    let off = verification
        .findings
        .iter()
        .filter(|f| f.status == Status::Inconsistent);
    let mut scores = [Vec::new(), Vec::new(), Vec::new()];
    for camera in found {
        if let Some(eyes) = &camera.eyes {
            scores[0].extend((0..3).map(|k| eyes.rotation_rad[k] / eyes.sigma_rad[k]));
        }
        if let Some(imu) = &camera.imu {
            scores[1].extend((0..3).map(|k| imu.rotation_rad[k] / imu.sigma_rad[k]));
            scores[2].push(imu.time_offset_s / imu.time_offset_sigma_s);
        }
    }
    let is_seen = |name: &str, what: Parameter| {
        let of = verification
            .findings
            .iter()
            .find(|f| f.camera == name && f.parameter == what);
        of.is_some_and(|f| f.status != Status::Undetermined)
    };
    let sigmas = |found: &[CameraEstimate]| -> Vec<[f64; 3]> {
        let of = |camera: &CameraEstimate| match &camera.imu {
            None => [f64::NAN; 3],
            Some(imu) => [
                imu.sigma_rad
                    .iter()
                    .copied()
                    .fold(0.0, f64::max)
                    .to_degrees(),
                imu.time_offset_sigma_s * 1e3,
                imu.time_offset_s * 1e3,
            ],
        };
        found.iter().map(of).collect()
    };
    let mut by_bursts = vec![sigmas(found)];
    by_bursts.extend([2, 4].map(|every| sigmas(&walk.thinned(every).compare())));
    Clean {
        scene: "",
        light: "",
        seed: 0,
        alarms: off.map(|f| f.text.clone()).collect(),
        determined: walk
            .names()
            .iter()
            .map(|name| [Parameter::Camera, Parameter::ImageTime].map(|what| is_seen(name, what)))
            .collect(),
        scores,
        by_bursts,
        seconds: 0.0,
    }
}

/// All falsified values of one walk. The axis of a rotation changes from walk to walk and camera to
/// camera.
fn wrong_points(walk: &Walk, found: &[CameraEstimate], number: usize) -> Vec<Point> {
    let mut points = Vec::new();
    for (k, name) in walk.names().into_iter().enumerate() {
        let axis = (number + k) % 3;
        let sign = if number.is_multiple_of(2) { 1.0 } else { -1.0 };
        let about = |deg: f64| {
            let mut rad = [0.0; 3];
            rad[axis] = sign * deg.to_radians();
            rad
        };
        let turns = ROTATIONS_DEG.map(|deg| {
            (
                Parameter::Camera,
                deg,
                NominalError::CameraRotation(k, about(deg)),
            )
        });
        let eyes = STEREO_ROTATIONS_DEG.map(|deg| {
            (
                Parameter::StereoRotation,
                deg,
                NominalError::StereoRotation(k, about(deg)),
            )
        });
        let late = |ms: f64| sign * ms * 1e-3;
        let images = TIME_OFFSETS_MS.map(|ms| {
            (
                Parameter::ImageTime,
                ms,
                NominalError::ImageTime(k, late(ms)),
            )
        });
        let clocks =
            TIME_OFFSETS_MS.map(|ms| (Parameter::Clock, ms, NominalError::Clock(k, late(ms))));
        let all = turns.into_iter().chain(eyes).chain(images).chain(clocks);
        points.extend(all.map(|(what, size, wrong)| {
            let verification = walk.verify(&wrong, found);
            let outcome = outcome(&verification, what, name, size);
            let score = match wrong {
                NominalError::StereoRotation(_, rad) => score(&verification.cameras[k], rad),
                _ => None,
            };
            Point {
                walk: number,
                what,
                camera: name.to_owned(),
                size,
                outcome,
                score,
            }
        }));
    }
    points
}

/// Error of the rotation of a right camera over its sigma, largest of three axes.
fn score(found: &CameraEstimate, actual_rad: [f64; 3]) -> Option<f64> {
    let eyes = found.eyes.as_ref()?;
    let scores = (0..3).map(|k| (eyes.rotation_rad[k] - actual_rad[k]).abs() / eyes.sigma_rad[k]);
    scores.reduce(f64::max)
}

fn outcome(verification: &Verification, what: Parameter, camera: &str, size: f64) -> Outcome {
    let off = |f: &&Finding| f.status == Status::Inconsistent;
    let own = verification.findings.iter();
    let own = own
        .clone()
        .find(|f| f.parameter == what && f.camera == camera);
    let noticed = |f: &Finding| match what.is_rotation() {
        true => f.min_detectable.to_degrees(),
        false => f.min_detectable * 1e3,
    };
    match own {
        Some(f) if f.status == Status::Inconsistent && f.alternatives.is_empty() => Outcome::Named,
        _ if verification.findings.iter().any(|f| off(&f)) => Outcome::Flagged,
        Some(f) if f.status == Status::Consistent && size > noticed(f) => Outcome::Silent,
        Some(f) if f.status == Status::Consistent => Outcome::Within,
        _ => Outcome::Undetermined,
    }
}

/// Number of points by outcome, of one size.
#[derive(Serialize)]
struct Row {
    what: Parameter,
    /// Degrees or ms.
    size: f64,
    named: usize,
    flagged: usize,
    undetermined: usize,
    within: usize,
    silent: usize,
    /// Right cameras: error over sigma, largest of all; number beyond three.
    #[serde(skip_serializing_if = "Option::is_none")]
    worst_score: Option<f64>,
    beyond_three_sigmas: usize,
    /// Walks and cameras of those that are neither named nor flagged, where they are few.
    missed: Vec<String>,
}

impl Row {
    fn line(&self) -> String {
        let unit = if self.what.is_rotation() { "deg" } else { "ms" };
        let scores = self.worst_score.map_or_else(String::new, |worst| {
            let beyond = self.beyond_three_sigmas;
            format!(", beyond three sigmas {beyond}, worst {worst:.1}")
        });
        format!(
            "{:?} {} {unit}: named {}, flagged {}, undetermined {}, within {}, silent {}{scores}",
            self.what,
            self.size,
            self.named,
            self.flagged,
            self.undetermined,
            self.within,
            self.silent
        )
    }
}

/// Outcomes by falsified parameter and size.
fn table(points: &[Point]) -> Vec<Row> {
    let mut rows = Vec::new();
    for (what, sizes) in [
        (Parameter::Camera, &ROTATIONS_DEG[..]),
        (Parameter::StereoRotation, &STEREO_ROTATIONS_DEG),
        (Parameter::ImageTime, &TIME_OFFSETS_MS),
        (Parameter::Clock, &TIME_OFFSETS_MS),
    ] {
        for size in sizes {
            let [named, flagged, undetermined, within, silent] = counts(points, what, *size);
            let own = points.iter().filter(|p| p.what == what && p.size == *size);
            let scores = own.clone().filter_map(|p| p.score);
            let missed = own.filter(|p| !matches!(p.outcome, Outcome::Named | Outcome::Flagged));
            let mut missed: Vec<String> =
                missed.map(|p| format!("{} {}", p.walk, p.camera)).collect();
            if 5 * missed.len() > named + flagged + missed.len() {
                missed.clear();
            }
            rows.push(Row {
                what,
                size: *size,
                named,
                flagged,
                undetermined,
                within,
                silent,
                worst_score: scores.clone().reduce(f64::max),
                beyond_three_sigmas: scores.filter(|s| *s > 3.0).count(),
                missed,
            });
        }
    }
    rows
}

/// Number of points by outcome, in the order of [`Outcome`].
fn counts(points: &[Point], what: Parameter, size: f64) -> [usize; 5] {
    let all = [
        Outcome::Named,
        Outcome::Flagged,
        Outcome::Undetermined,
        Outcome::Within,
        Outcome::Silent,
    ];
    all.map(|outcome| {
        let of = |p: &&Point| p.what == what && p.size == size && p.outcome == outcome;
        points.iter().filter(of).count()
    })
}

impl Clean {
    fn line(&self) -> String {
        let seen: String = self
            .determined
            .iter()
            .flatten()
            .map(|seen| if *seen { '+' } else { '-' })
            .collect();
        format!(
            "{:9} {:8} {} determined {seen} {:.2} s {}",
            self.scene,
            self.light,
            self.seed,
            self.seconds,
            self.alarms.join("; ")
        )
    }
}
