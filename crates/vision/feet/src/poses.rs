//! Poses and covariances as this crate computes with them.

use cad_transforms::{Covariance, RigidTransform};
use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};

use crate::stance::FootObservation;

/// A pose; `None` if it is not finite.
pub(crate) fn pose(rotation: &UnitQuaternion<f64>, at: &Vector3<f64>) -> Option<RigidTransform> {
    let q = rotation.quaternion();
    RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], (*at).into()).ok()
}

/// A foot at the same place on level ground, turned to the left by an angle, rad.
pub(crate) fn level(foot: &RigidTransform, turn: f64) -> Option<RigidTransform> {
    let toe = foot.rotation() * Vector3::x();
    let heading = libm::atan2(toe.y, toe.x) + turn;
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
    pose(&rotation, foot.translation())
}

/// Motion from a pose to another in the axes of the first: translation, rotation.
pub(crate) fn motion(from: &RigidTransform, to: &RigidTransform) -> Vector6<f64> {
    let motion = from.inverse() * *to;
    let ([x, y, z], [a, b, c]) = (motion.translation_m(), motion.rotation_vector());
    Vector6::new(x, y, z, a, b, c)
}

/// Distance of a point of a foot, which is `at` in the world, from a place there, m, and its
/// variance along the direction to it: a tilt that is uncertain moves the ends of the sole up and
/// down.
pub(crate) fn distance(
    seen: &FootObservation,
    point: &[f64; 3],
    place: &Vector3<f64>,
    at: &Vector3<f64>,
) -> [f64; 2] {
    let moved = seen.world_from_foot.rotation().inverse() * (at - place);
    let matrix = seen.covariance.matrix();
    let point = Vector3::from(*point);
    // Motion of the point by a translation and a rotation of the foot, along a direction.
    let variance = |direction: &Vector3<f64>| {
        let turned = point.cross(direction);
        let [x, y, z] = (*direction).into();
        let by_motion = Vector6::new(x, y, z, turned.x, turned.y, turned.z);
        by_motion.dot(&(matrix * by_motion))
    };
    let distance = moved.norm();
    let largest = (0..3)
        .map(|k| variance(&Vector3::ith(k, 1.0)))
        .fold(0.0, f64::max);
    // Near the place the direction is unknown.
    let along = match distance * distance > largest {
        true => variance(&(moved / distance)),
        false => largest,
    };
    [distance, along]
}

/// `None` if rounding makes the matrix no covariance.
pub(crate) fn covariance(matrix: &Matrix6<f64>) -> Option<Covariance> {
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)]));
    Covariance::from_rows(rows).ok()
}
