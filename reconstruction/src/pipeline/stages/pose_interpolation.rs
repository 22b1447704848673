//! Pose of the rig at any time: interpolated between the two nearest poses of the trajectory, with
//! constant velocity and angular rate.

use cad_transforms::RigidTransform;
use scene_bundle::{Pose, Status, Trajectory};

/// Maximum extrapolation beyond the first and the last pose, as a ratio of the step between the two
/// nearest: cameras of a set are not exposed at the same instant.
const MAX_EXTRAPOLATION_STEPS: f64 = 1.0;
/// Maximum time between poses that are interpolated, ns.
const MAX_STEP_NS: i64 = 250_000_000;

/// Pose of the rig at a time, if it was tracked then.
pub(super) fn pose_at(trajectory: &Trajectory, time_ns: i64) -> Option<RigidTransform> {
    let poses = trajectory.poses();
    let is_good = |p: &Pose| matches!(p.status, Status::Tracked | Status::Relocalised);
    let behind = poses.partition_point(|p| p.time_ns < time_ns);
    if let Some(pose) = poses.get(behind).filter(|p| p.time_ns == time_ns) {
        return is_good(pose).then_some(pose.world_from_rig);
    }
    let behind = behind.clamp(1, poses.len().max(2) - 1);
    let (a, b) = (poses.get(behind - 1)?, poses.get(behind)?);
    let step = b.time_ns - a.time_ns;
    let share = (time_ns - a.time_ns) as f64 / step as f64;
    let is_near = step <= MAX_STEP_NS
        && (-MAX_EXTRAPOLATION_STEPS..=1.0 + MAX_EXTRAPOLATION_STEPS).contains(&share);
    if !(is_near && is_good(a) && is_good(b)) {
        return None;
    }
    let motion = a.world_from_rig.inverse() * b.world_from_rig;
    let turn = motion.rotation_vector().map(|w| w * share);
    let shift = motion.translation_m().map(|v| v * share);
    let part = RigidTransform::from_rotation_vector(turn, shift).ok()?;
    Some(a.world_from_rig * part)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A walk along x, 1 m/s, 10 Hz, rotating by 0.1 rad/s.
    fn walk(status: impl Fn(i64) -> Status) -> Trajectory {
        let pose = |k: i64| {
            let s = k as f64 / 10.0;
            let at = RigidTransform::from_rotation_vector([0.0, 0.0, 0.1 * s], [s, 0.0, 0.0]);
            Pose {
                status: status(k),
                ..Pose::new(k * 100_000_000, at.expect("finite"))
            }
        };
        Trajectory::new((0..100).map(pose).collect()).expect("rising")
    }

    #[test]
    fn poses_are_interpolated_to_the_requested_time() {
        let walk = walk(|k| match k {
            50..60 => Status::DeadReckoned,
            _ => Status::Tracked,
        });
        for (ms, expected) in [
            (0, Some(0.0)),
            (1_230, Some(1.23)),
            (-40, Some(-0.04)),
            (9_950, Some(9.95)),
            (10_200, None),
            (5_500, None),
            (4_950, None),
            (4_900, Some(4.9)),
        ] {
            let found = pose_at(&walk, ms * 1_000_000);
            match (found, expected) {
                (Some(found), Some(expected)) => {
                    assert!((found.translation_m()[0] - expected).abs() < 1e-3, "{ms}");
                    assert!((found.rotation_vector()[2] - 0.1 * expected).abs() < 1e-9);
                }
                (found, expected) => assert_eq!(found.is_some(), expected.is_some(), "{ms}"),
            }
        }
        assert_eq!(pose_at(&Trajectory::default(), 0), None);
    }
}
