//! Association of estimated and ground-truth poses by time.
//!
//! Contract, as in evo: each pose of the shorter trajectory is paired with the nearest in time of
//! the longer one (the earlier of two equally near), if it is within the tolerance. A pose of the
//! longer one may be in two pairs.

use cad_transforms::RigidTransform;
use scene_bundle::{Pose, Trajectory};

/// A pair: time of the estimated pose, the pose, the ground-truth pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pair {
    pub(crate) time_ns: i64,
    pub(crate) estimated: RigidTransform,
    pub(crate) truth: RigidTransform,
}

/// Pairs in the order of time. Lost poses of the estimate are removed first.
pub(crate) fn pairs(estimate: &Trajectory, truth: &Trajectory, tolerance_ns: i64) -> Vec<Pair> {
    let estimated: Vec<&Pose> = estimate.usable().collect();
    let truth: Vec<&Pose> = truth.poses().iter().collect();
    let pair = |estimated: &Pose, truth: &Pose| Pair {
        time_ns: estimated.time_ns,
        estimated: estimated.world_from_rig,
        truth: truth.world_from_rig,
    };
    let near = |of: &[&Pose], time_ns: i64| {
        let near = nearest(of, time_ns)?;
        (of[near].time_ns.abs_diff(time_ns) <= tolerance_ns.unsigned_abs()).then_some(near)
    };
    if estimated.len() > truth.len() {
        let found = |t: &&Pose| Some(pair(estimated[near(&estimated, t.time_ns)?], t));
        truth.iter().filter_map(found).collect()
    } else {
        let found = |e: &&Pose| Some(pair(e, truth[near(&truth, e.time_ns)?]));
        estimated.iter().filter_map(found).collect()
    }
}

/// Index of the pose nearest in time, the earlier of two; `None` without poses.
fn nearest(poses: &[&Pose], time_ns: i64) -> Option<usize> {
    let after = poses.partition_point(|p| p.time_ns <= time_ns);
    let distance = |k: usize| poses[k].time_ns.abs_diff(time_ns);
    match (after.checked_sub(1), after < poses.len()) {
        (None, false) => None,
        (None, true) => Some(after),
        (Some(before), false) => Some(before),
        (Some(before), true) if distance(before) <= distance(after) => Some(before),
        (Some(_), true) => Some(after),
    }
}
