//! Beginning anew after the way was lost.
//!
//! Where pictures and IMU were both gone for a while, nobody knows how far the body turned meanwhile. A window that simply goes on takes
//! that doubt for a small one, and gravity, once felt again, makes it sure of a pose that is wrong. So the first frame
//! that shows enough, with an IMU that has been heard for long enough, begins a window of its own: up comes from gravity as in
//! the first one, place and heading from the best guess. What is not known of those stays outside the window ([`Doubt`]) and is
//! added to what the window says of itself.

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

use crate::doubt::carried;
use crate::imu::Reading;
use crate::start::start;
use crate::state::{ACCEL_BIAS, GYRO_BIAS, SIZE, State, TURN};

/// How far a turn may be in doubt before errors are no longer small, rad.
const MOST_DOUBT: f64 = 0.3;
/// How long an IMU must have been heard without a gap, and after which silence it is not waited for, ns.
pub(crate) const HEARD_NS: i64 = 300_000_000;
pub(crate) const SILENT_NS: i64 = 1_000_000_000;
/// By how much biases may have changed, rad/s and m/s².
const BIAS: [f64; 2] = [0.01, 0.15];

/// A pose, and what has not been known of it since.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Doubt {
    at: State,
    covariance: Matrix6<f64>,
}

impl Doubt {
    /// Of the turn alone, about any axis, rad.
    pub(crate) fn of_turn(at: State, sigma: f64) -> Self {
        let mut covariance = Matrix6::zeros();
        covariance
            .fixed_view_mut::<3, 3>(TURN, TURN)
            .fill_diagonal(sigma * sigma);
        Self { at, covariance }
    }

    /// What it makes of a later pose's covariance.
    pub(crate) fn at(&self, later: &State) -> Matrix6<f64> {
        carried(&self.at, later, &self.covariance)
    }
}

/// Whether a pose's covariance (position in the world, turn in the body) is too wide to be linear in.
pub(crate) fn is_lost(covariance: &Matrix6<f64>) -> bool {
    let turn = covariance.fixed_view::<3, 3>(TURN, TURN);
    turn.symmetric_eigenvalues().amax() > MOST_DOUBT * MOST_DOUBT
}

/// A first state at a guess whose covariance is known, with its standard deviations within the new window, and what stays
/// outside. `readings` are those of the time just before; empty where none are there. A body without IMU keeps its guess.
pub(crate) fn begin(
    guess: &State,
    covariance: &Matrix6<f64>,
    readings: &[Reading],
    has_imu: bool,
) -> (State, [f64; SIZE], Doubt) {
    let (fresh, mut sigmas) = start(guess.time_ns, readings, has_imu);
    let mut state = State {
        velocity: Vector3::zeros(),
        ..*guess
    };
    let mut covariance = *covariance;
    if has_imu {
        // Biases were found before and do not leap.
        sigmas[GYRO_BIAS..ACCEL_BIAS].fill(BIAS[0]);
        sigmas[ACCEL_BIAS..].fill(BIAS[1]);
        if !readings.is_empty() {
            let across = guess.turn * fresh.turn.inverse();
            let heading = 2.0 * across.k.atan2(across.w);
            let about_up = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
            state.turn = about_up * fresh.turn;
        }
        // The tilt is the window's to find: of the turn the heading alone stays outside.
        let up = guess.turn.inverse() * Vector3::z();
        let turn: Matrix3<f64> = covariance.fixed_view::<3, 3>(TURN, TURN).into_owned();
        let across: Matrix3<f64> = covariance.fixed_view::<3, 3>(0, TURN).into_owned();
        let own_up = state.turn.inverse() * Vector3::z();
        let heading = (up.transpose() * turn * up)[0];
        let with_place = across * up * own_up.transpose();
        let mut view = covariance.fixed_view_mut::<3, 3>(TURN, TURN);
        view.copy_from(&(own_up * own_up.transpose() * heading));
        let mut view = covariance.fixed_view_mut::<3, 3>(0, TURN);
        view.copy_from(&with_place);
        let mut view = covariance.fixed_view_mut::<3, 3>(TURN, 0);
        view.copy_from(&with_place.transpose());
    }
    let doubt = Doubt {
        at: state,
        covariance,
    };
    (state, sigmas, doubt)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::so3;
    use crate::state::GRAVITY;

    #[test]
    fn up_is_felt_and_heading_is_kept() {
        let truth =
            so3::exp(&Vector3::new(0.0, 0.0, 2.0)) * so3::exp(&Vector3::new(0.2, -0.1, 0.0));
        let mut guess = State::at_rest(0);
        // Tilted by a radian more, with the same heading.
        guess.turn =
            so3::exp(&Vector3::new(0.0, 0.0, 2.0)) * so3::exp(&Vector3::new(1.0, 0.0, 0.0));
        guess.velocity = Vector3::new(9.0, 0.0, 0.0);
        let felt = truth.inverse() * Vector3::new(0.0, 0.0, GRAVITY);
        let readings: Vec<Reading> = (0..100)
            .map(|k| Reading {
                time_ns: k * 4_000_000,
                gyro: Vector3::new(0.5, 0.0, 0.0),
                accel: felt,
                clipped: false,
            })
            .collect();
        let covariance = Matrix6::identity();
        let (state, _, doubt) = begin(&guess, &covariance, &readings, true);
        let up = state.turn.inverse() * Vector3::z();
        assert!((up - felt / GRAVITY).norm() < 1e-9);
        assert!(
            state.turn.angle_to(&truth) < 0.2,
            "{}",
            state.turn.angle_to(&truth)
        );
        assert_eq!(state.velocity, Vector3::zeros());
        // Ten metres on, a radian of heading is ten metres across, and of tilt nothing is said.
        let mut later = state;
        later.position.x += 10.0;
        let there = doubt.at(&later);
        assert!((there[(1, 1)].sqrt() - 101.0_f64.sqrt()).abs() < 1e-6);
        assert!((there[(2, 2)].sqrt() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_doubt_of_a_radian_is_lost() {
        assert!(is_lost(&Matrix6::identity()));
        assert!(!is_lost(&(Matrix6::identity() * 0.01)));
    }
}
