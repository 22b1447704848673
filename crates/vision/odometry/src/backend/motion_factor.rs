//! Motion factor between adjacent frames.
//!
//! The residual is rotation, velocity and displacement minus their preintegrated values (Forster et
//! al. 2017, section VI), and the random walk of the biases: 15 components, weighted by the inverse
//! covariance.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::backend::covariance::NewestCovariance;
use crate::backend::state::{
    ACCEL_BIAS, GRAVITY, GYRO_BIAS, POSITION, ROTATION, STATE_DIM, State, VELOCITY,
};
use crate::backend::window::MotionFactor;
use cad_transforms::so3;

const BOTH_DIM: usize = 2 * STATE_DIM;

/// Linearized factor, by the errors of the earlier and the later state.
pub(crate) struct Term {
    pub(crate) information: SMatrix<f64, BOTH_DIM, BOTH_DIM>,
    pub(crate) gradient: SVector<f64, BOTH_DIM>,
    /// The same for the scale errors of the gyroscope: coupling with the states, information,
    /// gradient.
    pub(crate) by_gyro_scale: SMatrix<f64, BOTH_DIM, 3>,
    pub(crate) gyro_scale_information: Matrix3<f64>,
    pub(crate) gyro_scale_gradient: Vector3<f64>,
    pub(crate) cost: f64,
}

/// Residual in the order rotation, velocity, displacement, gyroscope bias, accelerometer bias.
fn residual(
    motion: &MotionFactor,
    from: &State,
    to: &State,
    gyro_scale: &Vector3<f64>,
) -> SVector<f64, STATE_DIM> {
    let preintegrated = &motion.preintegrated;
    let t = preintegrated.seconds;
    let (rotation, velocity, displacement) =
        preintegrated.corrected(&from.gyro_bias, &from.accel_bias, gyro_scale);
    let back = from.rotation.inverse();
    let gravity = gravity(motion);
    let mut r = SVector::<f64, STATE_DIM>::zeros();
    let mut set = |at: usize, v: Vector3<f64>| r.fixed_rows_mut::<3>(at).copy_from(&v);
    set(0, so3::log(&(rotation.inverse() * back * to.rotation)));
    set(
        3,
        back * (to.velocity - from.velocity - gravity * t) - velocity,
    );
    let translation = to.position - from.position - from.velocity * t - gravity * (0.5 * t * t);
    set(6, back * translation - displacement);
    set(9, to.gyro_bias - from.gyro_bias);
    set(12, to.accel_bias - from.accel_bias);
    r
}

fn gravity(motion: &MotionFactor) -> Vector3<f64> {
    let size = if motion.has_gravity { GRAVITY } else { 0.0 };
    Vector3::new(0.0, 0.0, -size)
}

/// The state that a motion leads to; its angular rate is that of the earlier one.
pub(crate) fn predict(
    motion: &MotionFactor,
    from: &State,
    gyro_scale: &Vector3<f64>,
    time_ns: i64,
) -> State {
    let seconds = (time_ns - from.time_ns) as f64 * 1e-9;
    let gravity = gravity(motion);
    let (rotation, velocity, displacement) =
        (motion.preintegrated).corrected(&from.gyro_bias, &from.accel_bias, gyro_scale);
    State {
        time_ns,
        position: from.position
            + from.velocity * seconds
            + gravity * (0.5 * seconds * seconds)
            + from.rotation * displacement,
        rotation: from.rotation * rotation,
        velocity: from.velocity + gravity * seconds + from.rotation * velocity,
        ..*from
    }
}

/// Inverse covariance of the residual.
fn weight(motion: &MotionFactor) -> (SMatrix<f64, 9, 9>, [f64; 2]) {
    let mut covariance = motion.preintegrated.covariance;
    // A hundred times below the noise of any sensor, so that the inverse exists.
    for k in 0..9 {
        covariance[(k, k)] += 1e-12;
    }
    let inverse = covariance
        .cholesky()
        .expect("a covariance with a positive diagonal term is invertible")
        .inverse();
    let t = motion.preintegrated.seconds.max(1e-6);
    (inverse, motion.bias_walk.map(|w| 1.0 / (w * w * t)))
}

/// Cost without derivatives.
pub(crate) fn cost(
    motion: &MotionFactor,
    from: &State,
    to: &State,
    gyro_scale: &Vector3<f64>,
) -> f64 {
    let r = residual(motion, from, to, gyro_scale);
    let (nine, bias_walk) = weight(motion);
    let preintegrated = r.fixed_rows::<9>(0);
    (preintegrated.transpose() * nine * preintegrated)[0]
        + bias_walk[0] * r.fixed_rows::<3>(9).norm_squared()
        + bias_walk[1] * r.fixed_rows::<3>(12).norm_squared()
}

