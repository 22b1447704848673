//! Evaluation of an estimated trajectory against ground truth.
//!
//! Contract: poses are associated with the nearest ground-truth pose in time, without
//! interpolation, as evo does (github.com/MichaelGrupp/evo), and the numbers are evo's to 1e-6 m
//! ([`Evaluation::absolute`], [`Evaluation::relative`]). *Lost* poses are not associated. The
//! covered part of the ground truth's time accompanies every error ([`Evaluation::completion`]),
//! since an error alone does not show that a run ended early. *Too few* pairs are not an error of
//! the function but a run without an absolute error, which counts as lost. Several runs go into
//! [`runs::Runs`], where lost runs are never averaged away.
//!
//! - [`align`]: alignment of the estimate with the ground truth.
//! - [`associate`]: association of poses by time.
//! - [`relative`]: relative pose error (RPE) over distances and times.
//! - [`completion`]: part of the ground truth's time that has a pose.
//! - [`consistency`]: whether stated covariances cover the errors (NEES).
//! - [`depth`]: depth of keyframes against the ground truth of a simulated walk.
//! - [`feet`]: contacts and poses of feet, and the ground below them, against [`ground_truth`].
//! - [`files`]: trajectory files of any supported format.
//! - [`runs`]: tables of several runs.

use scene_bundle::Trajectory;
use serde::Serialize;

pub mod align;
pub mod associate;
pub mod completion;
pub mod consistency;
pub mod depth;
pub mod feet;
pub mod files;
pub mod ground_truth;
pub mod relative;
pub mod runs;
pub mod statistics;

pub use align::{Alignment, Similarity};
pub use completion::Completion;
pub use consistency::Consistency;
pub use relative::{Delta, Relative};
pub use statistics::Statistics;

use associate::Pair;

/// Settings of an evaluation.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Alignment of the estimate with the ground truth.
    pub alignment: Alignment,
    /// Maximum time difference of an estimated and a ground-truth pose, ns.
    pub tolerance_ns: i64,
    /// Maximum time from one pose to the next that counts as covered, ns.
    pub max_step_ns: i64,
    /// Lengths of the segments over which drift is measured.
    pub deltas: Vec<Delta>,
    /// Whether segments start at every pose, not only at the end of the previous one.
    pub overlapping: bool,
}

impl Default for Settings {
    /// As in evo: 10 ms, best fit without scale. Not as in evo: drift from every pose over 10 m and
    /// 5 s ([`relative`](mod@relative)). Steps up to a quarter of a second.
    fn default() -> Self {
        Self {
            alignment: Alignment::Se3,
            tolerance_ns: 10_000_000,
            max_step_ns: 250_000_000,
            deltas: vec![Delta::Meters(10.0), Delta::Seconds(5.0)],
            overlapping: true,
        }
    }
}

/// Result of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Number of estimated poses by status.
    pub poses: Counts,
    /// Number of compared poses.
    pub matched: usize,
    /// Path length of the ground truth from pair to pair, m.
    pub path_m: f64,
    /// Takes the estimate's world to that of the ground truth; `None` with too few pairs.
    pub true_from_estimated: Option<Similarity>,
    /// Errors of the aligned poses (ATE); `None` if alignment failed.
    pub absolute: Option<Absolute>,
    /// Drift (RPE), one entry for each requested delta.
    pub relative: Vec<Relative>,
    /// Part of the ground truth's time that has a pose.
    pub completion: Completion,
    /// Consistency of stated covariances; `None` if no pose has one.
    pub consistency: Option<Consistency>,
}

/// Numbers of estimated poses by status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Tracked by cameras.
    pub tracked: usize,
    /// Propagated by the IMU.
    pub dead_reckoned: usize,
    /// Tracked again after a loss.
    pub relocalised: usize,
    /// None.
    pub lost: usize,
}

/// Absolute errors of poses (ATE, also called APE; Sturm et al. 2012).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Absolute {
    /// Distances, m.
    pub translation_m: Statistics,
    /// Angles, rad; `None` where poses on a line, or at one position, do not determine the
    /// alignment's rotation.
    pub rotation_rad: Option<Statistics>,
}

/// Compares an estimate with the ground truth. All its poses that are not lost are compared;
/// ground-truth poses are used whatever their status.
pub fn evaluate(estimate: &Trajectory, truth: &Trajectory, settings: &Settings) -> Evaluation {
    let pairs = associate::pairs(estimate, truth, settings.tolerance_ns);
    let true_from_estimated = align::align(&pairs, settings.alignment);
    let aligned = true_from_estimated.map(|similarity| {
        let aligned = pairs.iter().map(|pair| Pair {
            estimated: similarity.apply(&pair.estimated),
            ..*pair
        });
        aligned.collect::<Vec<_>>()
    });
    let absolute = aligned.as_deref().and_then(|aligned| {
        let errors = || aligned.iter().map(|p| p.truth.inverse() * p.estimated);
        let rotation_is_known = true_from_estimated.is_some_and(|s| s.rotation_is_known);
        let rotation = || Statistics::of(errors().map(|e| e.angle_rad()).collect());
        Some(Absolute {
            translation_m: Statistics::of(errors().map(|e| e.distance_m()).collect())?,
            rotation_rad: rotation_is_known.then(rotation).flatten(),
        })
    });
    let deltas = settings.deltas.iter();
    let relative = |delta: &Delta| {
        let aligned = aligned.as_deref().unwrap_or_default();
        relative::relative(aligned, *delta, settings.overlapping)
    };
    Evaluation {
        poses: Counts::of(estimate),
        matched: pairs.len(),
        path_m: relative::path_m(&pairs).last().copied().unwrap_or(0.0),
        true_from_estimated,
        absolute,
        relative: deltas.map(relative).collect(),
        completion: completion::completion(estimate, truth, settings.max_step_ns),
        consistency: consistency::consistency(estimate, truth, settings.tolerance_ns),
    }
}

/// Ground-truth poses from the first to the last row of a trajectory that has a row for every frame
/// set, lost ones included. A simulated walk continues after the recording has stopped.
pub fn clip_to_recording(truth: &Trajectory, trajectory: &Trajectory) -> Trajectory {
    let (Some(first), Some(last)) = (trajectory.poses().first(), trajectory.poses().last()) else {
        return truth.clone();
    };
    let tolerance_ns = Settings::default().tolerance_ns;
    let times = first.time_ns - tolerance_ns..=last.time_ns + tolerance_ns;
    let poses = truth.poses().iter().filter(|p| times.contains(&p.time_ns));
    Trajectory::new(poses.cloned().collect()).unwrap_or_default()
}

impl Counts {
    fn of(trajectory: &Trajectory) -> Self {
        use scene_bundle::Status;
        let mut counts = Self::default();
        for pose in trajectory.poses() {
            *match pose.status {
                Status::Tracked => &mut counts.tracked,
                Status::DeadReckoned => &mut counts.dead_reckoned,
                Status::Relocalised => &mut counts.relocalised,
                Status::Lost => &mut counts.lost,
            } += 1;
        }
        counts
    }
}

#[cfg(test)]
mod tests;
