//! State of the body at one instant.
//!
//! The body frame is that of the IMU in use, or the rig frame without an IMU. The world has z up
//! and its origin at the first body position. The error state has 15 components: `[position in the
//! world, rotation on the right, velocity, gyroscope bias, accelerometer bias]`.

use cad_transforms::RigidTransform;
use nalgebra::{SVector, UnitQuaternion, Vector3};

use cad_transforms::so3;

/// Dimension of the error state.
pub(crate) const STATE_DIM: usize = 15;
/// Dimension of the pose error, the first part of the error state.
pub(crate) const POSE_DIM: usize = 6;
/// Offsets of the parts of the error state.
pub(crate) const POSITION: usize = 0;
pub(crate) const ROTATION: usize = 3;
pub(crate) const VELOCITY: usize = 6;
pub(crate) const GYRO_BIAS: usize = 9;
pub(crate) const ACCEL_BIAS: usize = 12;

/// Standard gravity, m/s² (CGPM 1901). It varies by 0.3 % over the earth, which the accelerometer
/// bias absorbs.
pub(crate) const GRAVITY: f64 = 9.80665;

/// Error state.
pub(crate) type Error = SVector<f64, STATE_DIM>;

/// State of the body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct State {
    pub(crate) time_ns: i64,
    /// Position in the world, m.
    pub(crate) position: Vector3<f64>,
    /// Orientation: world from body.
    pub(crate) rotation: UnitQuaternion<f64>,
    /// Velocity in the world, m/s.
    pub(crate) velocity: Vector3<f64>,
    /// Gyroscope bias, rad/s.
    pub(crate) gyro_bias: Vector3<f64>,
    /// Accelerometer bias, m/s².
    pub(crate) accel_bias: Vector3<f64>,
    /// Angular rate in the body frame as measured by the gyroscope, bias included, rad/s. Not
    /// estimated.
    pub(crate) gyro_rate: Vector3<f64>,
}

impl State {
    /// State at rest at the origin.
    pub(crate) fn at_rest(time_ns: i64) -> Self {
        Self {
            time_ns,
            position: Vector3::zeros(),
            rotation: UnitQuaternion::identity(),
            velocity: Vector3::zeros(),
            gyro_bias: Vector3::zeros(),
            accel_bias: Vector3::zeros(),
            gyro_rate: Vector3::zeros(),
        }
    }

    /// The state perturbed by an error.
    pub(crate) fn plus(&self, error: &Error) -> Self {
        let part = |at: usize| error.fixed_rows::<3>(at).into_owned();
        let mut rotation = self.rotation * so3::exp(part(ROTATION));
        rotation.renormalize();
        Self {
            position: self.position + part(POSITION),
            rotation,
            velocity: self.velocity + part(VELOCITY),
            gyro_bias: self.gyro_bias + part(GYRO_BIAS),
            accel_bias: self.accel_bias + part(ACCEL_BIAS),
            ..*self
        }
    }

    /// Error of this state relative to another one.
    pub(crate) fn minus(&self, other: &Self) -> Error {
        let mut error = Error::zeros();
        let mut set = |at: usize, part: Vector3<f64>| {
            error.fixed_rows_mut::<3>(at).copy_from(&part);
        };
        set(POSITION, self.position - other.position);
        set(
            ROTATION,
            so3::log(&(other.rotation.inverse() * self.rotation)),
        );
        set(VELOCITY, self.velocity - other.velocity);
        set(GYRO_BIAS, self.gyro_bias - other.gyro_bias);
        set(ACCEL_BIAS, self.accel_bias - other.accel_bias);
        error
    }

    /// Pose: world from body.
    pub(crate) fn pose(&self) -> RigidTransform {
        let q = self.rotation;
        RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], self.position.into())
            .expect("a state is finite, since steps that are not finite are rejected")
    }

    /// Pose of the rig.
    pub(crate) fn world_from_rig(&self, body_from_rig: &RigidTransform) -> RigidTransform {
        self.pose() * *body_from_rig
    }

    /// Angular rate in the body frame, bias removed, rad/s.
    pub(crate) fn rate(&self) -> Vector3<f64> {
        self.gyro_rate - self.gyro_bias
    }

    /// Pose at a small time offset, s, at constant rate and velocity: world from body.
    pub(crate) fn pose_after(&self, seconds: f64) -> (UnitQuaternion<f64>, Vector3<f64>) {
        if seconds == 0.0 {
            return (self.rotation, self.position);
        }
        (
            self.rotation * so3::exp(self.rate() * seconds),
            self.position + self.velocity * seconds,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plus_and_minus_are_inverse() {
        let mut state = State::at_rest(5);
        state.rotation = so3::exp(Vector3::new(0.4, -1.0, 0.3));
        let error = Error::from_fn(|k, _| 0.1 * (k as f64 + 1.0).sin());
        let perturbed = state.plus(&error);
        assert!((perturbed.minus(&state) - error).amax() < 1e-12);
        assert!((state.plus(&perturbed.minus(&state)).minus(&perturbed)).amax() < 1e-12);
    }
}
