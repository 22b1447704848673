//! The real recordings at hand: a short drive, and a second of standing still.

use anyhow::{Context, Result};
use harness::sequences;
use harness::tracking::{self, drive, still};
use serde::{Deserialize, Serialize};

use super::{plain, settings};
use crate::meter::timed;
use crate::python;

/// Number of KITTI's first poses whose ground truth was interpolated, not measured.
pub(crate) const INTERPOLATED: usize = 12;
/// Presets that are compared.
const PRESETS: [&str; 3] = ["fast", "balanced", "accurate"];

/// Drift at the end of KITTI's drive.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Drive {
    /// Stereo pairs.
    pub(crate) pairs: usize,
    /// Deviation of the rotations between the first ground-truth poses from their mean, rad.
    pub(crate) first_turns_differ_rad: f64,
    /// The same for the next poses, of the same number.
    pub(crate) later_turns_differ_rad: f64,
    /// One for each preset.
    pub(crate) runs: Vec<DriveRun>,
    /// Plain visual odometry; `None` without OpenCV.
    #[serde(default)]
    pub(crate) plain: Option<PlainRun>,
}

/// Of OpenCV's parts.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct PlainRun {
    /// OpenCV's version.
    pub(crate) opencv: String,
    /// Time of a stereo pair, ms.
    pub(crate) wall_ms: f64,
    /// Drift, as [`DriveRun::causal`].
    pub(crate) off: [EndDrift; 3],
}

/// With one preset.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct DriveRun {
    /// Preset.
    pub(crate) settings: String,
    /// Time of a stereo pair, ms, and processor time.
    pub(crate) wall_ms: f64,
    pub(crate) cpu_ms: f64,
    /// Causal drift: aligned by the first pose, by the best fit, and by the first measured pose.
    pub(crate) causal: [EndDrift; 3],
    /// The same after bundle adjustment.
    pub(crate) adjusted: [EndDrift; 3],
}

/// Drift at the last pose.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct EndDrift {
    /// Path length, m.
    pub(crate) path_m: f64,
    /// Percent of path length.
    pub(crate) percent: f64,
    /// Degrees.
    pub(crate) turn_deg: f64,
}

impl From<drive::Drift> for EndDrift {
    fn from(of: drive::Drift) -> Self {
        Self {
            path_m: of.path_m,
            percent: of.percent,
            turn_deg: of.turn_deg,
        }
    }
}

/// Standing still, EuRoC.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct StandStill {
    /// Number of stereo pairs, and duration, s.
    pub(crate) pairs: usize,
    pub(crate) seconds: f64,
    /// Angle between the two gravity directions of the ground truth, degrees.
    pub(crate) truth_off_itself_deg: f64,
    /// Motion of the ground-truth poses, mm.
    pub(crate) truth_moved_mm: f64,
    /// One for each preset.
    pub(crate) runs: Vec<StandStillRun>,
}

/// With one preset.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct StandStillRun {
    /// Preset.
    pub(crate) settings: String,
    /// Bias of the gyroscope against the truth's, rad/s.
    pub(crate) gyro_bias_off: f64,
    /// Bias of the accelerometer against the truth's, m/s².
    pub(crate) accel_bias_off: f64,
    /// Error of the gravity direction against the true orientation, and against the specific force
    /// minus the true bias, degrees.
    pub(crate) up_off_orientation_deg: f64,
    pub(crate) up_off_force_deg: f64,
    /// Maximum distance of a pose from the first one, mm.
    pub(crate) moved_mm: f64,
}

