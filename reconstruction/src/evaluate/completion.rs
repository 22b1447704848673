//! Completion: part of the ground truth's time that has a pose.
//!
//! Contract: from one pose of the estimate to the next the time counts as covered if neither is
//! lost and they are not too far apart. Uncovered time between the ground truth's first and last
//! pose is a list of gaps, including the time before the first and after the last estimated pose.

use scene_bundle::{Pose, Status, Trajectory};
use serde::Serialize;

/// Completion: part of the ground truth's time that has a pose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Completion {
    /// Ratio of covered to total time; 0 if the ground truth has no duration.
    pub share: f64,
    /// From the ground truth's first pose to its last, s.
    pub truth_s: f64,
    /// Uncovered times, in order.
    pub gaps: Vec<Gap>,
}

/// A time without a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Gap {
    /// Begin, ns.
    pub from_ns: i64,
    /// End, ns.
    pub to_ns: i64,
}

impl Gap {
    /// Its length, s.
    pub fn seconds(&self) -> f64 {
        (self.to_ns - self.from_ns) as f64 * 1e-9
    }
}

impl Completion {
    /// The longest time without a pose, s.
    pub fn longest_gap_s(&self) -> f64 {
        self.gaps.iter().map(Gap::seconds).fold(0.0, f64::max)
    }
}

/// Part of the ground truth's time that the estimate covers.
pub(crate) fn completion(
    estimate: &Trajectory,
    truth: &Trajectory,
    max_step_ns: i64,
) -> Completion {
    let (Some(first), Some(last)) = (truth.poses().first(), truth.poses().last()) else {
        return Completion {
            share: 0.0,
            truth_s: 0.0,
            gaps: Vec::new(),
        };
    };
    let (begin, end) = (first.time_ns, last.time_ns);
    let is_covered = |pair: &&[Pose]| {
        let step = pair[1].time_ns - pair[0].time_ns;
        step <= max_step_ns && pair.iter().all(|p| p.status != Status::Lost)
    };
    let mut gaps = Vec::new();
    let mut reached = begin;
    for pair in estimate.poses().windows(2).filter(is_covered) {
        let [from, to] = [&pair[0], &pair[1]].map(|p| p.time_ns.clamp(begin, end));
        if from > reached {
            gaps.push(Gap {
                from_ns: reached,
                to_ns: from,
            });
        }
        reached = reached.max(to);
    }
    if reached < end {
        gaps.push(Gap {
            from_ns: reached,
            to_ns: end,
        });
    }
    let truth_s = (end - begin) as f64 * 1e-9;
    let missing: f64 = gaps.iter().map(Gap::seconds).sum();
    Completion {
        share: match truth_s > 0.0 {
            true => 1.0 - missing / truth_s,
            false => 0.0,
        },
        truth_s,
        gaps,
    }
}
