//! One run, in a process of its own: this program, started again.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use cad_transforms::RigidTransform;
use harness::sequences::{self, Sequence, named};
use harness::tracking::{self, Tracking};
use rig_sim::camera::Quality;
use scene_bundle::Trajectory;
use serde::{Deserialize, Serialize};

use super::figures::Figures;
use super::settings;
use super::stereo_deviation::StereoDeviation;
use crate::meter::timed;

/// First argument of the process; the job follows as JSON.
const RUN: &str = "--run";
/// Threads of a run.
const THREADS: &str = "2";

/// What to run on, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Job {
    /// Name of a walk.
    pub(crate) walk: String,
    /// Cameras in use; none for all.
    pub(crate) cameras: Vec<String>,
    /// Whether their IMUs are.
    pub(crate) with_imu: bool,
    /// Whether the images are those of a quick run, rendered at lower quality.
    pub(crate) is_trial: bool,
    /// Frame sets; none for all.
    pub(crate) sets: Option<usize>,
    /// As [`settings::parse`] has it.
    pub(crate) settings: String,
    /// Rotation error of one camera's calibration, degrees, in equal parts about x, y and z of its
    /// left frame.
    pub(crate) rotation_error_deg: f64,
    /// Error of the stereo calibration of every camera, which then states no covariance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) stereo: Option<StereoDeviation>,
}

/// The camera with this error. Its IMU is not in use.
const MISCALIBRATED_CAMERA: &str = "feet";

impl Job {
    /// A whole walk with everything that the rig has.
    pub(crate) fn whole(walk: &str, settings: &str, is_trial: bool) -> Self {
        Self {
            walk: walk.to_owned(),
            cameras: Vec::new(),
            with_imu: true,
            is_trial,
            sets: None,
            settings: settings.to_owned(),
            rotation_error_deg: 0.0,
            stereo: None,
        }
    }

    /// The walk, with its images in a folder; they are rendered if missing.
    ///
    /// # Errors
    /// There is no such walk, or the folder cannot be written.
    pub(crate) fn sequence(&self, walks: &Path) -> Result<Sequence> {
        let mut walk = named::settings(&self.walk)?;
        walk.cameras = self.cameras.clone();
        walk.with_imu = self.with_imu;
        if self.is_trial {
            walk.quality = Quality::FAST;
        }
        let sequence = sequences::walk(&walk)?;
        let sequence = match self.sets {
            Some(sets) => sequence.first(sets),
            None => sequence,
        };
        let sequence = sequence.cached(walks)?;
        let each = self.rotation_error_deg.to_radians() / 3.0_f64.sqrt();
        let off = RigidTransform::from_rotation_vector([each; 3], [0.0; 3])?;
        let mut applied = Ok(());
        let sequence = sequence.with_nominal_rig(|rig| {
            if let Some(deviation) = &self.stereo {
                applied = deviation.apply(rig);
            }
            for camera in rig
                .cameras
                .iter_mut()
                .filter(|c| c.name == MISCALIBRATED_CAMERA)
            {
                camera.rig_from_left = camera.rig_from_left * off;
            }
        });
        applied?;
        Ok(sequence)
    }
}

/// Request to the process.
#[derive(Serialize, Deserialize)]
struct RunRequest {
    job: Job,
    walks: PathBuf,
    with_mapping: bool,
}

/// Result of one process.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Answer {
    ran: TrackingRun,
    /// Checksum of all causal poses.
    poses: u32,
    adjusted: Option<AdjustedRun>,
}

