//! Poses and covariances as this crate computes with them.

use cad_transforms::{Covariance, RigidTransform};
use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};

/// A pose; `None` if it is not finite.
pub(crate) fn pose(rotation: &UnitQuaternion<f64>, at: &Vector3<f64>) -> Option<RigidTransform> {
    let q = rotation.quaternion();
    RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], (*at).into()).ok()
}

/// A foot at the same place on level ground, rotated to the left by an angle, rad.
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

/// `None` if rounding makes the matrix no covariance.
pub(crate) fn covariance(matrix: &Matrix6<f64>) -> Option<Covariance> {
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)]));
    Covariance::from_rows(rows).ok()
}