/// Factor on the later state alone: information matrix and gradient. The earlier state and the
/// scale errors of the gyroscope are fixed, but the scale errors and the earlier state's velocity,
/// biases and tilt against gravity have the given covariance.
pub(crate) fn with_uncertain_start(
    motion: &MotionFactor,
    from: &State,
    covariance: &NewestCovariance,
    to: &State,
    gyro_scale: &Vector3<f64>,
) -> (SMatrix<f64, STATE_DIM, STATE_DIM>, SVector<f64, STATE_DIM>) {
    let (r, j) = derivatives(motion, from, to, gyro_scale);
    let by_later = j.fixed_columns::<STATE_DIM>(STATE_DIM).into_owned();
    let mut by_earlier = j.fixed_columns::<STATE_DIM>(0).into_owned();
    // Common observations constrain the relative pose of adjacent frames; only the effect of
    // gravity through the tilt of the earlier frame remains.
    by_earlier.fixed_columns_mut::<ROTATION>(POSITION).fill(0.0);
    by_earlier.fixed_columns_mut::<3>(ROTATION).fill(0.0);
    let t = motion.preintegrated.seconds;
    let down = (from.rotation.inverse() * gravity(motion)).cross_matrix();
    by_earlier
        .fixed_view_mut::<3, 3>(3, ROTATION)
        .copy_from(&(-down * t));
    by_earlier
        .fixed_view_mut::<3, 3>(6, ROTATION)
        .copy_from(&(-down * (0.5 * t * t)));
    let mut spread = by_earlier * covariance.state() * by_earlier.transpose();
    let by_scale = by_gyro_scale(motion, &r);
    let mut own = spread.fixed_view_mut::<9, 9>(0, 0);
    own +=
        motion.preintegrated.covariance + by_scale * covariance.gyro_scale * by_scale.transpose();
    for k in 0..3 {
        spread[(9 + k, 9 + k)] += motion.bias_walk[0].powi(2) * t;
        spread[(12 + k, 12 + k)] += motion.bias_walk[1].powi(2) * t;
    }
    for k in 0..STATE_DIM {
        spread[(k, k)] += 1e-12;
    }
    let inverse = ((spread + spread.transpose()) * 0.5)
        .cholesky()
        .map_or_else(
            // Too large for floating point: there is no information.
            || SMatrix::<f64, STATE_DIM, STATE_DIM>::identity() * 1e-6,
            |c| c.inverse(),
        );
    let weighted = by_later.transpose() * inverse;
    (weighted * by_later, weighted * r)
}

/// Linearizes the factor.
pub(crate) fn linearize(
    motion: &MotionFactor,
    from: &State,
    to: &State,
    gyro_scale: &Vector3<f64>,
) -> Term {
    let (r, j) = derivatives(motion, from, to, gyro_scale);
    let (nine, bias_walk) = weight(motion);
    let mut w = SMatrix::<f64, STATE_DIM, STATE_DIM>::zeros();
    w.fixed_view_mut::<9, 9>(0, 0).copy_from(&nine);
    for k in 0..3 {
        w[(9 + k, 9 + k)] = bias_walk[0];
        w[(12 + k, 12 + k)] = bias_walk[1];
    }
    let weighted = j.transpose() * w;
    let by_scale = by_gyro_scale(motion, &r);
    let weighted_scale = by_scale.transpose() * nine;
    Term {
        information: weighted * j,
        gradient: weighted * r,
        by_gyro_scale: weighted.fixed_columns::<9>(0) * by_scale,
        gyro_scale_information: weighted_scale * by_scale,
        gyro_scale_gradient: weighted_scale * r.fixed_rows::<9>(0),
        cost: (r.transpose() * w * r)[0],
    }
}

/// Jacobian of the preintegrated part of the residual by the scale errors of the gyroscope.
fn by_gyro_scale(motion: &MotionFactor, residual: &SVector<f64, STATE_DIM>) -> SMatrix<f64, 9, 3> {
    let rotation_error = residual.fixed_rows::<3>(0).into_owned();
    let inverse = so3::right_jacobian_inverse(&rotation_error)
        * so3::exp(-rotation_error).to_rotation_matrix().into_inner();
    let mut by = -motion.preintegrated.by_gyro_scale;
    let rotation = inverse * by.fixed_rows::<3>(0);
    by.fixed_rows_mut::<3>(0).copy_from(&rotation);
    by
}

