//! `odometry_faults`: poses under faults.
//!
//! Each kind of fault of the simulator
//! ([docs/reference/rig-sim.md](../../../../../docs/reference/rig-sim.md)) acts for four seconds in
//! the middle of short walks, on all cameras simultaneously (faults that move a camera: on one), at
//! rising strength. Outcomes of a point:
//!
//! - *ok*: every pose is tracked and within 3 of its stated sigmas, in position and rotation;
//! - *flagged*: some poses are dead reckoned or lost, or a camera is reported as moved, and every
//!   tracked pose is within its sigmas;
//! - *silently wrong*: the error of a tracked pose is more than 3 sigmas (with a right covariance
//!   this happens for 0.27 % of the poses, and errors of neighbours are correlated, so that a few
//!   false alarms occur; walks without a fault are included for comparison).
//!
//! Errors are those of the motion since the start of the fault, so that earlier errors do not
//! count. Faults of light and lenses are rendered; faults of devices are applied to images of the
//! same walk that were rendered once ([`harness::sequences::Sequence::with_images`]). Times in a
//! sequence are true ones, so that faults of clocks show only the loss of data.

use std::sync::Arc;

use anyhow::{Context, Result};
use harness::sequences::{self, OwnedFrameSet, Sequence, WalkSettings, named};
use harness::tracking;
use rig_sim::camera::Quality;
use rig_sim::faults::{Fault, Faults, Kind};
use scene_bundle::{Status, Trajectory};
use serde::Serialize;
use serde_json::json;

mod charts;

use super::figures::Figures;
use super::options::Options;
use super::{results, settings};
use crate::stamp;

/// Walks with faults.
const WALKS: [&str; 3] = [
    "pavement-day-31-20",
    "corridor-flicker-32-20",
    "stairs-low-sun-33-20",
];
/// Start and end of a fault, s.
const FROM_S: f64 = 6.0;
const TO_S: f64 = 10.0;
/// The camera that is shifted; its IMU is the one in use.
const SHIFTED: &str = "left_shoulder";
/// Kinds and strengths.
const POINTS: [(Kind, &[f64]); 18] = [
    (Kind::Dropped, &[0.2, 0.5, 0.8, 1.0]),
    (Kind::Late, &[0.05, 0.2, 1.0]),
    (Kind::Duplicated, &[0.5]),
    (Kind::Frozen, &[0.1, 0.3, 0.6, 1.0]),
    (Kind::Torn, &[0.1, 0.3, 0.6, 1.0]),
    (Kind::LatencyBurst, &[0.05, 0.2, 1.0]),
    (Kind::ClockStep, &[1.0]),
    (Kind::ClockDrift, &[200.0]),
    (Kind::TickWrap, &[1.0]),
    (Kind::Disconnect, &[0.2, 0.5, 1.0, 2.0, 4.0]),
    (Kind::ImuGap, &[0.05, 0.2, 1.0, 4.0]),
    (Kind::ImuClipping, &[0.8, 0.9, 0.95, 0.98]),
    (Kind::Darkness, &[2.0, 4.0, 6.0, 8.0, 12.0]),
    (Kind::Flash, &[1.0, 10.0, 100.0]),
    (Kind::CoveredLens, &[0.3, 0.6, 0.9, 1.0]),
    (Kind::DirtyLens, &[0.2, 0.5, 0.9]),
    (Kind::Blur, &[0.002, 0.005, 0.01, 0.03]),
    (Kind::ShiftedCamera, &[0.2, 0.5, 1.0, 3.0]),
];

/// Outcome of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Outcome {
    Ok,
    Flagged,
    SilentlyWrong,
}

/// One fault on one walk.
#[derive(Clone, Debug, Serialize)]
struct Point {
    walk: &'static str,
    /// None for a walk without a fault.
    kind: Option<&'static str>,
    unit: Option<&'static str>,
    strength: f64,
    outcome: Outcome,
    /// Largest error of the motion since the start of the fault: translation, m, and rotation,
    /// degrees.
    off_m: f64,
    off_deg: f64,
    /// Number of cameras reported as moved.
    shifts: usize,
    /// Both at the end of the walk.
    end_m: f64,
    end_deg: f64,
    figures: Figures,
}

