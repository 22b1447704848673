//! Reinitialization after tracking loss.
//!
//! If images and IMU were both missing for a while, the rotation meanwhile is unknown. A window
//! that continued would linearize this large uncertainty as a small one, and gravity, once measured
//! again, would make it overconfident of a wrong pose. Without an IMU the window would become so by
//! itself: factors that were linearized at different headings, of which each determines relative
//! poses only, seem to determine the heading together (Huang et al., Observability-based rules for
//! designing consistent EKF SLAM estimators, IJRR 2010). The first frame with enough landmarks and,
//! unless the IMU is silent, a long enough run of samples therefore starts a new window: the
//! vertical comes from gravity as in the first window, position and heading from the best guess.
//! Their uncertainty remains outside the window ([`ResetUncertainty`]) and is added to the
//! covariances of the window.

use nalgebra::{Matrix3, Matrix6, Quaternion, UnitQuaternion, Vector3};

use super::Odometry;
use super::keyframes::finish_keyframe;
use crate::backend::covariance::transport;
use crate::backend::state::{ACCEL_BIAS, GYRO_BIAS, ROTATION, STATE_DIM, State};
use crate::backend::window::{Landmark, Window};
use crate::config::EstimatorConfig;
use crate::estimator::initialization::initialize_static;
use crate::inertial::imu_buffer::Reading;
use crate::inertial::imu_set::continuous_readings;

/// A pose at a reset, and its uncertainty that applies since then.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ResetUncertainty {
    at: State,
    covariance: Matrix6<f64>,
}

impl ResetUncertainty {
    /// Uncertainty of a pose: position in the world, rotation in the body.
    pub(crate) fn new(at: State, covariance: Matrix6<f64>) -> Self {
        Self { at, covariance }
    }

    /// Contribution to the covariance of a later pose.
    pub(crate) fn at(&self, later: &State) -> Matrix6<f64> {
        transport(&self.at, later, &self.covariance)
    }
}

/// Whether the covariance of a pose (position in the world, rotation in the body) is too large for
/// linearization, which holds up to a rotation sigma, rad.
pub(crate) fn is_lost(max_rotation_sigma_rad: f64, covariance: &Matrix6<f64>) -> bool {
    let rotation = covariance.fixed_view::<3, 3>(ROTATION, ROTATION);
    rotation.symmetric_eigenvalues().amax() > max_rotation_sigma_rad * max_rotation_sigma_rad
}

/// First state at a guess with a known covariance, its standard deviations within the new window,
/// and the uncertainty that remains outside. `readings` are the IMU samples immediately before, or
/// empty. Without an IMU the guess is used unchanged.
pub(crate) fn reinitialize(
    config: &EstimatorConfig,
    guess: &State,
    covariance: &Matrix6<f64>,
    readings: &[Reading],
    has_imu: bool,
) -> (State, [f64; STATE_DIM], ResetUncertainty) {
    let (fresh, mut sigmas) =
        initialize_static(&config.initialization, guess.time_ns, readings, has_imu);
    let mut state = State {
        velocity: Vector3::zeros(),
        ..*guess
    };
    let mut covariance = *covariance;
    if has_imu {
        // Biases were estimated before and change slowly.
        sigmas[GYRO_BIAS..ACCEL_BIAS].fill(config.reinitialization.bias_sigma[0]);
        sigmas[ACCEL_BIAS..].fill(config.reinitialization.bias_sigma[1]);
        if !readings.is_empty() {
            let correction = guess.rotation * fresh.rotation.inverse();
            // Its part about the vertical.
            let about_up = Quaternion::new(correction.w, 0.0, 0.0, correction.k);
            state.rotation = UnitQuaternion::new_normalize(about_up) * fresh.rotation;
        }
        // The window estimates the tilt: of the rotation only the heading remains outside.
        let up = guess.rotation.inverse() * Vector3::z();
        let rotation: Matrix3<f64> = covariance
            .fixed_view::<3, 3>(ROTATION, ROTATION)
            .into_owned();
        let cross_covariance: Matrix3<f64> =
            covariance.fixed_view::<3, 3>(0, ROTATION).into_owned();
        let own_up = state.rotation.inverse() * Vector3::z();
        let heading = (up.transpose() * rotation * up)[0];
        let with_position = cross_covariance * up * own_up.transpose();
        let mut view = covariance.fixed_view_mut::<3, 3>(ROTATION, ROTATION);
        view.copy_from(&(own_up * own_up.transpose() * heading));
        let mut view = covariance.fixed_view_mut::<3, 3>(0, ROTATION);
        view.copy_from(&with_position);
        let mut view = covariance.fixed_view_mut::<3, 3>(ROTATION, 0);
        view.copy_from(&with_position.transpose());
    }
    let uncertainty = ResetUncertainty {
        at: state,
        covariance,
    };
    (state, sigmas, uncertainty)
}

impl Odometry {
    /// Whether a new window has to begin after a frame that nothing connects to earlier ones:
    /// always without IMU samples, and where the covariance of its pose is too large.
    pub(super) fn needs_reinitialization(&self, time_ns: i64, covariance: &Matrix6<f64>) -> bool {
        let config = &self.config.estimator.reinitialization;
        self.is_imu_silent(time_ns) || is_lost(config.max_rotation_sigma_rad, covariance)
    }

    /// Whether there are no recent IMU samples.
    pub(super) fn is_imu_silent(&self, time_ns: i64) -> bool {
        let last = self
            .imus
            .as_ref()
            .and_then(|imus| imus.current().samples.last_ns());
        let timeout_ns = self.config.estimator.reinitialization.imu_timeout_ns;
        last.is_none_or(|last| time_ns - last > timeout_ns)
    }

