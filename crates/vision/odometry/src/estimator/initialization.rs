//! Static initialization: the first state from the IMU samples before the first images.
//!
//! At rest the specific force is the reaction to gravity and the angular rate is the gyroscope
//! bias. In motion the mean specific force still gives the vertical roughly; its standard deviation
//! accounts for that, and the window estimates the rest.

use nalgebra::{UnitQuaternion, Vector3};

use crate::backend::state::{
    ACCEL_BIAS, GYRO_BIAS, POSITION, ROTATION, STATE_DIM, State, VELOCITY,
};
use crate::config::InitializationConfig;
use crate::inertial::imu_buffer::Reading;

/// Standard deviations of the first state if only the gauge is known: position and heading.
pub(crate) fn initial_sigmas(config: &InitializationConfig, has_imu: bool) -> [f64; STATE_DIM] {
    let mut sigmas = [1e-4; STATE_DIM];
    let mut set = |at: usize, sigma: f64| sigmas[at..at + 3].fill(sigma);
    set(POSITION, 1e-4);
    if has_imu {
        set(ROTATION, config.moving_tilt_sigma_rad);
        set(VELOCITY, config.moving_velocity_sigma);
        set(GYRO_BIAS, config.bias_sigma[0]);
        set(ACCEL_BIAS, config.bias_sigma[1]);
    } else {
        // The world is the first rig frame; the velocity is unknown.
        set(ROTATION, 1e-5);
        set(VELOCITY, config.velocity_sigma_without_imu);
        set(GYRO_BIAS, 1e-6);
        set(ACCEL_BIAS, 1e-6);
    }
    sigmas
}

/// The first state and its standard deviations. Position and heading are zero and fix the gauge.
pub(crate) fn initialize_static(
    config: &InitializationConfig,
    time_ns: i64,
    readings: &[Reading],
    has_imu: bool,
) -> (State, [f64; STATE_DIM]) {
    let mut state = State::at_rest(time_ns);
    let mut sigmas = initial_sigmas(config, has_imu);
    if !has_imu {
        return (state, sigmas);
    }
    let mut set = |at: usize, sigma: f64| sigmas[at..at + 3].fill(sigma);
    if readings.is_empty() {
        set(ROTATION, config.unknown_tilt_sigma_rad);
        return (state, sigmas);
    }
    let n = readings.len() as f64;
    let mean = |of: &dyn Fn(&Reading) -> Vector3<f64>| {
        let mean = readings.iter().map(of).sum::<Vector3<f64>>() / n;
        let square: f64 = readings.iter().map(|r| (of(r) - mean).norm_squared()).sum();
        (mean, (square / n).sqrt())
    };
    let (gyro, gyro_std) = mean(&|r| r.gyro);
    let (accel, accel_std) = mean(&|r| r.accel);
    let seconds = (readings[readings.len() - 1].time_ns - readings[0].time_ns) as f64 * 1e-9;
    let at_rest = seconds >= config.min_static_s
        && gyro_std < config.static_std[0]
        && accel_std < config.static_std[1]
        && gyro.norm() < config.max_gyro_bias;
    if at_rest {
        state.gyro_bias = gyro;
        set(GYRO_BIAS, config.static_gyro_bias_sigma);
        set(VELOCITY, config.static_velocity_sigma);
        set(ROTATION, config.static_tilt_sigma_rad);
    }
    if accel.norm() > 1.0 {
        state.rotation =
            UnitQuaternion::rotation_between(&accel, &Vector3::z()).unwrap_or_else(|| {
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
            });
    }
    state.gyro_rate = readings[readings.len() - 1].gyro;
    (state, sigmas)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn readings(motion: f64) -> Vec<Reading> {
        (0..200)
            .map(|k| {
                let t = f64::from(k) * 0.002;
                Reading {
                    time_ns: k as i64 * 2_000_000,
                    gyro: Vector3::new(0.01, -0.005, 0.002 + motion * (9.0 * t).sin()),
                    accel: Vector3::new(0.0, 9.8, 0.3),
                    saturated: false,
                }
            })
            .collect()
    }

    #[test]
    fn rest_gives_the_vertical_and_the_gyroscope_bias() {
        let (state, sigmas) =
            initialize_static(&InitializationConfig::default(), 0, &readings(0.0), true);
        let up = state.rotation * Vector3::new(0.0, 9.8, 0.3).normalize();
        assert!((up - Vector3::z()).norm() < 1e-12);
        assert!((state.gyro_bias - Vector3::new(0.01, -0.005, 0.002)).norm() < 1e-12);
        assert!(sigmas[GYRO_BIAS] < 0.01);
    }

    #[test]
    fn without_samples_the_tilt_is_unknown() {
        let (_, sigmas) = initialize_static(&InitializationConfig::default(), 0, &[], true);
        assert!(sigmas[ROTATION] >= 1.0);
        // A single instant does not prove rest.
        let short = &readings(0.0)[..20];
        let (state, sigmas) = initialize_static(&InitializationConfig::default(), 0, short, true);
        assert_eq!(state.gyro_bias, Vector3::zeros());
        assert!(sigmas[ROTATION] > 0.1 && sigmas[VELOCITY] > 1.0);
    }

    #[test]
    fn motion_gives_the_vertical_only() {
        let (state, sigmas) =
            initialize_static(&InitializationConfig::default(), 0, &readings(0.5), true);
        assert_eq!(state.gyro_bias, Vector3::zeros());
        assert!(sigmas[ROTATION] > 0.1 && sigmas[VELOCITY] > 1.0);
    }
}
