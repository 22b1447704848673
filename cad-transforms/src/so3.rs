//! Rotations and rotation vectors: exponential, logarithm and their Jacobians.
//!
//! Small rotations act on the right: `R exp(d)`. Formulas: Forster, Carlone, Dellaert and
//! Scaramuzza, On-Manifold Preintegration for Real-Time Visual-Inertial Odometry, 2017, equations 7
//! and 8; inverse: Chirikjian, Stochastic Models, Information Theory, and Lie Groups 2, 2012.
//!
//! Contract: the same bits on every machine. The standard library's sine is the system's and may
//! differ in the last bit between machines; `libm` is compiled in.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Squared angle below which the Jacobians are series, rad².
const SMALL_ANGLE_SQUARED: f64 = 1e-6;

/// The rotation by `|v|` rad about `v`.
///
/// ```
/// use cad_transforms::so3;
/// use nalgebra::Vector3;
///
/// // A quarter turn about z takes x to y.
/// let rotation = so3::exp(Vector3::z() * std::f64::consts::FRAC_PI_2);
/// assert!((rotation * Vector3::x() - Vector3::y()).norm() < 1e-15);
/// assert!((so3::log(&rotation).z - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
/// ```
pub fn exp(v: Vector3<f64>) -> UnitQuaternion<f64> {
    let square = v.norm_squared();
    // sin(a/2)/a and cos(a/2), a = |v|.
    let (s, c) = if square < 1e-8 {
        (0.5 - square / 48.0, 1.0 - square / 8.0)
    } else {
        let angle = square.sqrt();
        (libm::sin(0.5 * angle) / angle, libm::cos(0.5 * angle))
    };
    UnitQuaternion::new_normalize(Quaternion::new(c, s * v.x, s * v.y, s * v.z))
}

/// The rotation vector, rad, at most π long.
pub fn log(q: &UnitQuaternion<f64>) -> Vector3<f64> {
    let (w, v) = match q.w < 0.0 {
        true => (-q.w, -q.imag()),
        false => (q.w, q.imag()),
    };
    let sine = v.norm();
    if sine < 1e-8 {
        return v * 2.0;
    }
    v * (2.0 * libm::atan2(sine, w) / sine)
}

/// The smallest rotation that takes the direction of `a` to that of `b`; `None` if they are
/// opposite or one has no direction.
///
/// ```
/// use cad_transforms::so3;
/// use nalgebra::Vector3;
///
/// let rotation = so3::between(&Vector3::x(), &Vector3::new(0.0, 2.0, 0.0)).unwrap();
/// assert!((rotation * Vector3::x() - Vector3::y()).norm() < 1e-15);
/// assert!((so3::log(&rotation).z - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
/// assert!(so3::between(&Vector3::x(), &-Vector3::x()).is_none());
/// ```
pub fn between(a: &Vector3<f64>, b: &Vector3<f64>) -> Option<UnitQuaternion<f64>> {
    let (a, b) = (a.try_normalize(0.0)?, b.try_normalize(0.0)?);
    // Twice the half angle's cosine and its sine along the axis, times the cosine.
    let w = 1.0 + a.dot(&b);
    (w > 1e-12).then(|| UnitQuaternion::new_normalize(Quaternion::from_parts(w, a.cross(&b))))
}

/// From yaw about z, then pitch about the new y, then roll about the new x, rad.
pub fn from_yaw_pitch_roll(yaw: f64, pitch: f64, roll: f64) -> UnitQuaternion<f64> {
    exp(Vector3::z() * yaw) * exp(Vector3::y() * pitch) * exp(Vector3::x() * roll)
}

/// Right Jacobian: `exp(v + d) = exp(v) exp(J d)` for small `d`.
pub fn right_jacobian(v: &Vector3<f64>) -> Matrix3<f64> {
    let square = v.norm_squared();
    let (a, b) = if square < SMALL_ANGLE_SQUARED {
        (0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
    } else {
        let angle = square.sqrt();
        (
            (1.0 - libm::cos(angle)) / square,
            (angle - libm::sin(angle)) / (square * angle),
        )
    };
    let k = v.cross_matrix();
    Matrix3::identity() - k * a + k * k * b
}

/// Inverse of [`right_jacobian`], for angles up to π: `log(exp(v) exp(d)) = v + inverse d`.
pub fn right_jacobian_inverse(v: &Vector3<f64>) -> Matrix3<f64> {
    let square = v.norm_squared();
    let b = if square < SMALL_ANGLE_SQUARED {
        1.0 / 12.0 + square / 720.0
    } else {
        let angle = square.sqrt();
        1.0 / square - 1.0 / (2.0 * angle * libm::tan(0.5 * angle))
    };
    let k = v.cross_matrix();
    Matrix3::identity() + k * 0.5 + k * k * b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_and_log_are_inverse_and_agree_with_nalgebra() {
        for v in [
            Vector3::new(0.0, 0.0, 0.0),
            Vector3::new(1e-9, -2e-9, 0.0),
            Vector3::new(1e-4, 0.5e-4, -1e-4),
            Vector3::new(0.3, -1.2, 2.0),
            Vector3::new(3.1, 0.2, 0.1),
        ] {
            assert!((log(&exp(v)) - v).norm() < 1e-14, "{v}");
            assert!(exp(v).angle_to(&UnitQuaternion::from_scaled_axis(v)) < 1e-14);
        }
    }

    #[test]
    fn jacobians_equal_finite_differences() {
        for v in [
            Vector3::new(0.0, 0.0, 0.0),
            Vector3::new(2e-4, -5e-4, 1e-4),
            Vector3::new(9e-4, -5e-4, 1e-4),
            Vector3::new(0.3, -0.2, 0.9),
            Vector3::new(-2.0, 1.0, 1.5),
        ] {
            let j = right_jacobian(&v);
            let h = 1e-6;
            for k in 0..3 {
                let mut d = Vector3::zeros();
                d[k] = h;
                let by = log(&(exp(v - d).inverse() * exp(v + d))) / (2.0 * h);
                assert!((by - j.column(k)).norm() < 1e-8, "{v} {k}");
            }
            let one = j * right_jacobian_inverse(&v);
            assert!((one - Matrix3::identity()).norm() < 1e-9, "{v}");
        }
    }
}