    /// Adds to the uncertainty that the window does not contain, which becomes one at this state.
    pub(super) fn add_unmodeled(&mut self, at: &State, covariance: Matrix6<f64>) {
        let sum = self.with_unmodeled(at, covariance);
        self.unmodeled = Some(ResetUncertainty::new(*at, sum));
    }

    /// Adds the uncertainty of resets to the covariance of a pose in the window.
    pub(super) fn with_unmodeled(&self, state: &State, covariance: Matrix6<f64>) -> Matrix6<f64> {
        let earlier = self.unmodeled.as_ref();
        covariance + earlier.map_or_else(Matrix6::zeros, |earlier| earlier.at(state))
    }

    /// Starts a new window at the newest frame as soon as there are enough landmarks and IMU
    /// samples; see [`reinitialization`]. `covariance` is that of its pose in the previous window,
    /// to which none of its observations is connected.
    pub(super) fn reinitialize(&mut self, window: &mut Window, covariance: &Matrix6<f64>) {
        let config = &self.config.estimator;
        let guess = window.newest().state;
        let mut readings = Vec::new();
        if let Some(imus) = &self.imus {
            let (until, imu) = (guess.time_ns, imus.current());
            let continuous = imu.samples.continuous_since(until);
            let is_silent = self.is_imu_silent(until);
            match continuous {
                Some(since) if until - since >= config.reinitialization.min_continuous_imu_ns => {
                    let window_ns = config.initialization.window_ns;
                    readings = continuous_readings(imu, until, window_ns);
                }
                _ if is_silent => {}
                _ => return,
            }
        }
        let number = window.newest().number;
        let is_new = |landmark: &Landmark| landmark.observations[0].0 == number;
        if window.landmarks.values().filter(|l| is_new(l)).count() < config.min_inliers {
            return;
        }
        let covariance = self.with_unmodeled(&guess, *covariance);
        let (state, mut sigmas, uncertainty) =
            reinitialize(config, &guess, &covariance, &readings, self.imus.is_some());
        if self.imus.as_ref().is_some_and(|imus| imus.uses().len() > 1) {
            // Those of an IMU that took over may not have been estimated before.
            let [gyro, accel] = config.initialization.bias_sigma;
            sigmas[GYRO_BIAS..ACCEL_BIAS].fill(gyro);
            sigmas[ACCEL_BIAS..].fill(accel);
        } else if let Some(information) = self.keyframe_covariance.gyro_scale.try_inverse() {
            self.gyro_scale = (window.prior.gyro_scale.error, information);
        }
        for frame in &window.frames[..window.frames.len() - 1] {
            self.ready.extend(finish_keyframe(&mut self.pending, frame));
        }
        if let Some(keyframe) = self.pending.get_mut(&self.number) {
            keyframe.state = (&state).into();
        }
        if let Some(information) = self.keyframe_covariance.calibrations().try_inverse() {
            self.calibration_information = information;
        }
        let mut landmarks = std::mem::take(&mut window.landmarks);
        landmarks.retain(|_, landmark| is_new(landmark));
        *window = Window {
            landmarks,
            ..self.window_of(state, &sigmas)
        };
        self.keyframe_covariance = window.prior.covariance();
        // The new uncertainty includes the previous ones.
        self.unmodeled = Some(uncertainty);
        self.is_lost = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::state::GRAVITY;
    use cad_transforms::so3;

    #[test]
    fn vertical_is_measured_and_heading_is_kept() {
        let truth = so3::exp(Vector3::new(0.0, 0.0, 2.0)) * so3::exp(Vector3::new(0.2, -0.1, 0.0));
        let mut guess = State::at_rest(0);
        // Tilted by one more radian, with the same heading.
        guess.rotation =
            so3::exp(Vector3::new(0.0, 0.0, 2.0)) * so3::exp(Vector3::new(1.0, 0.0, 0.0));
        guess.velocity = Vector3::new(9.0, 0.0, 0.0);
        let specific_force = truth.inverse() * Vector3::new(0.0, 0.0, GRAVITY);
        let readings: Vec<Reading> = (0..100)
            .map(|k| Reading {
                time_ns: k * 4_000_000,
                gyro: Vector3::new(0.5, 0.0, 0.0),
                accel: specific_force,
                saturated: [false; 2],
            })
            .collect();
        let covariance = Matrix6::identity();
        let (state, _, uncertainty) = reinitialize(
            &EstimatorConfig::default(),
            &guess,
            &covariance,
            &readings,
            true,
        );
        let up = state.rotation.inverse() * Vector3::z();
        assert!((up - specific_force / GRAVITY).norm() < 1e-9);
        assert!(
            state.rotation.angle_to(&truth) < 0.2,
            "{}",
            state.rotation.angle_to(&truth)
        );
        assert_eq!(state.velocity, Vector3::zeros());
        // After ten meters, one radian of heading is ten meters of lateral error; tilt does not
        // contribute.
        let mut later = state;
        later.position.x += 10.0;
        let there = uncertainty.at(&later);
        assert!((there[(1, 1)].sqrt() - 101.0_f64.sqrt()).abs() < 1e-6);
        assert!((there[(2, 2)].sqrt() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn rotation_sigma_of_one_radian_is_lost() {
        assert!(is_lost(0.3, &Matrix6::identity()));
        assert!(!is_lost(0.3, &(Matrix6::identity() * 0.01)));
    }
}
