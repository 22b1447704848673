//! Static initialization: the first state from the IMU samples before the first images.
//!
//! At rest the specific force is the reaction to gravity and the angular rate is the gyroscope
//! bias. In motion the mean specific force still gives the vertical roughly; its standard deviation
//! accounts for that, and the window estimates the rest.

use std::collections::BTreeMap;

use cad_transforms::so3;
use nalgebra::{Matrix6, Vector3};

use super::{Estimate, Odometry};
use crate::backend::window::{Frame, Prior, Window};
use crate::frontend::stale_image::StaleImageDetector;
use crate::frontend::tracker::PredictedPixel;
use imaging::Pyramid;

use crate::backend::state::{
    ACCEL_BIAS, GYRO_BIAS, POSITION, ROTATION, STATE_DIM, State, VELOCITY,
};
use crate::config::InitializationConfig;
use crate::inertial::imu_buffer::Reading;
use crate::inertial::imu_set::continuous_readings;

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
        state.rotation = so3::between(&accel, &Vector3::z())
            .unwrap_or_else(|| so3::exp(Vector3::x() * std::f64::consts::PI));
    }
    state.gyro_rate = readings[readings.len() - 1].gyro;
    (state, sigmas)
}

impl Odometry {
    /// Initializes the window with the first frame set.
    pub(super) fn initialize(
        &mut self,
        time_ns: i64,
        pyramids: Vec<Option<(Pyramid, Pyramid)>>,
        exposure_offset_s: &[f64],
    ) -> Estimate {
        let mut readings = Vec::new();
        if let Some(imus) = &mut self.imus {
            imus.initialize(time_ns);
            let imu = imus.current();
            // Samples without a gap up to now. A single sample does not prove rest, but roughly
            // gives the vertical.
            let window_ns = self.config.estimator.initialization.window_ns;
            readings = continuous_readings(imu, time_ns, window_ns);
            if readings.is_empty() {
                let near = imu.at(time_ns);
                let near = near.filter(|(r, is_near)| *is_near && r.saturated == [false; 2]);
                readings.extend(near.map(|(reading, _)| reading));
            }
        }
        let (state, sigmas) = initialize_static(
            &self.config.estimator.initialization,
            time_ns,
            &readings,
            self.imus.is_some(),
        );
        let mut window = self.window_of(state, &sigmas);
        for (k, (tracker, pyramids)) in self.trackers.iter_mut().zip(pyramids).enumerate() {
            if let Some((left, right)) = pyramids {
                StaleImageDetector::count_fresh_rows(
                    &self.config.frontend.stale_image,
                    &mut self.stale_detectors[k],
                    &left,
                    &state,
                    &self.cameras[k],
                );
                tracker.track(&self.cameras[k], left, right, |track| PredictedPixel {
                    at: track.at,
                    rho: None,
                });
            }
        }
        self.insert_keyframe(&mut window, exposure_offset_s);
        self.newest_is_keyframe = true;
        self.last = Some(state);
        self.keyframe_covariance = window.prior.covariance();
        let covariance = self.keyframe_covariance.pose();
        self.odom_from_body = state.pose();
        self.odom_from_keyframe = self.odom_from_body;
        let inliers = window.landmarks.len();
        self.add_heading_drift(&state);
        let estimate = self.estimate(
            &window,
            &covariance,
            &Matrix6::zeros(),
            inliers,
            inliers >= self.config.estimator.min_inliers,
            true,
        );
        self.window = Some(window);
        estimate
    }

    /// A window of the newest frame alone. A prior fixes the gauge: its position and heading.
    pub(super) fn window_of(&self, state: State, sigmas: &[f64; STATE_DIM]) -> Window {
        let mut prior = Prior::of(self.number, state, sigmas);
        let up = state.rotation.inverse() * Vector3::z();
        let pinned =
            up * up.transpose() * (1e8 - 1.0 / (sigmas[ROTATION] * sigmas[ROTATION])).max(0.0);
        let mut view = prior.information.fixed_view_mut::<3, 3>(ROTATION, ROTATION);
        view += pinned;
        let prior = prior
            .with_calibrations(&self.cameras, &self.calibration_information)
            .with_gyro_scale(self.gyro_scale.0, self.gyro_scale.1);
        Window {
            cameras: self.cameras.clone(),
            frames: vec![Frame {
                number: self.number,
                state,
                motion: None,
            }],
            landmarks: BTreeMap::new(),
            prior,
            config: self.config.backend,
        }
    }
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
                    saturated: [false; 2],
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
