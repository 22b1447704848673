//! IMUs: extrinsics, noise, and what they measure.

use cad_transforms::RigidTransform;
use serde::{Deserialize, Serialize};

/// Extrinsics and noise of an IMU.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuCalibration {
    /// Takes points in the left optical frame to the IMU's frame, metres.
    pub imu_from_left: RigidTransform,
    /// Nominal rate, Hz.
    pub rate_hz: f64,
    /// Noise model, if the file contains one.
    pub noise: Option<ImuNoise>,
}

/// Continuous-time IMU noise model, as EuRoC and Kalibr write it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuNoise {
    /// Gyroscope white noise, rad/s/√Hz.
    pub gyro_noise_density: f64,
    /// Gyroscope bias random walk, rad/s²/√Hz.
    pub gyro_random_walk: f64,
    /// Accelerometer white noise, m/s²/√Hz.
    pub accel_noise_density: f64,
    /// Accelerometer bias random walk, m/s³/√Hz.
    pub accel_random_walk: f64,
}

/// One sample of an IMU, in its own frame.
///
/// ```
/// use camera_models::ImuSample;
///
/// // At rest, with the z axis up.
/// let rest = ImuSample { time_ns: 0, gyro: [0.0; 3], accel: [0.0, 0.0, 9.81] };
/// assert!(rest.accel[2] > 0.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time of the measurement, ns.
    pub time_ns: i64,
    /// Angular rate, rad/s.
    pub gyro: [f64; 3],
    /// Specific force, m/s²: `R (a - g)`, so that a sensor at rest measures 9.8 upwards.
    pub accel: [f64; 3],
}
