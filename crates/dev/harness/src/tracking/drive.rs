//! Drift at the end of a drive, by three alignments.
//!
//! The alignment with ground truth determines the drift at the end: aligned at the first pose, an
//! error of the true initial rotation is multiplied by the path length; aligned by the best fit of
//! all positions, it counts the least; aligned at a later pose, the drive before it does not count.

use anyhow::{Context as _, Result, ensure};
use cad_transforms::RigidTransform;
use reconstruction::evaluate::{self, Alignment, evaluate};
use scene_bundle::Trajectory;
use serde::Serialize;

/// Error at the last pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Drift {
    /// True path length from the alignment to the last pose, or of the whole path for a best fit,
    /// m.
    pub path_m: f64,
    /// Position error at the last pose, m.
    pub off_m: f64,
    /// Position error over path length, percent.
    pub percent: f64,
    /// Rotation error at the last pose, degrees.
    pub turn_deg: f64,
}

/// Drift with alignment at pose `from`, counted from 0.
///
/// # Errors
/// The poses are not at the same times, or there are fewer.
pub fn from_pose(estimate: &Trajectory, truth: &Trajectory, from: usize) -> Result<Drift> {
    let pairs = pairs(estimate, truth)?;
    let (first, last) = (pairs.get(from), pairs.last());
    let (first, last) = (first.zip(last)).context("the drive has no such pose")?;
    drift(&pairs[from..], first.1 * first.0.inverse(), last)
}

/// Drift with the best fit of all positions, without scale.
///
/// # Errors
/// The poses are not at the same times, or too few.
pub fn best_fit(estimate: &Trajectory, truth: &Trajectory) -> Result<Drift> {
    let settings = evaluate::Settings {
        alignment: Alignment::Se3,
        ..evaluate::Settings::default()
    };
    let fit = evaluate(estimate, truth, &settings).true_from_estimated;
    let fit = fit.context("too few poses to align two drives")?;
    let pairs = pairs(estimate, truth)?;
    let last = pairs.last().context("a drive without poses")?;
    drift(&pairs, fit.rigid, last)
}

type Pair = (RigidTransform, RigidTransform);

fn pairs(estimate: &Trajectory, truth: &Trajectory) -> Result<Vec<Pair>> {
    let (found, expected) = (estimate.len(), truth.len());
    ensure!(
        found == expected,
        "comparing drives: found {found} poses, expected {expected}"
    );
    let pairs = estimate.poses().iter().zip(truth.poses());
    let pair = |(e, t): (&scene_bundle::Pose, &scene_bundle::Pose)| {
        ensure!(
            e.time_ns == t.time_ns,
            "comparing drives: found a pose at {} ns, expected it at {} ns",
            e.time_ns,
            t.time_ns
        );
        Ok((e.world_from_rig, t.world_from_rig))
    };
    pairs.map(pair).collect()
}

fn drift(pairs: &[Pair], true_from_estimated: RigidTransform, last: &Pair) -> Result<Drift> {
    let steps = pairs.windows(2).map(|p| [&p[0].1, &p[1].1]);
    let path_m = steps
        .map(|[a, b]| (b.translation() - a.translation()).norm())
        .sum();
    let off = last.1.inverse() * (true_from_estimated * last.0);
    let place = (true_from_estimated * last.0).translation() - last.1.translation();
    Ok(Drift {
        path_m,
        off_m: place.norm(),
        percent: 100.0 * place.norm() / path_m,
        turn_deg: off.angle_rad().to_degrees(),
    })
}

/// Variation of the rotations between neighboring true poses, over the first `poses`: the largest
/// difference from their mean, rad. Measured rotations vary; interpolated ones do not.
pub fn unevenness(truth: &Trajectory, poses: usize) -> f64 {
    let poses: Vec<_> = truth.poses().iter().take(poses).collect();
    let turns = poses.windows(2).map(|p| {
        let turn = p[0].world_from_rig.inverse() * p[1].world_from_rig;
        nalgebra::Vector3::from(turn.rotation_vector())
    });
    let turns: Vec<_> = turns.collect();
    let mean = turns.iter().sum::<nalgebra::Vector3<f64>>() / turns.len().max(1) as f64;
    turns.iter().map(|t| (t - mean).norm()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use scene_bundle::Pose;

    use super::*;

    /// A drive along x whose estimate is rotated by an angle at the first pose.
    fn drives(angle: f64) -> [Trajectory; 2] {
        let way = |turn: f64| {
            let start = RigidTransform::from_rotation_vector([0.0, 0.0, turn], [1.0, 2.0, 3.0]);
            let start = start.expect("finite");
            let pose = |k: i64| {
                let along = RigidTransform::from_rotation_vector([0.0; 3], [k as f64, 0.0, 0.0]);
                Pose::new(k, start * along.expect("finite"))
            };
            Trajectory::new((0..11).map(pose).collect()).expect("rising times")
        };
        [way(angle), way(0.0)]
    }

    #[test]
    fn rigidly_transformed_drive_has_no_drift() {
        let [estimate, truth] = drives(0.3);
        let drift = from_pose(&estimate, &truth, 0).expect("poses");
        assert!((drift.path_m - 10.0).abs() < 1e-9 && drift.off_m < 1e-9);
        let later = from_pose(&estimate, &truth, 4).expect("poses");
        assert!((later.path_m - 6.0).abs() < 1e-9 && later.turn_deg < 1e-6);
        assert!(from_pose(&estimate, &truth, 11).is_err());
    }

    #[test]
    fn initial_rotation_error_grows_with_path_length_unless_fitted() {
        let [_, truth] = drives(0.0);
        let bent: Vec<Pose> = (truth.poses().iter().enumerate())
            .map(|(k, pose)| {
                let turn = RigidTransform::from_rotation_vector(
                    [0.0, 0.0, if k > 0 { 0.01 } else { 0.0 }],
                    [0.0; 3],
                );
                let about = truth.poses()[0].world_from_rig;
                let turned = about * turn.expect("finite") * about.inverse();
                Pose::new(pose.time_ns, turned * pose.world_from_rig)
            })
            .collect();
        let bent = Trajectory::new(bent).expect("rising times");
        let first = from_pose(&bent, &truth, 0).expect("poses");
        // Two sin(angle / 2) of ten metres.
        assert!((first.percent - 1.0).abs() < 1e-4, "{first:?}");
        assert!((first.turn_deg - 0.01_f64.to_degrees()).abs() < 1e-9);
        let fit = best_fit(&bent, &truth).expect("poses");
        assert!(fit.percent < 0.05, "{fit:?}");
    }

    #[test]
    fn uniform_rotations_have_no_unevenness() {
        let [_, truth] = drives(0.0);
        assert!(unevenness(&truth, 11) < 1e-12);
    }
}
