//! How far an estimated trajectory is from the truth.
//!
//! Contract: poses are matched to the nearest true pose in time, without interpolation, as evo does
//! (github.com/MichaelGrupp/evo), and the numbers are evo's to 1e-6 m ([`Evaluation::absolute`], [`Evaluation::relative`]).
//! *Lost* poses match nothing. How much of the truth's time was covered stands beside every error
//! ([`Evaluation::completion`]): an error alone says nothing of a run that gave up early. *Too little* to compare is no
//! error but a run without an absolute error, which counts as lost. Several runs go into [`runs::Runs`], where lost runs
//! are never averaged away.
//!
//! - [`align`]: laying the estimate onto the truth.
//! - [`associate`]: which poses belong together.
//! - [`relative`]: drift over distances and times.
//! - [`completion`]: how much of the truth's time has a pose.
//! - [`consistency`]: whether stated covariances are true.
//! - [`depth`]: depth of keyframes against that of a simulated walk.
//! - [`files`]: trajectories by the content of their files.
//! - [`runs`]: tables of several runs.

use cad_transforms::RigidTransform;
use scene_bundle::Trajectory;
use serde::Serialize;

pub mod align;
pub mod associate;
pub mod completion;
pub mod consistency;
pub mod depth;
pub mod files;
pub mod relative;
pub mod runs;
pub mod statistics;

pub use align::{Alignment, Similarity};
pub use completion::Completion;
pub use consistency::Consistency;
pub use relative::{Delta, Relative};
pub use statistics::Statistics;

/// How to compare.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// How the estimate is laid onto the truth.
    pub alignment: Alignment,
    /// How far apart in time an estimated and a true pose may be that are compared, ns.
    pub tolerance_ns: i64,
    /// The longest time from one pose to the next that still counts as covered, ns.
    pub max_step_ns: i64,
    /// Over what distances or times drift is measured.
    pub deltas: Vec<Delta>,
    /// Whether drift is measured from every pose on, and not only from where the stretch before ended.
    pub overlapping: bool,
}

impl Default for Settings {
    /// As evo has it: 10 ms, best fit without scale; steps up to a quarter of a second; drift from every pose on over
    /// 10 m and 5 s.
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

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// How many poses were estimated, by status.
    pub poses: Counts,
    /// How many were compared.
    pub matched: usize,
    /// Length of the true way from matched pose to matched pose, m.
    pub path_m: f64,
    /// Takes the estimate's world to the truth's; none where too little was matched.
    pub true_from_estimated: Option<Similarity>,
    /// Errors of the aligned poses; none where nothing could be aligned.
    pub absolute: Option<Absolute>,
    /// Drift, one entry for each delta asked for.
    pub relative: Vec<Relative>,
    /// How much of the truth's time has a pose.
    pub completion: Completion,
    /// Whether stated covariances are true; none where no pose has one.
    pub consistency: Option<Consistency>,
}

/// Numbers of estimated poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Followed by cameras.
    pub tracked: usize,
    /// Carried on by IMUs.
    pub dead_reckoned: usize,
    /// Found again.
    pub relocalised: usize,
    /// None.
    pub lost: usize,
}

/// Errors of poses against true ones (ATE, also called APE; Sturm et al. 2012).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Absolute {
    /// Distances, m.
    pub translation_m: Statistics,
    /// Angles, rad; none where poses on a line, or at one place, leave the alignment's turn open.
    pub rotation_rad: Option<Statistics>,
}

/// A matched pair: time of the estimated pose, the pose, the true pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pair {
    pub(crate) time_ns: i64,
    pub(crate) estimated: RigidTransform,
    pub(crate) truth: RigidTransform,
}

/// Compares an estimate with the truth. All of its poses that are not lost are compared; the truth's are taken as
/// they are, whatever their status.
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

/// The poses of the truth from the first to the last row of a trajectory that has one for every frame set, also where the rig was
/// lost. A simulated walk goes on after the recording has stopped.
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