/// Result and cost of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct TrackingRun {
    /// Stereo cameras; named apart from the job's, beside which it is written.
    pub(crate) stereo_cameras: usize,
    /// Stereo pairs.
    pub(crate) pairs: usize,
    /// From the first set to the last, s.
    pub(crate) seconds: f64,
    /// Path length, m.
    pub(crate) path_m: f64,
    /// Keyframes.
    pub(crate) keyframes: usize,
    /// Time of a stereo pair, mean, ms.
    pub(crate) wall_ms: f64,
    /// Processor time of a stereo pair, all threads, mean, ms.
    pub(crate) cpu_ms: f64,
    /// Maximum time of a set, ms.
    pub(crate) longest_set_ms: f64,
    /// Peak memory beyond the initial one, bytes.
    pub(crate) peak_bytes: u64,
    /// Number of cameras reported as moved during the run.
    pub(crate) shifts: usize,
    /// Errors of the causal poses.
    pub(crate) figures: Figures,
}

/// Result and cost of the bundle adjustment.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct AdjustedRun {
    /// Of the adjustment, s.
    pub(crate) wall_s: f64,
    /// Processor time of it, s.
    pub(crate) cpu_s: f64,
    /// Peak memory of tracking and adjustment beyond the initial one, bytes.
    pub(crate) peak_bytes: u64,
    /// Keyframes.
    pub(crate) keyframes: usize,
    /// Loop closures.
    pub(crate) loops: usize,
    /// Linearizations.
    pub(crate) rounds: usize,
    /// Landmarks.
    pub(crate) landmarks: usize,
    /// Deviation of refined camera poses from their nominal ones, m and rad.
    pub(crate) mounts_off: Vec<[f64; 2]>,
    /// Cameras found to have moved.
    pub(crate) moved: Vec<String>,
    /// Estimated errors of the stereo calibrations, and their sigmas.
    #[serde(default)]
    pub(crate) stereo: Vec<[[f64; 7]; 2]>,
    /// Errors of the refined poses.
    pub(crate) figures: Figures,
}

/// Number of passes of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Passes {
    /// Once, with all keyframes stored and adjusted at the end: causal memory includes them.
    One,
    /// Once without storing keyframes and once with.
    Two,
}

/// Runs a job.
///
/// # Errors
/// A process fails, or two give different causal poses.
pub(crate) fn run(
    job: &Job,
    walks: &Path,
    passes: Passes,
) -> Result<(TrackingRun, Option<AdjustedRun>)> {
    let order = |with_mapping| RunRequest {
        job: job.clone(),
        walks: walks.to_owned(),
        with_mapping,
    };
    let second = start(&order(true))?;
    if passes == Passes::One {
        return Ok((second.ran, second.adjusted));
    }
    let first = start(&order(false))?;
    ensure!(
        first.poses == second.poses,
        "running {} in {} twice: found checksums {:08x} and {:08x} of the poses, expected the same",
        job.walk,
        job.settings,
        first.poses,
        second.poses
    );
    let mut ran = first.ran;
    ran.wall_ms = ran.wall_ms.min(second.ran.wall_ms);
    ran.cpu_ms = ran.cpu_ms.min(second.ran.cpu_ms);
    ran.longest_set_ms = ran.longest_set_ms.min(second.ran.longest_set_ms);
    Ok((ran, second.adjusted))
}

fn start(order: &RunRequest) -> Result<Answer> {
    let program = std::env::current_exe().context("finding this program")?;
    let output = Command::new(program)
        .args(["odometry", RUN])
        .arg(serde_json::to_string(order)?)
        .env("RAYON_NUM_THREADS", THREADS)
        .stderr(Stdio::inherit())
        .output()
        .context("starting a run")?;
    let job = &order.job;
    ensure!(
        output.status.success(),
        "the run of {} in {} ended with {}",
        job.walk,
        job.settings,
        output.status
    );
    serde_json::from_slice(&output.stdout).context("reading what a run gave")
}

/// Serves the request of another process; `None` without one.
pub(crate) fn answer(args: &[String]) -> Option<Result<()>> {
    let [first, order] = args else { return None };
    (first == RUN).then(|| {
        let order: RunRequest = serde_json::from_str(order).context("reading what is to be run")?;
        let answer = serde_json::to_vec(&work(&order)?)?;
        std::io::stdout().write_all(&answer)?;
        Ok(())
    })
}

