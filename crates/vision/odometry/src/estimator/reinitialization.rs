//! Beginning anew after the way was lost.
//!
//! Where pictures and IMU were both gone for a while, nobody knows how far the body turned meanwhile. A window that simply goes on takes
//! that doubt for a small one, and gravity, once felt again, makes it sure of a pose that is wrong. So the first frame
//! that shows enough, with an IMU that has been heard for long enough, begins a window of its own: up comes from gravity as in
//! the first one, place and heading from the best guess. What is not known of those stays outside the window ([`ResetUncertainty`]) and is
//! added to what the window says of itself.

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

use crate::backend::covariance::transport;
use crate::backend::state::{ACCEL_BIAS, GYRO_BIAS, ROTATION, STATE_DIM, State};
use crate::estimator::initialization::initialize_static;
use crate::inertial::imu_buffer::Reading;

/// How far a turn may be in doubt before errors are no longer small, rad.
const MAX_ROTATION_SIGMA_RAD: f64 = 0.3;
/// How long an IMU must have been heard without a gap, and after which silence it is not waited for, ns.
pub(crate) const MIN_CONTINUOUS_IMU_NS: i64 = 300_000_000;
pub(crate) const IMU_TIMEOUT_NS: i64 = 1_000_000_000;
/// By how much biases may have changed, rad/s and m/s².
const BIAS_SIGMA_ON_RESET: [f64; 2] = [0.01, 0.15];

/// A pose, and what has not been known of it since.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ResetUncertainty {
    at: State,
    covariance: Matrix6<f64>,
}

impl ResetUncertainty {
    /// Of the turn alone, about any axis, rad.
    pub(crate) fn of_rotation(at: State, sigma: f64) -> Self {
        let mut covariance = Matrix6::zeros();
        covariance
            .fixed_view_mut::<3, 3>(ROTATION, ROTATION)
            .fill_diagonal(sigma * sigma);
        Self { at, covariance }
    }

    /// What it makes of a later pose's covariance.
    pub(crate) fn at(&self, later: &State) -> Matrix6<f64> {
        transport(&self.at, later, &self.covariance)
    }
}

/// Whether a pose's covariance (position in the world, turn in the body) is too wide to be linear in.
pub(crate) fn is_lost(covariance: &Matrix6<f64>) -> bool {
    let rotation = covariance.fixed_view::<3, 3>(ROTATION, ROTATION);
    rotation.symmetric_eigenvalues().amax() > MAX_ROTATION_SIGMA_RAD * MAX_ROTATION_SIGMA_RAD
}

/// A first state at a guess whose covariance is known, with its standard deviations within the new window, and what stays
/// outside. `readings` are those of the time just before; empty where none are there. A body without IMU keeps its guess.
pub(crate) fn reinitialize(
    guess: &State,
    covariance: &Matrix6<f64>,
    readings: &[Reading],
    has_imu: bool,
) -> (State, [f64; STATE_DIM], ResetUncertainty) {
    let (fresh, mut sigmas) = initialize_static(guess.time_ns, readings, has_imu);
    let mut state = State {
        velocity: Vector3::zeros(),
        ..*guess
    };
    let mut covariance = *covariance;
    if has_imu {
        // Biases were found before and do not leap.
        sigmas[GYRO_BIAS..ACCEL_BIAS].fill(BIAS_SIGMA_ON_RESET[0]);
        sigmas[ACCEL_BIAS..].fill(BIAS_SIGMA_ON_RESET[1]);
        if !readings.is_empty() {
            let cross_covariance = guess.rotation * fresh.rotation.inverse();
            let heading = 2.0 * cross_covariance.k.atan2(cross_covariance.w);
            let about_up = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
            state.rotation = about_up * fresh.rotation;
        }
        // The tilt is the window's to find: of the turn the heading alone stays outside.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::state::GRAVITY;
    use crate::so3;

    #[test]
    fn up_is_felt_and_heading_is_kept() {
        let truth =
            so3::exp(&Vector3::new(0.0, 0.0, 2.0)) * so3::exp(&Vector3::new(0.2, -0.1, 0.0));
        let mut guess = State::at_rest(0);
        // Tilted by a radian more, with the same heading.
        guess.rotation =
            so3::exp(&Vector3::new(0.0, 0.0, 2.0)) * so3::exp(&Vector3::new(1.0, 0.0, 0.0));
        guess.velocity = Vector3::new(9.0, 0.0, 0.0);
        let specific_force = truth.inverse() * Vector3::new(0.0, 0.0, GRAVITY);
        let readings: Vec<Reading> = (0..100)
            .map(|k| Reading {
                time_ns: k * 4_000_000,
                gyro: Vector3::new(0.5, 0.0, 0.0),
                accel: specific_force,
                saturated: false,
            })
            .collect();
        let covariance = Matrix6::identity();
        let (state, _, uncertainty) = reinitialize(&guess, &covariance, &readings, true);
        let up = state.rotation.inverse() * Vector3::z();
        assert!((up - specific_force / GRAVITY).norm() < 1e-9);
        assert!(
            state.rotation.angle_to(&truth) < 0.2,
            "{}",
            state.rotation.angle_to(&truth)
        );
        assert_eq!(state.velocity, Vector3::zeros());
        // Ten metres on, a radian of heading is ten metres across, and of tilt nothing is said.
        let mut later = state;
        later.position.x += 10.0;
        let there = uncertainty.at(&later);
        assert!((there[(1, 1)].sqrt() - 101.0_f64.sqrt()).abs() < 1e-6);
        assert!((there[(2, 2)].sqrt() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_doubt_of_a_radian_is_lost() {
        assert!(is_lost(&Matrix6::identity()));
        assert!(!is_lost(&(Matrix6::identity() * 0.01)));
    }
}
