//! Rotations from and to rotation vectors.
//!
//! Contract: the same bits on every machine. The standard library's sine is the system's and may
//! differ in the last bit between machines; `libm` is compiled in.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// The rotation by `|v|` rad about `v`.
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

/// From yaw about z, then pitch about the new y, then roll about the new x, rad.
pub(crate) fn from_yaw_pitch_roll(yaw: f64, pitch: f64, roll: f64) -> UnitQuaternion<f64> {
    exp(Vector3::z() * yaw) * exp(Vector3::y() * pitch) * exp(Vector3::x() * roll)
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
}