/// Residual and its Jacobians by the errors of both states.
fn derivatives(
    motion: &MotionFactor,
    from: &State,
    to: &State,
    gyro_scale: &Vector3<f64>,
) -> (SVector<f64, STATE_DIM>, SMatrix<f64, STATE_DIM, BOTH_DIM>) {
    let preintegrated = &motion.preintegrated;
    let t = preintegrated.seconds;
    let r = residual(motion, from, to, gyro_scale);
    let gravity = gravity(motion);
    let back: Matrix3<f64> = from.rotation.inverse().to_rotation_matrix().into_inner();
    let later: Matrix3<f64> = to.rotation.to_rotation_matrix().into_inner();
    let rotation_error = r.fixed_rows::<3>(0).into_owned();
    let inverse = so3::right_jacobian_inverse(&rotation_error);
    let mut j = SMatrix::<f64, STATE_DIM, BOTH_DIM>::zeros();
    let mut set = |row: usize, column: usize, block: Matrix3<f64>| {
        j.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
    };
    let by = |row: usize, column: usize| {
        preintegrated
            .by_bias
            .fixed_view::<3, 3>(row, column)
            .into_owned()
    };
    // Rotation.
    set(0, ROTATION, -inverse * (back * later).transpose());
    set(0, STATE_DIM + ROTATION, inverse);
    let rotation_error_matrix = so3::exp(rotation_error)
        .inverse()
        .to_rotation_matrix()
        .into_inner();
    set(0, GYRO_BIAS, -inverse * rotation_error_matrix * by(0, 0));
    // Velocity.
    let velocity_change = back * (to.velocity - from.velocity - gravity * t);
    set(3, ROTATION, velocity_change.cross_matrix());
    set(3, VELOCITY, -back);
    set(3, STATE_DIM + VELOCITY, back);
    set(3, GYRO_BIAS, -by(3, 0));
    set(3, ACCEL_BIAS, -by(3, 3));
    // Displacement.
    let displacement = to.position - from.position - from.velocity * t - gravity * (0.5 * t * t);
    set(6, ROTATION, (back * displacement).cross_matrix());
    set(6, POSITION, -back);
    set(6, STATE_DIM + POSITION, back);
    set(6, VELOCITY, -back * t);
    set(6, GYRO_BIAS, -by(6, 0));
    set(6, ACCEL_BIAS, -by(6, 3));
    // Bias random walks.
    for (row, at) in [(9, GYRO_BIAS), (12, ACCEL_BIAS)] {
        set(row, at, -Matrix3::identity());
        set(row, STATE_DIM + at, Matrix3::identity());
    }
    (r, j)
}

#[cfg(test)]
mod tests {
    use camera_models::ImuNoise;

    use super::*;
    use crate::backend::state::Error;
    use crate::inertial::imu_buffer::{Preintegration, Reading};

    #[test]
    fn jacobians_equal_finite_differences() {
        let readings: Vec<Reading> = (0..=40)
            .map(|k| {
                let t = f64::from(k) / 200.0;
                Reading {
                    time_ns: (t * 1e9) as i64,
                    gyro: Vector3::new((3.0 * t).sin(), 1.4 * (4.0 * t).cos(), 0.3),
                    accel: Vector3::new(3.0 * (5.0 * t).cos(), 1.0 + t, 9.0),
                    saturated: [false; 2],
                }
            })
            .collect();
        let noise = ImuNoise {
            gyro_noise_density: 0.1,
            gyro_random_walk: 0.1,
            accel_noise_density: 0.3,
            accel_random_walk: 0.2,
        };
        let zero = Vector3::zeros();
        let motion = MotionFactor {
            preintegrated: Preintegration::new(
                &readings,
                &zero,
                &zero,
                &noise,
                &crate::config::InertialConfig::default(),
            ),
            has_gravity: true,
            bias_walk: [0.1, 0.2],
        };
        let spread = |k: usize| Error::from_fn(|i, _| 0.05 * ((i * 7 + k) as f64).sin());
        let mut start = spread(1) * 10.0;
        // Jacobians by biases hold near the linearization point of the preintegration.
        for k in GYRO_BIAS..STATE_DIM {
            start[k] *= 1e-3;
        }
        let from = State::at_rest(0).plus(&start);
        let to = from.plus(&(spread(2) * 4.0));
        let scale = Vector3::new(0.8, -1.3, 0.4);
        let term = linearize(&motion, &from, &to, &scale);
        for k in 0..BOTH_DIM {
            let h = 1e-6;
            let side = |h: f64| {
                let mut e = Error::zeros();
                e[k % STATE_DIM] = h;
                if k < STATE_DIM {
                    cost(&motion, &from.plus(&e), &to, &scale)
                } else {
                    cost(&motion, &from, &to.plus(&e), &scale)
                }
            };
            let by = (side(h) - side(-h)) / (2.0 * h) / 2.0;
            let error = (by - term.gradient[k]).abs() / term.gradient.amax();
            assert!(error < 2e-4, "{k}: {by} {}", term.gradient[k]);
        }
        for k in 0..3 {
            let side = |h: f64| {
                let mut e = Vector3::zeros();
                e[k] = h;
                cost(&motion, &from, &to, &(scale + e))
            };
            let by = (side(1e-4) - side(-1e-4)) / 4e-4;
            let found = term.gyro_scale_gradient[k];
            // The correction of the preintegrated motion is of first order.
            assert!((by - found).abs() < 1e-2 * found.abs(), "{k}: {by} {found}");
        }
        // Where the residual is zero, the gradient by the states changes by the coupling alone.
        let to = predict(&motion, &from, &scale, 200_000_000);
        let term = linearize(&motion, &from, &to, &scale);
        for k in 0..3 {
            let mut e = Vector3::zeros();
            e[k] = 1e-4;
            let moved = linearize(&motion, &from, &to, &(scale + e)).gradient;
            let by = (moved - term.gradient) / 1e-4;
            let error = (by - term.by_gyro_scale.column(k)).amax();
            assert!(error < 1e-2 * by.amax(), "{k}: {error} {}", by.amax());
        }
    }
}
