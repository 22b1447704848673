//! `calib`: accuracy of calibrations from targets, and whether bad ones are flagged.
//!
//! The rig deviates from its files: cameras by a millimetre and a third of a degree, lenses by a
//! few pixels from the factory calibration. Corners are where the simulated cameras see them, with
//! noise; a few sessions are rendered and go through detection too.
//!
//! 1. Error against number of views against time, for one stereo camera, ours beside OpenCV's on
//!    the same corners in the same run.
//! 2. Selected lens model against the amount of distortion and the number of views.
//! 3. Error against the strength of each impairment of a recording. A point is *ok* when cameras
//!    are within 1 mm and 0.05 degrees of their true relative pose, or within three of the sigmas
//!    that are stated; *flagged* when they are not and a finding warns; *silently wrong* otherwise.
//!    The third kind must not exist.
//! 4. Ratio of errors of good sessions within two of the stated sigmas.
//! 5. Rendered sessions from images to the rig with the extrinsics and time offsets of its IMUs.

use std::fs;

use anyhow::{Context, Result};
use calib::cameras::{Calibration, Config, Severity, calibrate};
use rig_sim::targets::{Motion, Plan};
use serde_json::{Value, json};

mod charts;
mod end_to_end;
mod opencv;
mod rendered;
mod scenario;

use crate::arguments::Arguments;
use crate::meter::timed;
use crate::{python, stamp};
use scenario::{Impairments, Recording};

/// Maximum error of the relative pose of two cameras: m and degrees.
const MAX_ERROR: (f64, f64) = (1e-3, 0.05);
/// An error beyond this many stated sigmas is not covered by them.
const FLAG_SIGMAS: f64 = 3.0;

/// Outcome of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Ok,
    Flagged,
    SilentlyWrong,
}

impl Verdict {
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Flagged => "flagged",
            Self::SilentlyWrong => "silently wrong",
        }
    }
}

/// One impaired recording.
struct Point {
    pub(crate) kind: &'static str,
    pub(crate) strength: f64,
    pub(crate) seed: u64,
    /// Worst error between cameras: m, degrees; `None` without a result.
    pub(crate) error: Option<(f64, f64)>,
    pub(crate) verdict: Verdict,
    pub(crate) finding: String,
    pub(crate) rms_px: f64,
}

/// Kinds of impairments, their units, and rising strengths.
type Kind = (
    &'static str,
    &'static str,
    &'static [f64],
    fn(f64) -> Impairments,
);

