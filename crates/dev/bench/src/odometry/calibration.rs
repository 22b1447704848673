//! `odometry_calibration`: poses with a wrong stereo calibration.
//!
//! The right eyes of the nominal rig deviate from those of the simulator: rotation about each axis,
//! principal point, baseline and focal length, at rising strength. The calibration states no
//! covariance. Walks are straight and turning, with one and three stereo cameras, with and without
//! IMU. Outcomes of a point, for causal and refined poses together:
//!
//! - *estimated*: every pose is tracked and within 3 of its stated sigmas, in position and
//!   rotation;
//! - *flagged*: the same, and the calibration is reported as wrong, or some poses are dead reckoned
//!   or lost;
//! - *silently wrong*: the error of a tracked pose is more than 3 sigmas, or that of the estimate
//!   of what deviates.
//!
//! Images are rendered once into the folder that `PAWS_WALKS` or `--walks` names.

use anyhow::Result;
use camera_models::CameraModel;
use harness::tracking::{self, RefinedWalk};
use scene_bundle::Trajectory;
use serde::Serialize;
use serde_json::json;

use super::figures::Figures;
use super::options::Options;
use super::run::Job;
use super::stereo_deviation::StereoDeviation;
use super::{results, settings};
use crate::stamp;

mod charts;

/// Walks: a straight one, turning ones. Widths of priors were chosen on them, no other constant;
/// `--name` takes any others.
const WALKS: [&str; 3] = ["corridor-day-51-20", "pavement-day-51-20", "room-day-51-20"];
/// Cameras in use, and whether their IMU is.
pub(crate) const RIGS: [(&str, &[&str], bool); 4] = [
    ("one camera", &["left_shoulder"], false),
    ("one camera, IMU", &["left_shoulder"], true),
    ("three cameras", &[], false),
    ("three cameras, IMU", &[], true),
];

/// What deviates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    RotationX,
    RotationY,
    RotationZ,
    PrincipalPointX,
    PrincipalPointY,
    Baseline,
    Focal,
}

/// Kinds and strengths, in the unit of the kind.
const POINTS: [(Kind, &[f64]); 7] = [
    (Kind::RotationX, &[0.05, 0.1, 0.2, 0.3]),
    (Kind::RotationY, &[0.05, 0.1, 0.2, 0.3]),
    (Kind::RotationZ, &[0.05, 0.1, 0.2, 0.3]),
    (Kind::PrincipalPointX, &[0.25, 0.5, 1.0, 2.0]),
    (Kind::PrincipalPointY, &[0.25, 0.5, 1.0, 2.0]),
    (Kind::Baseline, &[0.5, 1.0, 2.0, 3.0]),
    (Kind::Focal, &[0.25, 0.5, 0.75, 1.0]),
];

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::RotationX => "rotation_x",
            Self::RotationY => "rotation_y",
            Self::RotationZ => "rotation_z",
            Self::PrincipalPointX => "principal_point_x",
            Self::PrincipalPointY => "principal_point_y",
            Self::Baseline => "baseline",
            Self::Focal => "focal_length",
        }
    }

    fn unit(self) -> &'static str {
        match self {
            Self::RotationX | Self::RotationY | Self::RotationZ => "degrees",
            Self::PrincipalPointX | Self::PrincipalPointY => "px",
            Self::Baseline | Self::Focal => "%",
        }
    }

    fn deviation(self, strength: f64) -> StereoDeviation {
        let mut deviation = StereoDeviation::default();
        match self {
            Self::RotationX => deviation.rotation_deg[0] = strength,
            Self::RotationY => deviation.rotation_deg[1] = strength,
            Self::RotationZ => deviation.rotation_deg[2] = strength,
            Self::PrincipalPointX => deviation.principal_point_px[0] = strength,
            Self::PrincipalPointY => deviation.principal_point_px[1] = strength,
            Self::Baseline => deviation.baseline = strength / 100.0,
            Self::Focal => deviation.focal = strength / 100.0,
        }
        deviation
    }

    /// Component of the estimate that a deviation of this strength changes, and its true value with
    /// this lens of the right eye. A vertical offset of the principal point is none of them.
    fn true_error(self, strength: f64, lens: &CameraModel) -> Option<(usize, f64)> {
        // The calibration deviates, so that the eye has the opposite error.
        Some(match self {
            Self::RotationX => (0, -strength.to_radians()),
            Self::RotationY => (1, -strength.to_radians()),
            Self::RotationZ => (2, -strength.to_radians()),
            Self::PrincipalPointX => (5, -strength / lens.fx),
            Self::PrincipalPointY => return None,
            Self::Baseline => (3, -(strength / 100.0).ln_1p()),
            Self::Focal => (4, -(strength / 100.0).ln_1p()),
        })
    }
}