/// KITTI; `None`, with a printed reason, if its images are missing.
///
/// # Errors
/// Images that cannot be read.
pub(crate) fn kitti() -> Result<Option<Drive>> {
    let [folder] = match harness::data::sets(["02_stereo_odometry_kitti/KITTI_sequence_1"]) {
        Ok(sets) => sets,
        Err(reason) => {
            eprintln!("{reason}");
            return Ok(None);
        }
    };
    let sequence = sequences::kitti(&folder)?;
    let truth = tracking::truth(&sequence)?;
    let later = scene_bundle::Trajectory::new(truth.poses()[INTERPOLATED..].to_vec())?;
    let off = |of: &scene_bundle::Trajectory| -> Result<[EndDrift; 3]> {
        Ok([
            drive::from_pose(of, &truth, 0)?.into(),
            drive::best_fit(of, &truth)?.into(),
            drive::from_pose(of, &truth, INTERPOLATED)?.into(),
        ])
    };
    let mut runs = Vec::new();
    for name in PRESETS {
        let mut tracking = tracking::Tracking::new(sequence.rig(), settings::parse(name)?, true);
        let (mut wall_s, mut cpu_s) = (0.0, 0.0);
        sequence.for_each(|set| {
            let (estimate, took) = timed(|| tracking.add(&set));
            wall_s += took.wall_s;
            cpu_s += took.cpu_s;
            estimate.map(drop)
        })?;
        let causal = tracking.causal().clone();
        let adjusted = tracking.refine()?.context("there is a mapping")?.trajectory;
        let each = |seconds: f64| 1e3 * seconds / sequence.len() as f64;
        let run = DriveRun {
            settings: name.to_owned(),
            wall_ms: each(wall_s),
            cpu_ms: each(cpu_s),
            causal: off(&causal)?,
            adjusted: off(&adjusted)?,
        };
        let [first, fit, measured] = run.causal.map(|o| o.percent);
        println!(
            "KITTI {name:9} drift {first:.3} % from pose 0, {fit:.3} % by best fit, {measured:.3} % from pose {INTERPOLATED}; {:.1} ms",
            run.wall_ms
        );
        runs.push(run);
    }
    let plain = match python::interpreter() {
        Ok(_) => {
            let found = plain::drive(&folder, &sequence, &truth)?;
            let off = off(&found.trajectory)?;
            let [first, fit, measured] = off.map(|o| o.percent);
            println!(
                "KITTI {:9} drift {first:.3} % from pose 0, {fit:.3} % by best fit, {measured:.3} % from pose {INTERPOLATED}; {:.1} ms",
                "plain", found.wall_ms
            );
            Some(PlainRun {
                opencv: found.opencv,
                wall_ms: found.wall_ms,
                off,
            })
        }
        Err(reason) => {
            eprintln!("KITTI without plain odometry beside it: {reason}");
            None
        }
    };
    Ok(Some(Drive {
        pairs: sequence.len(),
        first_turns_differ_rad: drive::unevenness(&truth, INTERPOLATED),
        later_turns_differ_rad: drive::unevenness(&later, INTERPOLATED),
        runs,
        plain,
    }))
}

/// EuRoC; `None`, with a printed reason, if it is missing.
///
/// # Errors
/// Files that cannot be read.
pub(crate) fn euroc() -> Result<Option<StandStill>> {
    let [folder, truth] = match harness::data::sets([
        "03_stereo_imu/euroc_V1_01_micro",
        "03_stereo_imu/euroc_groundtruth/V1_01_easy.csv",
    ]) {
        Ok(sets) => sets,
        Err(reason) => {
            eprintln!("{reason}");
            return Ok(None);
        }
    };
    let mut stand: Option<StandStill> = None;
    for name in PRESETS {
        let found = still::still(&folder, &truth, settings::parse(name)?)?;
        let run = StandStillRun {
            settings: name.to_owned(),
            gyro_bias_off: found.gyro_bias_off,
            accel_bias_off: found.accel_bias_off,
            up_off_orientation_deg: found.up_off_orientation_deg,
            up_off_force_deg: found.up_off_force_deg,
            moved_mm: 1e3 * found.moved_m,
        };
        println!(
            "EuRoC {name:9} gyroscope bias error {:.5} rad/s, gravity direction error {:.3} and {:.3} deg, moved {:.2} mm",
            run.gyro_bias_off, run.up_off_orientation_deg, run.up_off_force_deg, run.moved_mm
        );
        let stand = stand.get_or_insert_with(|| StandStill {
            pairs: found.sets,
            seconds: found.seconds,
            truth_off_itself_deg: found.truth_off_itself_deg,
            truth_moved_mm: 1e3 * found.truth_moved_m,
            runs: Vec::new(),
        });
        stand.runs.push(run);
    }
    Ok(stand)
}
