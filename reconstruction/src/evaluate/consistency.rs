//! Consistency: whether stated covariances cover the errors.
//!
//! Contract: the estimate is aligned with the ground truth by position and heading of its first
//! usable pose, the origin of its uncertainty; tilt is not aligned. Ground-truth poses are
//! interpolated, since a walker moves a centimetre within the tolerance of association. The error
//! of a pose takes it to the true pose, in the rig's axes, as defined in
//! [`cad_transforms::covariance`]; its normalized square (NEES; Bar-Shalom et al., Estimation with
//! Applications to Tracking and Navigation, section 5.4) has the number of its dimensions as mean
//! if the covariances are right: much more is over-confident, much less is conservative. *Silently
//! wrong* is a pose that is not lost and has an error of more than 3 sigmas in position or
//! rotation, with the quantile that a right covariance exceeds as rarely as 3 sigmas in one
//! dimension.

use cad_transforms::{Covariance, RigidTransform};
use nalgebra::{UnitQuaternion, Vector3};
use scene_bundle::{Pose, Status, Trajectory};
use serde::Serialize;

use super::align::transform;
use super::statistics::Statistics;

/// Chi-square quantiles exceeded with a probability of 0.27 %, as 3 sigmas of a normal
/// distribution: for three and for six dimensions.
const CHI2_THREE_SIGMA: [f64; 2] = [14.156_413_609_126_7, 20.062_086_165_714_0];
/// Maximum time between ground-truth poses that are interpolated, ns.
const MAX_INTERPOLATION_NS: i64 = 150_000_000;

/// Consistency: whether stated covariances cover the errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Consistency {
    /// Poses with a covariance that were compared.
    pub count: usize,
    /// Usable poses without a covariance.
    pub without: usize,
    /// Mean NEES of position; 3 is right.
    pub nees_translation: f64,
    /// Mean NEES of rotation; 3 is right.
    pub nees_rotation: f64,
    /// Mean NEES of both; 6 is right.
    pub nees: f64,
    /// Ratio of poses whose position is within 3 sigmas; 0.9973 is right.
    pub within_translation: f64,
    /// Ratio of poses whose rotation is within 3 sigmas.
    pub within_rotation: f64,
    /// Ratio of poses with both within 3 sigmas.
    pub within: f64,
    /// Median stated standard deviation of a position over the RMS error of positions: much more
    /// than 1 is conservative. Infinite without errors.
    pub sharpness_translation: f64,
    /// The same of rotations.
    pub sharpness_rotation: f64,
    /// Poses beyond 3 sigmas in position or rotation although they are not lost.
    pub silently_wrong: usize,
    /// Dead reckoned poses among them.
    pub silently_wrong_dead_reckoned: usize,
    /// Time of the first of them, ns.
    pub first_wrong_ns: Option<i64>,
}

