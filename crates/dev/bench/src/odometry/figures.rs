//! Key figures of one trajectory's errors.

use anyhow::Result;
use reconstruction::evaluate::{Delta, Settings, evaluate};
use scene_bundle::{Status, Trajectory};
use serde::{Deserialize, Serialize};

/// Path length over which drift is measured, m.
const DRIFT_M: f64 = 10.0;

/// See the module. Errors are those of the best fit without scale.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Figures {
    /// RMS of distances (ATE), m; `None` with too few pairs.
    pub(crate) ate_m: Option<f64>,
    /// The same relative to path length, percent.
    pub(crate) ate_percent: Option<f64>,
    /// RMS of rotations, degrees.
    pub(crate) turn_deg: Option<f64>,
    /// The largest distance, m, and when, s.
    pub(crate) worst: Option<[f64; 2]>,
    /// Mean drift over 10 m of path, percent.
    pub(crate) drift_percent: Option<f64>,
    /// Ratio of the time that has a pose.
    pub(crate) completion: f64,
    /// Longest gap, s.
    pub(crate) longest_gap_s: f64,
    /// Numbers of tracked, dead reckoned and lost poses.
    pub(crate) poses: [usize; 3],
    /// RMS of errors in stated sigmas, of position and of rotation; 1 is right.
    pub(crate) sigmas: Option<[f64; 2]>,
    /// Median stated sigma over the RMS error, of position and of rotation; 1 is sharp.
    #[serde(default)]
    pub(crate) sharpness: Option<[f64; 2]>,
    /// Ratio of poses within 3 sigmas, of position and of rotation; 0.9973 is right.
    pub(crate) within: Option<[f64; 2]>,
    /// Tracked poses beyond 3 stated sigmas in position or rotation.
    pub(crate) silently_wrong: usize,
    /// Dead reckoned ones.
    pub(crate) silently_wrong_dead_reckoned: usize,
    /// When the first of either was, s.
    pub(crate) first_wrong_s: Option<f64>,
}

impl Figures {
    /// Of a trajectory against the truth at the same times.
    ///
    /// # Errors
    /// Never, if poses are comparable.
    pub(crate) fn of(estimate: &Trajectory, truth: &Trajectory) -> Result<Self> {
        let settings = Settings {
            deltas: vec![Delta::Meters(DRIFT_M)],
            ..Settings::default()
        };
        let evaluation = evaluate(estimate, truth, &settings);
        let begin = truth.poses().first().map_or(0, |p| p.time_ns);
        let seconds = |time_ns: i64| (time_ns - begin) as f64 * 1e-9;
        let mut errors = Vec::new();
        if let Some(fit) = evaluation.true_from_estimated {
            for pose in estimate.usable() {
                if let Some(at) = truth.at(pose.time_ns) {
                    let own = fit.apply(&pose.world_from_rig);
                    let off = own.translation() - at.world_from_rig.translation();
                    errors.push([seconds(pose.time_ns), off.norm()]);
                }
            }
        }
        let worst = errors.iter().max_by(|a, b| a[1].total_cmp(&b[1]));
        let count = |status: Status| {
            let poses = estimate.poses().iter();
            poses.filter(|p| p.status == status).count()
        };
        let absolute = evaluation.absolute.as_ref();
        let ate_m = absolute.map(|a| a.translation_m.rmse);
        let drift = evaluation.relative.first().and_then(|r| r.share);
        let consistency = evaluation.consistency.as_ref();
        let reckoned = consistency.map_or(0, |c| c.silently_wrong_dead_reckoned);
        Ok(Self {
            ate_m,
            ate_percent: ate_m.map(|ate| 100.0 * ate / evaluation.path_m.max(1e-9)),
            turn_deg: absolute
                .and_then(|a| a.rotation_rad)
                .map(|r| r.rmse.to_degrees()),
            worst: worst.map(|[s, m]| [*m, *s]),
            drift_percent: drift.map(|d| 100.0 * d.mean),
            completion: evaluation.completion.share,
            longest_gap_s: evaluation.completion.longest_gap_s(),
            poses: [
                count(Status::Tracked) + count(Status::Relocalised),
                count(Status::DeadReckoned),
                count(Status::Lost),
            ],
            sigmas: consistency
                .map(|c| [c.nees_translation, c.nees_rotation].map(|n| (n / 3.0).sqrt())),
            sharpness: consistency.map(|c| [c.sharpness_translation, c.sharpness_rotation]),
            within: consistency.map(|c| [c.within_translation, c.within_rotation]),
            silently_wrong: consistency.map_or(0, |c| c.silently_wrong) - reckoned,
            silently_wrong_dead_reckoned: reckoned,
            first_wrong_s: consistency.and_then(|c| c.first_wrong_ns).map(seconds),
        })
    }

    /// Whether too little of the time has a pose for errors to be meaningful.
    pub(crate) fn is_lost(&self) -> bool {
        self.ate_m.is_none() || self.completion < MIN_COMPLETION
    }
}

/// Minimum completion; below it a run counts as lost.
pub(crate) const MIN_COMPLETION: f64 = 0.99;