fn work(order: &RunRequest) -> Result<Answer> {
    let sequence = order.job.sequence(&order.walks)?;
    let settings = settings::parse(&order.job.settings)?;
    let truth = tracking::truth(&sequence)?;
    let before = forget_peak()?;
    let mut tracking = Tracking::new(sequence.rig(), settings, order.with_mapping);
    let (mut wall_s, mut cpu_s, mut longest_s, mut pairs) = (0.0, 0.0, 0.0_f64, 0);
    sequence.for_each(|set| {
        let (estimate, took) = timed(|| tracking.add(&set));
        estimate?;
        wall_s += took.wall_s;
        cpu_s += took.cpu_s;
        longest_s = longest_s.max(took.wall_s);
        pairs += set.views.iter().flatten().count();
        Ok(())
    })?;
    let peak = || -> Result<u64> { Ok(harness::soak::memory()?.peak.saturating_sub(before)) };
    let causal = tracking.causal().clone();
    let each = |seconds: f64| 1e3 * seconds / pairs.max(1) as f64;
    let steps = truth.poses().windows(2);
    let ran = TrackingRun {
        stereo_cameras: sequence.rig().cameras.len(),
        pairs,
        seconds: causal.duration_ns() as f64 * 1e-9,
        path_m: steps
            .map(|p| p[0].world_from_rig.translation() - p[1].world_from_rig.translation())
            .map(|step| step.norm())
            .sum(),
        keyframes: tracking.keyframes(),
        wall_ms: each(wall_s),
        cpu_ms: each(cpu_s),
        longest_set_ms: 1e3 * longest_s,
        peak_bytes: peak()?,
        shifts: tracking.camera_shifts().len(),
        figures: Figures::of(&causal, &truth)?,
    };
    let (adjusted, took) = timed(|| tracking.refine());
    let adjusted = match adjusted? {
        None => None,
        Some(adjusted) => Some(AdjustedRun {
            wall_s: took.wall_s,
            cpu_s: took.cpu_s,
            peak_bytes: peak()?,
            keyframes: adjusted.keyframes,
            loops: adjusted.loop_closures,
            rounds: adjusted.iterations,
            landmarks: adjusted.landmarks,
            mounts_off: adjusted
                .extrinsics
                .iter()
                .map(|m| m.initial_error)
                .collect(),
            moved: (sequence.rig().cameras.iter().zip(&adjusted.extrinsics))
                .filter(|(_, mount)| mount.is_moved)
                .map(|(camera, _)| camera.name.clone())
                .collect(),
            stereo: (adjusted.stereo.iter())
                .map(|stereo| [stereo.error, stereo.sigmas()])
                .collect(),
            figures: Figures::of(&adjusted.trajectory, &truth)?,
        }),
    };
    Ok(Answer {
        ran,
        poses: checksum(&causal),
        adjusted,
    })
}

/// Gives free memory back to the system, sets the peak of the resident memory to what is resident
/// now, and returns it, bytes: memory freed before cannot be reused without being counted.
///
/// # Errors
/// The system does not report it.
pub(crate) fn forget_peak() -> Result<u64> {
    #[cfg(target_env = "gnu")]
    {
        unsafe extern "C" {
            /// malloc_trim(3).
            safe fn malloc_trim(pad: usize) -> i32;
        }
        malloc_trim(0);
    }
    // proc_pid_clear_refs(5).
    std::fs::write("/proc/self/clear_refs", "5").context("forgetting the peak of the memory")?;
    Ok(harness::soak::memory()?.resident)
}

/// Checksum of all numbers of all poses.
pub(crate) fn checksum(trajectory: &Trajectory) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    for pose in trajectory.poses() {
        let q = pose.world_from_rig.rotation().quaternion();
        let place = pose.world_from_rig.translation_m();
        for value in [q.w, q.i, q.j, q.k].into_iter().chain(place) {
            hasher.update(&value.to_le_bytes());
        }
        hasher.update(&[pose.status.code()]);
    }
    hasher.finalize()
}