const KINDS: &[Kind] = &[
    ("noise of corners", "px", &[0.05, 0.1, 0.3, 1.0, 3.0], |s| {
        Impairments {
            sigma_px: s,
            ..Impairments::default()
        }
    }),
    (
        "number of views",
        "views",
        &[4.0, 8.0, 16.0, 32.0, 64.0],
        |s| Impairments {
            plan: Plan {
                views: Some(s as usize),
                ..Plan::GOOD
            },
            ..Impairments::default()
        },
    ),
    (
        "views all fronto-parallel, number",
        "views",
        &[8.0, 32.0, 64.0],
        |s| Impairments {
            plan: Plan {
                motion: Motion::Parallel,
                views: Some(s as usize),
                ..Plan::GOOD
            },
            ..Impairments::default()
        },
    ),
    ("bowed boards", "mm", &[0.3, 1.0, 3.0, 10.0, 30.0], |s| {
        Impairments {
            plan: Plan {
                bow_m: 1e-3 * s,
                ..Plan::GOOD
            },
            ..Impairments::default()
        }
    }),
    (
        "boards larger than nominal",
        "%",
        &[0.1, 0.3, 1.0, 3.0, 10.0],
        |s| Impairments {
            plan: Plan {
                scale_error: 1e-2 * s,
                ..Plan::GOOD
            },
            ..Impairments::default()
        },
    ),
    (
        "camera knocked half-way",
        "degrees",
        &[0.02, 0.05, 0.1, 0.3, 1.0, 3.0],
        |s| Impairments {
            knock_deg: s,
            ..Impairments::default()
        },
    ),
];

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, no interpreter in `PAWS_PYTHON`, or an I/O error. Wrong results are results.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let stamp = stamp::stamp("calib", args)?;
    // Before the long part, not after it.
    python::interpreter()?;
    let seeds = if quick { 1 } else { 3 };

    let views = against_views(quick)?;
    let models = against_distortion(quick)?;
    let mut points = Vec::new();
    for (kind, unit, strengths, impairments) in KINDS {
        for (i, &strength) in strengths.iter().enumerate() {
            if quick && i % 2 == 1 {
                continue;
            }
            for seed in 0..seeds {
                eprintln!("{kind}: {strength} {unit} ...");
                points.push(impaired(kind, strength, seed, &impairments(strength))?);
            }
        }
    }
    points.extend(rendered::points(quick)?);
    let good = good(if quick { 4 } else { 20 })?;
    let whole = end_to_end::sessions(if quick { 1 } else { 8 })?;

    let silent = points
        .iter()
        .filter(|p| p.verdict == Verdict::SilentlyWrong)
        .count();
    let document = json!({
        "stamp": stamp,
        "views": views,
        "models": models,
        "troubles": points.iter().map(Point::json).collect::<Vec<Value>>(),
        "silently_wrong": silent,
        "good": good,
        "rendered": whole,
    });
    let path = out.join("calib.json");
    fs::write(&path, format!("{document:#}\n"))
        .with_context(|| format!("writing {}", path.display()))?;
    charts::draw(&out, &views, &models, &points)?;
    println!("{silent} of {} points silently wrong", points.len());
    println!("good sessions: {good}");
    println!("rendered sessions: {whole}");
    Ok(())
}

impl Point {
    fn json(&self) -> Value {
        json!({
            "kind": self.kind,
            "strength": self.strength,
            "seed": self.seed,
            "error_mm": self.error.map(|e| 1e3 * e.0),
            "error_deg": self.error.map(|e| e.1),
            "rms_px": self.rms_px,
            "verdict": self.verdict.word(),
            "finding": self.finding,
        })
    }
}

/// Calibrates with the factory's lens model.
fn quiet() -> Config {
    let mut config = Config::default();
    config.choose_lens = false;
    config
}

fn impaired(
    kind: &'static str,
    strength: f64,
    seed: u64,
    impairments: &Impairments,
) -> Result<Point> {
    let recording = Recording::new(seed, impairments)?;
    let input = recording.input(impairments.sigma_px);
    Ok(judge(
        kind,
        strength,
        seed,
        &recording,
        calibrate(input, &quiet(), &mut |_, _| {}),
    ))
}

/// Outcome of a result.
fn judge(
    kind: &'static str,
    strength: f64,
    seed: u64,
    recording: &Recording,
    result: Result<Calibration, calib::cameras::CamerasError>,
) -> Point {
    let found = match result {
        Ok(found) => found,
        // An error is a flag.
        Err(error) => {
            return Point {
                kind,
                strength,
                seed,
                error: None,
                verdict: Verdict::Flagged,
                finding: error.to_string(),
                rms_px: f64::NAN,
            };
        }
    };
    let errors = recording.errors(&found);
    let worst = |part: fn(&scenario::Error) -> f64| errors.iter().map(part).fold(0.0, f64::max);
    let error = (worst(|e| e.metres), worst(|e| e.degrees));
    let within = errors.iter().all(|e| e.sigmas <= FLAG_SIGMAS);
    let flagged = found.findings.iter().find(|f| f.severity >= Severity::Warn);
    let verdict = match (error.0 <= MAX_ERROR.0 && error.1 <= MAX_ERROR.1) || within {
        true if flagged.is_none_or(|f| f.severity < Severity::Fail) => Verdict::Ok,
        _ if flagged.is_some() => Verdict::Flagged,
        _ => Verdict::SilentlyWrong,
    };
    Point {
        kind,
        strength,
        seed,
        error: Some(error),
        verdict,
        finding: flagged.map(|f| f.text.clone()).unwrap_or_default(),
        rms_px: found.solution.rms_px(|_| true),
    }
}

