//! Rotation vectors: exponential, logarithm and their Jacobians.
//!
//! Small rotations act on the right: `R Exp(w)`. Formulas: Forster, Carlone, Dellaert and
//! Scaramuzza, On-Manifold Preintegration for Real-Time Visual-Inertial Odometry, 2017, section
//! III.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Angle below which second-order series are sufficiently exact, rad.
const SMALL_ANGLE_RAD: f64 = 1e-5;

/// Matrix of the cross product `w x`.
pub(crate) fn cross(w: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0)
}

/// Rotation of a rotation vector.
pub(crate) fn exp(w: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(*w)
}

/// Rotation vector of a rotation, with a norm of at most π.
pub(crate) fn log(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    rotation.scaled_axis()
}

/// `Exp(w + d) = Exp(w) Exp(right_jacobian(w) d)` for small `d`.
pub(crate) fn right_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle = w.norm();
    let c = cross(w);
    if angle < SMALL_ANGLE_RAD {
        return Matrix3::identity() - c * 0.5 + c * c / 6.0;
    }
    let square = angle * angle;
    Matrix3::identity() - c * ((1.0 - angle.cos()) / square)
        + c * c * ((angle - angle.sin()) / (square * angle))
}

/// Inverse of [`right_jacobian`]: `Log(Exp(w) Exp(d)) = w + inverse d` for small `d`.
pub(crate) fn right_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle = w.norm();
    let c = cross(w);
    if angle < SMALL_ANGLE_RAD {
        return Matrix3::identity() + c * 0.5 + c * c / 12.0;
    }
    let square = angle * angle;
    let bend = 1.0 / square - (1.0 + angle.cos()) / (2.0 * angle * angle.sin());
    Matrix3::identity() + c * 0.5 + c * c * bend
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jacobians_equal_finite_differences() {
        for w in [
            Vector3::new(0.3, -0.8, 0.5),
            Vector3::new(1e-7, 2e-7, -1e-7),
            Vector3::new(-1.2, 1.4, 1.1),
        ] {
            let jacobian = right_jacobian(&w);
            for k in 0..3 {
                let mut d = Vector3::zeros();
                d[k] = 1e-6;
                let there = log(&(exp(&w).inverse() * exp(&(w + d)))) / 1e-6;
                assert!((there - jacobian.column(k)).norm() < 1e-5, "{w} {k}");
            }
            let product = jacobian * right_jacobian_inverse(&w);
            assert!((product - Matrix3::identity()).norm() < 1e-9, "{w}");
            assert!((log(&exp(&w)) - w).norm() < 1e-12);
        }
    }
}
