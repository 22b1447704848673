//! Rotations and rotation vectors, with their Jacobians.
//!
//! A small rotation is always on the right: `R exp(d)`. The right Jacobian maps a change of a
//! rotation vector to such a rotation, `exp(v + d) = exp(v) exp(J d)`. Formulas: Chirikjian,
//! Stochastic Models, Information Theory, and Lie Groups 2 (2012), as in Forster et al.,
//! On-Manifold Preintegration (2017), equations 7 and 8.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Squared angle below which series are used, rad².
const SMALL_ANGLE_SQUARED: f64 = 1e-6;

/// The matrix of `v ×`.
pub(super) fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// The rotation by `|v|` rad about `v`.
pub(super) fn exp(v: &Vector3<f64>) -> Matrix3<f64> {
    let square = v.norm_squared();
    let (a, b) = if square < SMALL_ANGLE_SQUARED {
        (1.0 - square / 6.0, 0.5 - square / 24.0)
    } else {
        let angle = square.sqrt();
        (angle.sin() / angle, (1.0 - angle.cos()) / square)
    };
    let k = cross(v);
    Matrix3::identity() + k * a + k * k * b
}

/// The rotation vector of a rotation, at most π long.
pub(super) fn log(r: &Matrix3<f64>) -> Vector3<f64> {
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(*r);
    UnitQuaternion::from_rotation_matrix(&rotation).scaled_axis()
}

/// The rotation nearest to a matrix that is a rotation but for rounding.
pub(super) fn tidy(r: &Matrix3<f64>) -> Matrix3<f64> {
    r * (Matrix3::identity() * 3.0 - r.transpose() * r) * 0.5
}

/// The right Jacobian at a rotation vector.
pub(super) fn right_jacobian(v: &Vector3<f64>) -> Matrix3<f64> {
    let square = v.norm_squared();
    let (a, b) = if square < SMALL_ANGLE_SQUARED {
        (0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
    } else {
        let angle = square.sqrt();
        (
            (1.0 - angle.cos()) / square,
            (angle - angle.sin()) / (square * angle),
        )
    };
    let k = cross(v);
    Matrix3::identity() - k * a + k * k * b
}

/// Its inverse, for angles up to π.
pub(super) fn right_jacobian_inverse(v: &Vector3<f64>) -> Matrix3<f64> {
    let square = v.norm_squared();
    let b = if square < SMALL_ANGLE_SQUARED {
        1.0 / 12.0 + square / 720.0
    } else {
        let angle = square.sqrt();
        1.0 / square - 1.0 / (2.0 * angle * (0.5 * angle).tan())
    };
    let k = cross(v);
    Matrix3::identity() + k * 0.5 + k * k * b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jacobians_agree_with_the_exponential() {
        for v in [
            Vector3::new(0.0, 0.0, 0.0),
            Vector3::new(2e-4, -5e-4, 1e-4),
            Vector3::new(9e-4, -5e-4, 1e-4),
            Vector3::new(0.3, -0.2, 0.9),
            Vector3::new(-2.0, 1.0, 1.5),
        ] {
            assert!((log(&exp(&v)) - v).norm() < 1e-12);
            let j = right_jacobian(&v);
            let h = 1e-6;
            for k in 0..3 {
                let mut d = Vector3::zeros();
                d[k] = h;
                let by = log(&(exp(&(v - d)).transpose() * exp(&(v + d)))) / (2.0 * h);
                assert!((by - j.column(k)).norm() < 1e-8, "{v} {k}");
            }
            let one = j * right_jacobian_inverse(&v);
            assert!((one - Matrix3::identity()).norm() < 1e-9, "{v}");
        }
    }
}