/// `None` if no pose has a covariance or none can be compared.
pub(crate) fn consistency(
    estimate: &Trajectory,
    truth: &Trajectory,
    tolerance_ns: i64,
) -> Option<Consistency> {
    let true_at = |pose: &Pose| interpolated(truth.poses(), pose.time_ns, tolerance_ns);
    let mut poses = (estimate.usable()).filter_map(|pose| Some((pose, true_at(pose)?)));
    let (first, first_truth) = poses.next()?;
    let anchor = upright(&first_truth) * upright(&first.world_from_rig).inverse();
    let mut sums = [0.0; 3];
    let mut within = [0_usize; 3];
    let (mut count, mut without, mut wrong, mut reckoned) = (0, 0, 0, 0);
    let mut first_wrong_ns = None;
    let mut errors = [Vec::new(), Vec::new()];
    let mut sigmas = [Vec::new(), Vec::new()];
    for (pose, truth) in std::iter::once((first, first_truth)).chain(poses) {
        let Some(covariance) = &pose.covariance else {
            without += 1;
            continue;
        };
        count += 1;
        let error = (anchor * pose.world_from_rig).inverse() * truth;
        let squares = squares(&error, covariance);
        let norms = [error.translation_m(), error.rotation_vector()];
        for (k, [x, y, z]) in norms.into_iter().enumerate() {
            let variance = |axis: usize| covariance.rows()[3 * k + axis][3 * k + axis];
            errors[k].push((x * x + y * y + z * z).sqrt());
            sigmas[k].push((variance(0) + variance(1) + variance(2)).sqrt());
        }
        let [few, many] = CHI2_THREE_SIGMA;
        let limits = [few, few, many];
        for k in 0..3 {
            sums[k] += squares[k];
            within[k] += usize::from(squares[k] <= limits[k]);
        }
        if squares[0] > few || squares[1] > few {
            wrong += 1;
            reckoned += usize::from(pose.status == Status::DeadReckoned);
            first_wrong_ns = first_wrong_ns.or(Some(pose.time_ns));
        }
    }
    if count == 0 {
        return None;
    }
    let mean = |k: usize| sums[k] / count as f64;
    let share = |k: usize| within[k] as f64 / count as f64;
    let [sharpness_translation, sharpness_rotation] = [0, 1].map(|k| {
        let [errors, sigmas] = [&mut errors[k], &mut sigmas[k]].map(std::mem::take);
        let errors = Statistics::of(errors).map_or(0.0, |errors| errors.rmse);
        Statistics::of(sigmas).map_or(f64::INFINITY, |sigmas| sigmas.median / errors)
    });
    Some(Consistency {
        count,
        without,
        nees_translation: mean(0),
        nees_rotation: mean(1),
        nees: mean(2),
        within_translation: share(0),
        within_rotation: share(1),
        within: share(2),
        sharpness_translation,
        sharpness_rotation,
        silently_wrong: wrong,
        silently_wrong_dead_reckoned: reckoned,
        first_wrong_ns,
    })
}

/// NEES: of position, of rotation, of both.
fn squares(error: &RigidTransform, covariance: &Covariance) -> [f64; 3] {
    let ([x, y, z], [a, b, c]) = (error.translation_m(), error.rotation_vector());
    let motions = [
        [x, y, z, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, a, b, c],
        [x, y, z, a, b, c],
    ];
    let parts = [0..3, 3..6, 0..6];
    std::array::from_fn(|k| {
        // An excluded direction has no variance and no motion.
        let is_used = |i: usize| parts[k].contains(&i);
        let rows = covariance.rows();
        let rows = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                if is_used(i) && is_used(j) {
                    rows[i][j]
                } else {
                    0.0
                }
            })
        });
        let part = Covariance::from_rows(rows).expect("a part of a covariance is one");
        part.distance(motions[k]).powi(2)
    })
}

/// Position and heading of a pose: the rotation about the vertical that is nearest to its rotation.
fn upright(pose: &RigidTransform) -> RigidTransform {
    let q = pose.rotation().quaternion();
    let heading = match q.w.hypot(q.k) > 1e-12 {
        true => UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2.0 * q.k.atan2(q.w)),
        false => UnitQuaternion::identity(),
    };
    transform(heading, *pose.translation())
}

/// The ground-truth pose at a time, or, between two that are far apart, the nearest one within the
/// tolerance.
fn interpolated(truth: &[Pose], time_ns: i64, tolerance_ns: i64) -> Option<RigidTransform> {
    let after = truth.partition_point(|p| p.time_ns < time_ns);
    let to = truth.get(after);
    if let Some(to) = to.filter(|to| to.time_ns == time_ns) {
        return Some(to.world_from_rig);
    }
    let from = after.checked_sub(1).map(|before| &truth[before]);
    if let (Some(from), Some(to)) = (from, to)
        && to.time_ns - from.time_ns <= MAX_INTERPOLATION_NS
    {
        let share = (time_ns - from.time_ns) as f64 / (to.time_ns - from.time_ns) as f64;
        let [a, b] = [from, to].map(|p| &p.world_from_rig);
        // A rotation by 180 degrees has no unique interpolation.
        let turn = a.rotation().try_slerp(b.rotation(), share, 1e-9)?;
        return Some(transform(
            turn,
            a.translation().lerp(b.translation(), share),
        ));
    }
    let near = [from, to].into_iter().flatten();
    let nearest = near.min_by_key(|p| p.time_ns.abs_diff(time_ns))?;
    let is_near = nearest.time_ns.abs_diff(time_ns) <= tolerance_ns.unsigned_abs();
    is_near.then_some(nearest.world_from_rig)
}
