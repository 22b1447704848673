//! Rotation matrices and rotation vectors, after [`cad_transforms::so3`].

use cad_transforms::so3;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

pub(super) use cad_transforms::so3::{right_jacobian, right_jacobian_inverse};

/// The rotation by `|v|` rad about `v`.
pub(super) fn exp(v: &Vector3<f64>) -> Matrix3<f64> {
    so3::exp(*v).to_rotation_matrix().into_inner()
}

/// The rotation vector of a rotation, at most π long.
pub(super) fn log(r: &Matrix3<f64>) -> Vector3<f64> {
    let rotation = Rotation3::from_matrix_unchecked(*r);
    so3::log(&UnitQuaternion::from_rotation_matrix(&rotation))
}

/// The rotation nearest to a matrix that is a rotation but for rounding.
pub(super) fn tidy(r: &Matrix3<f64>) -> Matrix3<f64> {
    r * (Matrix3::identity() * 3.0 - r.transpose() * r) * 0.5
}