/// Outcome of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Outcome {
    Estimated,
    Flagged,
    SilentlyWrong,
}

/// One deviation on one walk with one rig.
#[derive(Clone, Debug, Serialize)]
struct Point {
    walk: String,
    rig: &'static str,
    /// None for an exact calibration.
    kind: Option<&'static str>,
    unit: Option<&'static str>,
    strength: f64,
    outcome: Outcome,
    causal: PoseErrors,
    refined: PoseErrors,
    /// Number of cameras whose calibration is reported as wrong.
    reported: usize,
    /// Estimated error of each camera, with its sigmas; see `odometry::mapping::RefinedStereo`.
    estimates: Vec<[[f64; 7]; 2]>,
    /// Largest deviation of the estimate of what deviates from the truth, in its sigmas. None for
    /// an exact calibration, and where no single component of the estimate corresponds.
    estimate_sigmas: Option<f64>,
}

/// Errors of a trajectory, and what it states of them.
#[derive(Clone, Debug, Serialize)]
struct PoseErrors {
    /// Root mean square of the stated position sigma over all poses, percent of the path length.
    sigma_percent: Option<f64>,
    figures: Figures,
}

/// Runs the benchmark: `[--quick] [--only KIND,...] [--name WALK,...] [--walks DIR] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. Outcomes are a result and not an error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let kinds = POINTS.map(|(kind, _)| kind.name());
    let options = Options::parse(args, &kinds)?;
    let stamp = stamp::stamp("odometry_calibration", args)?;
    let mut points = Vec::new();
    for walk in &options.walks_or(&WALKS) {
        for rig in RIGS {
            points.push(point(walk, rig, None, &options)?);
            for (kind, strengths) in POINTS {
                if !options.parts.iter().any(|part| part == kind.name()) {
                    continue;
                }
                for strength in options.strengths(strengths) {
                    points.push(point(walk, rig, Some((kind, *strength)), &options)?);
                }
            }
        }
        if options.quick {
            break;
        }
    }
    let count = |outcome| points.iter().filter(|p| p.outcome == outcome).count();
    let report = json!({
        "benchmark": "odometry_calibration",
        "stamp": stamp,
        "estimated": count(Outcome::Estimated),
        "flagged": count(Outcome::Flagged),
        "silently_wrong": count(Outcome::SilentlyWrong),
        "points": points,
    });
    let name = "odometry_calibration.json".to_owned();
    let mut files = vec![(name, format!("{report}\n"))];
    files.extend(charts::draw(&points, &stamp::line(&stamp)));
    results::write(&options.out, files)
}