/// Runs the benchmark: `[--quick] [--only KIND,...] [--name WALK,...] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. Outcomes are a result and not an error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let kinds = POINTS.map(|(kind, _)| kind.name());
    let options = Options::parse(args, &kinds)?;
    let stamp = stamp::stamp("odometry_faults", args)?;
    let mut points = Vec::new();
    for walk in WALKS.into_iter().filter(|walk| options.takes(walk)) {
        let clean = sequence(walk, Faults::default())?;
        let sets: Result<Vec<OwnedFrameSet>> = clean.frame_sets()?.collect();
        let sets = Arc::new(sets.with_context(|| format!("rendering {walk}"))?);
        let clean = clean.with_images(&sets)?;
        add(&mut points, point(walk, None, &clean)?);
        for (kind, strengths) in POINTS {
            if !options.parts.iter().any(|part| part == kind.name()) {
                continue;
            }
            for strength in options.strengths(strengths) {
                let faulty = sequence(walk, faults(kind, *strength))?;
                let faulty = match is_of_light(kind) {
                    true => faulty,
                    false => faulty.with_images(&sets)?,
                };
                add(&mut points, point(walk, Some((kind, *strength)), &faulty)?);
            }
        }
        if options.quick {
            break;
        }
    }
    let count = |outcome| points.iter().filter(|p| p.outcome == outcome).count();
    let report = json!({
        "benchmark": "odometry_faults",
        "stamp": stamp,
        "from_s": FROM_S,
        "to_s": TO_S,
        "ok": count(Outcome::Ok),
        "flagged": count(Outcome::Flagged),
        "silently_wrong": count(Outcome::SilentlyWrong),
        "points": points,
    });
    let mut files = vec![("odometry_faults.json".to_owned(), format!("{report:#}\n"))];
    files.extend(charts::draw(&points, &stamp::line(&stamp)));
    results::write(&options.out, files)
}

fn sequence(walk: &str, faults: Faults) -> Result<Sequence> {
    let settings = WalkSettings {
        quality: Quality::FAST,
        faults,
        ..named::settings(walk)?
    };
    sequences::walk(&settings)
}

fn faults(kind: Kind, strength: f64) -> Faults {
    let fault = Fault {
        kind,
        strength,
        from_s: FROM_S,
        to_s: TO_S,
        camera: (kind == Kind::ShiftedCamera).then(|| SHIFTED.to_owned()),
        foot: None,
    };
    Faults {
        list: vec![fault],
        seed: 1,
    }
}

/// Whether images must be rendered with it.
fn is_of_light(kind: Kind) -> bool {
    use Kind::{Blur, CoveredLens, Darkness, DirtyLens, Flash, ShiftedCamera};
    [Blur, CoveredLens, Darkness, DirtyLens, Flash, ShiftedCamera].contains(&kind)
}

fn add(points: &mut Vec<Point>, point: Point) {
    let [tracked, carried, lost] = point.figures.poses;
    println!(
        "{:22} {:14} {:6} {:14} error {:.3} m {:.2} deg, at the end {:.3} m {:.2} deg; {tracked} tracked, {carried} carried, {lost} lost, {} moved, {} silently wrong{}",
        point.walk,
        point.kind.unwrap_or("no fault"),
        point.strength,
        format!("{:?}", point.outcome),
        point.off_m,
        point.off_deg,
        point.end_m,
        point.end_deg,
        point.shifts,
        point.figures.silently_wrong,
        point
            .figures
            .first_wrong_s
            .map_or_else(String::new, |s| format!(", the first at {s:.1} s")),
    );
    points.push(point);
}

fn point(walk: &'static str, fault: Option<(Kind, f64)>, sequence: &Sequence) -> Result<Point> {
    let tracking = tracking::track(sequence, settings::parse("balanced")?, false)?;
    let truth = tracking::truth(sequence)?;
    let figures = Figures::of(tracking.causal(), &truth)?;
    let outcome = match figures.poses {
        _ if figures.silently_wrong > 0 => Outcome::SilentlyWrong,
        [_, 0, 0] if tracking.camera_shifts().is_empty() => Outcome::Ok,
        _ => Outcome::Flagged,
    };
    let since = motion_errors(tracking.causal(), &truth);
    let most = |k: usize| since.iter().map(|e| e[k]).fold(0.0, f64::max);
    let end = since.last().copied().unwrap_or([f64::NAN; 2]);
    Ok(Point {
        walk,
        kind: fault.map(|(kind, _)| kind.name()),
        unit: fault.map(|(kind, _)| kind.unit()),
        strength: fault.map_or(0.0, |(_, strength)| strength),
        outcome,
        shifts: tracking.camera_shifts().len(),
        off_m: most(0),
        off_deg: most(1),
        end_m: end[0],
        end_deg: end[1],
        figures,
    })
}

/// Errors of the motion from the last pose before the fault to each later one that is not lost: m
/// and degrees.
fn motion_errors(estimate: &Trajectory, truth: &Trajectory) -> Vec<[f64; 2]> {
    let pairs = estimate.poses().iter().filter_map(|pose| {
        let truth = truth.at(pose.time_ns)?;
        Some((pose, truth.world_from_rig))
    });
    let is_before = |time_ns: i64| (time_ns as f64) < FROM_S * 1e9;
    let (mut from, mut errors) = (None, Vec::new());
    for (pose, truth) in pairs {
        if is_before(pose.time_ns) {
            from = Some((pose.world_from_rig, truth));
        } else if let Some((estimated_from, true_from)) = from
            && pose.status != Status::Lost
        {
            let moved = estimated_from.inverse() * pose.world_from_rig;
            let error = (true_from.inverse() * truth).inverse() * moved;
            errors.push([error.distance_m(), error.angle_rad().to_degrees()]);
        }
    }
    errors
}
