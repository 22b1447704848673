//! Poses of frame sets between refined keyframes.
//!
//! A causal pose jumps wherever the window corrects its keyframes, by centimeters after a corner:
//! the motion from a frame set to a keyframe is not the difference of their causal poses. Poses in
//! the odom frame do not jump, so that they give the motion between keyframes.

use cad_transforms::{RigidTransform, so3};
use nalgebra::{Matrix6, Vector6};

use super::RefinedPose;
use crate::backend::covariance::adjoint;
use crate::estimator::Estimate;

/// Pose of a frame set in the odom frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdomPose {
    /// Time, ns.
    pub time_ns: i64,
    /// See [`Estimate::odom_from_rig`].
    pub odom_from_rig: RigidTransform,
    /// See [`Estimate::relative_covariance`].
    pub relative_covariance: Matrix6<f64>,
}

impl From<&Estimate> for OdomPose {
    fn from(estimate: &Estimate) -> Self {
        Self {
            time_ns: estimate.time_ns,
            odom_from_rig: estimate.odom_from_rig,
            relative_covariance: estimate.relative_covariance,
        }
    }
}

/// Pose of a frame set by refined keyframes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InterpolatedPose {
    /// Pose in the world of the first keyframe.
    pub world_from_rig: RigidTransform,
    /// Covariance of a small motion of the rig in its own axes: translation m, rotation rad.
    pub covariance: Matrix6<f64>,
}

/// Poses of all frame sets by those of refined keyframes: each is interpolated between the poses
/// that the two neighboring keyframes and the motion in the odom frame give. Its covariance is that
/// of the mixture of the two, which includes their difference, and that of the motion. `odom` are
/// all frame sets, `refined` keyframes, both ascending. Before the first and after the last
/// keyframe a pose is fixed relative to the nearest one. Keyframes without a frame set are ignored;
/// without keyframes poses are those in the odom frame.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use nalgebra::Matrix6;
/// use odometry::mapping::{OdomPose, RefinedPose, interpolate_poses};
///
/// let at = |x| RigidTransform::from_translation_m([x, 0.0, 0.0]);
/// let odom = |time_ns, x| at(x).map(|odom_from_rig| OdomPose {
///     time_ns,
///     odom_from_rig,
///     relative_covariance: Matrix6::zeros(),
/// });
/// let keyframe = |number, time_ns, x| at(x).map(|world_from_rig| RefinedPose {
///     number,
///     time_ns,
///     world_from_rig,
///     covariance: Matrix6::zeros(),
/// });
/// let odom = [odom(0, 0.0)?, odom(50, 0.5)?, odom(100, 1.0)?, odom(150, 1.5)?];
/// // Bundle adjustment moved the second keyframe by 10 cm.
/// let refined = [keyframe(1, 0, 0.0)?, keyframe(3, 100, 1.1)?];
/// let poses = interpolate_poses(&odom, &refined);
/// for (pose, expected) in poses.iter().zip([0.0, 0.55, 1.1, 1.6]) {
///     let x = pose.world_from_rig.translation_m()[0];
///     assert!((x - expected).abs() < 1e-12, "{x}");
/// }
/// // The pose between them is certain to 5 cm only.
/// assert!((poses[1].covariance[(0, 0)].sqrt() - 0.05).abs() < 1e-12);
/// assert_eq!(poses[2].covariance, Matrix6::zeros());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn interpolate_poses(odom: &[OdomPose], refined: &[RefinedPose]) -> Vec<InterpolatedPose> {
    let index = |time: i64| odom.binary_search_by_key(&time, |pose| pose.time_ns).ok();
    let keys: Vec<(usize, &RefinedPose)> = (refined.iter())
        .filter_map(|pose| Some((index(pose.time_ns)?, pose)))
        .collect();
    let mut out = Vec::with_capacity(odom.len());
    let mut next = 0;
    for (k, pose) in odom.iter().enumerate() {
        while next < keys.len() && keys[next].0 <= k {
            next += 1;
        }
        let by = |(at, refined): &(usize, &RefinedPose)| {
            let motion = odom[*at].odom_from_rig.inverse() * pose.odom_from_rig;
            let jacobian = adjoint(&motion.inverse());
            let mut covariance = jacobian * refined.covariance * jacobian.transpose();
            if *at != k {
                covariance += pose.relative_covariance;
            }
            InterpolatedPose {
                world_from_rig: refined.world_from_rig * motion,
                covariance,
            }
        };
        let before = next.checked_sub(1).map(|b| &keys[b]);
        out.push(match (before, keys.get(next)) {
            (None, None) => InterpolatedPose {
                world_from_rig: pose.odom_from_rig,
                covariance: pose.relative_covariance,
            },
            (Some(one), None) | (None, Some(one)) => by(one),
            (Some(a), Some(b)) => {
                let (from, to) = (odom[a.0].time_ns, odom[b.0].time_ns);
                let ratio = (pose.time_ns - from) as f64 / (to - from) as f64;
                interpolate(&by(a), &by(b), ratio)
            }
        });
    }
    out
}