fn point(
    walk: &str,
    (rig, cameras, with_imu): (&'static str, &[&str], bool),
    deviation: Option<(Kind, f64)>,
    options: &Options,
) -> Result<Point> {
    let mut job = Job::whole(walk, "balanced", true);
    job.cameras = cameras.iter().map(|name| (*name).to_owned()).collect();
    job.with_imu = with_imu;
    job.stereo = Some(
        deviation.map_or_else(StereoDeviation::default, |(kind, strength)| {
            kind.deviation(strength)
        }),
    );
    let sequence = job.sequence(&options.walks)?;
    let tracking = tracking::track(&sequence, settings::parse(&job.settings)?, true)?;
    let truth = tracking::truth(&sequence)?;
    let causal = PoseErrors::of(tracking.causal(), &truth)?;
    let refined = tracking.refine()?.expect("mapping is in use");
    let estimate_sigmas = deviation.and_then(|(kind, strength)| {
        let each = refined.stereo.iter().zip(&sequence.rig().cameras);
        let sigmas = each.filter_map(|(stereo, camera)| {
            let (component, truth) = kind.true_error(strength, &camera.right)?;
            Some((stereo.error[component] - truth).abs() / stereo.sigmas()[component])
        });
        sigmas.reduce(f64::max)
    });
    let point = Point {
        walk: walk.to_owned(),
        rig,
        kind: deviation.map(|(kind, _)| kind.name()),
        unit: deviation.map(|(kind, _)| kind.unit()),
        strength: deviation.map_or(0.0, |(_, strength)| strength),
        outcome: Outcome::Estimated,
        causal,
        refined: PoseErrors::of(&refined.trajectory, &truth)?,
        reported: refined.stereo.iter().filter(|s| s.is_significant).count(),
        estimates: estimates(&refined),
        estimate_sigmas,
    };
    let point = Point {
        outcome: point.judge(),
        ..point
    };
    println!("{}", point.line());
    Ok(point)
}

fn estimates(refined: &RefinedWalk) -> Vec<[[f64; 7]; 2]> {
    let each = refined.stereo.iter();
    each.map(|stereo| [stereo.error, stereo.sigmas()]).collect()
}

impl Point {
    fn with_imu(&self) -> bool {
        RIGS.iter()
            .any(|(rig, _, with_imu)| *rig == self.rig && *with_imu)
    }

    fn judge(&self) -> Outcome {
        let both = [&self.causal.figures, &self.refined.figures];
        let all_tracked = both.iter().all(|f| matches!(f.poses, [_, 0, 0]));
        let is_estimate_wrong = self.estimate_sigmas.is_some_and(|sigmas| sigmas > 3.0);
        if is_estimate_wrong || both.iter().any(|f| f.silently_wrong > 0) {
            Outcome::SilentlyWrong
        } else if self.reported > 0 || !all_tracked {
            Outcome::Flagged
        } else {
            Outcome::Estimated
        }
    }

    /// Progress line.
    fn line(&self) -> String {
        let of = |errors: &PoseErrors| {
            format!(
                "{:.3} % (stated {:.3} %, {} silently wrong)",
                errors.figures.ate_percent.unwrap_or(f64::NAN),
                errors.sigma_percent.unwrap_or(f64::NAN),
                errors.figures.silently_wrong
            )
        };
        format!(
            "{:20} {:18} {:18} {:5} {:14} causal {}, refined {}, {} reported{}",
            self.walk,
            self.rig,
            self.kind.unwrap_or("exact"),
            self.strength,
            format!("{:?}", self.outcome),
            of(&self.causal),
            of(&self.refined),
            self.reported,
            self.estimate_sigmas
                .map_or_else(String::new, |s| format!(", estimate within {s:.1} sigmas")),
        )
    }
}

impl PoseErrors {
    fn of(estimate: &Trajectory, truth: &Trajectory) -> Result<Self> {
        let figures = Figures::of(estimate, truth)?;
        let variances: Vec<f64> = (estimate.usable())
            .filter_map(|pose| {
                let rows = pose.covariance.as_ref()?.rows();
                Some((0..3).map(|k| rows[k][k]).sum())
            })
            .collect();
        let path_m = match (figures.ate_m, figures.ate_percent) {
            (Some(m), Some(percent)) if percent > 0.0 => Some(100.0 * m / percent),
            _ => None,
        };
        let mean = variances.iter().sum::<f64>() / variances.len().max(1) as f64;
        Ok(Self {
            sigma_percent: path_m.map(|path_m| 100.0 * mean.sqrt() / path_m),
            figures,
        })
    }
}
