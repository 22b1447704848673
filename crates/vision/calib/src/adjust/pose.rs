//! Poses as matrices, for speed, and their updates.

use cad_transforms::{RigidTransform, so3};
use nalgebra::{Matrix3, UnitQuaternion, Vector3, Vector6};

/// `b_from_a`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pose {
    pub(super) rotation: Matrix3<f64>,
    pub(super) translation: Vector3<f64>,
}

impl Pose {
    pub(super) fn new(b_from_a: &RigidTransform) -> Self {
        Self {
            rotation: *b_from_a.rotation().to_rotation_matrix().matrix(),
            translation: *b_from_a.translation(),
        }
    }

    pub(super) fn apply(&self, x: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * x + self.translation
    }
}

/// The pose changed by `[v, ω]`.
pub(crate) fn moved(b_from_a: &RigidTransform, step: &Vector6<f64>) -> RigidTransform {
    let turn = so3::exp(Vector3::new(step[3], step[4], step[5]));
    let rotation = turn * b_from_a.rotation();
    let t = b_from_a.translation() + Vector3::new(step[0], step[1], step[2]);
    let q = UnitQuaternion::new_normalize(rotation.into_inner()).into_inner();
    RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], t.into()).unwrap_or(*b_from_a)
}

/// The `[v, ω]` that takes `from` to `to`.
pub(crate) fn step_between(from: &RigidTransform, to: &RigidTransform) -> Vector6<f64> {
    let turn = so3::log(&(to.rotation() * from.rotation().inverse()));
    let shift = to.translation() - from.translation();
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}