/// One stereo camera, ours and OpenCV's, by number of views.
fn against_views(quick: bool) -> Result<Value> {
    let mut rows = Vec::new();
    let counts: &[usize] = if quick {
        &[8, 20]
    } else {
        &[5, 8, 12, 20, 40, 80]
    };
    for &count in counts {
        for seed in 0..if quick { 1 } else { 3 } {
            eprintln!("{count} views ...");
            let impairments = Impairments::default();
            let recording = Recording::new(100 + seed, &impairments)?;
            let input = recording.one_camera(impairments.sigma_px, count);
            let (found, took) = timed(|| calibrate(input.clone(), &quiet(), &mut |_, _| {}));
            let ours = match found {
                Ok(found) => recording.pair_errors(
                    found.lens(0),
                    &found.pose(found.poses.pairs[0].expect("a pair")).0,
                ),
                Err(_) => continue,
            };
            let theirs = opencv::calibrate(&input)?;
            let their_errors = recording.pair_errors(&theirs.left, &theirs.left_from_right);
            rows.push(json!({
                "views": count,
                "seed": seed,
                "ours": { "shift_mm": 1e3 * ours.0, "turn_deg": ours.1, "focal_px": ours.2, "seconds": took.cpu_s },
                "opencv": { "shift_mm": 1e3 * their_errors.0, "turn_deg": their_errors.1, "focal_px": their_errors.2, "seconds": theirs.seconds },
            }));
        }
    }
    Ok(Value::Array(rows))
}

/// Which lens model is chosen.
fn against_distortion(quick: bool) -> Result<Value> {
    let mut rows = Vec::new();
    let strengths: &[f64] = if quick {
        &[0.0, 1.0]
    } else {
        &[0.0, 0.03, 0.1, 0.3, 1.0, 1.3]
    };
    let counts: &[usize] = if quick { &[20] } else { &[10, 20, 40] };
    for &strength in strengths {
        for &count in counts {
            eprintln!("distortion {strength}, {count} views ...");
            let impairments = Impairments {
                distortion: strength,
                ..Impairments::default()
            };
            let recording = Recording::new(7, &impairments)?;
            let mut input = recording.one_camera(impairments.sigma_px, count);
            // The factory calibration would reveal the result.
            input.eyes.iter_mut().for_each(|eye| eye.factory = None);
            let Ok(found) = calibrate(input, &Config::default(), &mut |_, _| {}) else {
                rows.push(json!({ "distortion": strength, "views": count, "chosen": null }));
                continue;
            };
            let choice = &found.choices[0];
            let chosen = &choice.candidates[choice.chosen];
            rows.push(json!({
                "distortion": strength,
                "views": count,
                "chosen": chosen.model,
                "coefficients": chosen.coefficients,
                "held_out_px": chosen.held_out_px,
                "worst_px": recording.worst_pixel(found.lens(0)),
            }));
        }
    }
    Ok(Value::Array(rows))
}

/// Good sessions: number of errors within two sigma, and the worst ones.
fn good(sessions: u64) -> Result<Value> {
    let (mut inside, mut all, mut metres, mut degrees) = (0, 0, 0.0f64, 0.0f64);
    let mut flagged = 0;
    for seed in 0..sessions {
        eprintln!("good session {seed} ...");
        let impairments = Impairments::default();
        let recording = Recording::new(1000 + seed, &impairments)?;
        let found = calibrate(
            recording.input(impairments.sigma_px),
            &quiet(),
            &mut |_, _| {},
        )?;
        flagged += usize::from(found.severity() == Some(Severity::Fail));
        for error in recording.errors(&found) {
            inside += error.inside;
            all += 6;
            metres = metres.max(error.metres);
            degrees = degrees.max(error.degrees);
        }
    }
    Ok(json!({
        "sessions": sessions,
        "failed": flagged,
        "within_two_sigma": inside as f64 / f64::from(all),
        "worst_mm": 1e3 * metres,
        "worst_deg": degrees,
    }))
}
