//! Pairs of positions of two trajectories at the same instants.

use nalgebra::{UnitQuaternion, Vector3};
use scene_bundle::{Pose, Trajectory};

/// A position of the estimate and the reference at its time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    pub(super) estimate: Vector3<f64>,
    pub(super) reference: Vector3<f64>,
    /// Velocity of the reference, m/s.
    pub(super) velocity: Vector3<f64>,
}

/// Pairs, and the rotations of their poses where they are known.
#[derive(Clone, Debug, Default)]
pub(super) struct Pairs {
    pub(super) all: Vec<Pair>,
    pub(super) rotations: Vec<[UnitQuaternion<f64>; 2]>,
}

impl Pairs {
    pub(super) fn of_points(estimate: &[[f64; 3]], reference: &[[f64; 3]]) -> Self {
        let both = estimate.iter().zip(reference);
        let pair = |(estimate, reference): (&[f64; 3], &[f64; 3])| Pair {
            estimate: (*estimate).into(),
            reference: (*reference).into(),
            velocity: Vector3::zeros(),
        };
        Self {
            all: both.map(pair).collect(),
            rotations: Vec::new(),
        }
    }

    /// The estimate mirrored.
    pub(super) fn mirrored(&self) -> Self {
        let mirror = |pair: &Pair| Pair {
            estimate: -pair.estimate,
            ..*pair
        };
        Self {
            all: self.all.iter().map(mirror).collect(),
            rotations: Vec::new(),
        }
    }
}

/// Interpolates the reference at the times of the estimate plus an offset, where it has poses
/// around that are at most a gap apart.
pub(super) fn associate(
    estimate: &Trajectory,
    reference: &Trajectory,
    offset_s: f64,
    max_gap_s: f64,
) -> Pairs {
    let reference: Vec<&Pose> = reference.usable().collect();
    let offset_ns = (offset_s * 1e9).floor();
    // What is below a nanosecond counts as well: steps of the clock have to go to zero.
    let rest_s = offset_s - offset_ns * 1e-9;
    let mut pairs = Pairs::default();
    for pose in estimate.usable() {
        let time_ns = pose.time_ns.saturating_add(offset_ns as i64);
        let after = reference.partition_point(|of| of.time_ns <= time_ns);
        if after == 0 || after == reference.len() {
            continue;
        }
        let [a, b] = [reference[after - 1], reference[after]];
        let gap_s = b.time_ns.saturating_sub(a.time_ns) as f64 * 1e-9;
        if gap_s > max_gap_s {
            continue;
        }
        let share = ((time_ns - a.time_ns) as f64 * 1e-9 + rest_s) / gap_s;
        let [from, to] = [a, b].map(|of| of.world_from_rig);
        let along = to.translation() - from.translation();
        pairs.all.push(Pair {
            estimate: *pose.world_from_rig.translation(),
            reference: from.translation() + along * share,
            velocity: along / gap_s,
        });
        let nearer = if share < 0.5 { from } else { to };
        pairs
            .rotations
            .push([*pose.world_from_rig.rotation(), *nearer.rotation()]);
    }
    pairs
}