/// Mean and covariance of the mixture of two poses, the second with this weight.
fn interpolate(a: &InterpolatedPose, b: &InterpolatedPose, weight: f64) -> InterpolatedPose {
    let difference = a.world_from_rig.inverse() * b.world_from_rig;
    let rotation = so3::log(difference.rotation());
    let translation = difference.translation();
    let part = RigidTransform::from_rotation_vector(
        (rotation * weight).into(),
        (translation * weight).into(),
    );
    let apart = Vector6::from_iterator(translation.iter().chain(&rotation).copied());
    InterpolatedPose {
        world_from_rig: part.map_or(a.world_from_rig, |part| a.world_from_rig * part),
        covariance: a.covariance * (1.0 - weight)
            + b.covariance * weight
            + apart * apart.transpose() * (weight * (1.0 - weight)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64) -> RigidTransform {
        RigidTransform::from_translation_m([x, 0.0, 0.0]).unwrap()
    }

    fn odom(time_ns: i64, x: f64) -> OdomPose {
        OdomPose {
            time_ns,
            odom_from_rig: pose(x),
            relative_covariance: Matrix6::identity() * 1e-6,
        }
    }

    fn keyframe(time_ns: i64, x: f64, sigma: f64) -> RefinedPose {
        RefinedPose {
            number: time_ns as u64,
            time_ns,
            world_from_rig: pose(x),
            covariance: Matrix6::identity() * (sigma * sigma),
        }
    }

    #[test]
    fn frames_between_keyframes_are_interpolated() {
        let odom: Vec<_> = (0..7).map(|k| odom(k * 10, k as f64)).collect();
        // The second keyframe had an error of 1 m.
        let refined = [(10, 1.0), (50, 6.0), (55, 0.0)].map(|(t, x)| keyframe(t, x, 0.0));
        let all = interpolate_poses(&odom, &refined);
        let x: Vec<f64> = (all.iter())
            .map(|p| p.world_from_rig.translation_m()[0])
            .collect();
        for (found, expected) in x.iter().zip([0.0, 1.0, 2.25, 3.5, 4.75, 6.0, 7.0]) {
            assert!((found - expected).abs() < 1e-9, "{x:?}");
        }
        for (found, odom) in interpolate_poses(&odom, &[]).iter().zip(&odom) {
            assert_eq!(found.world_from_rig, odom.odom_from_rig);
        }
    }

    #[test]
    fn covariance_between_keyframes_contains_theirs_and_their_difference() {
        let odom: Vec<_> = (0..6).map(|k| odom(k * 10, k as f64)).collect();
        let refined = [keyframe(10, 1.0, 0.01), keyframe(50, 5.2, 0.02)];
        let all = interpolate_poses(&odom, &refined);
        let variance = |k: usize| all[k].covariance[(0, 0)];
        assert!((variance(1) - 1e-4).abs() < 1e-12);
        assert!((variance(5) - 4e-4).abs() < 1e-12);
        assert!((variance(3) - (2.5e-4 + 1e-6 + 0.25 * 0.2 * 0.2)).abs() < 1e-12);
        // Outside, the rotation of the keyframe moves the frame sideways.
        let y = all[0].covariance[(1, 1)];
        assert!((y - (1e-4 + 1e-4 + 1e-6)).abs() < 1e-12, "{y}");
    }
}
