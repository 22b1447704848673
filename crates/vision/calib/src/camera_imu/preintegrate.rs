//! Preintegration: the motion between two instants as measured by the IMU alone, with its
//! Jacobians.
//!
//! On-manifold preintegration (Forster, Carlone, Dellaert and Scaramuzza, On-Manifold
//! Preintegration for Real-Time Visual-Inertial Odometry, 2017): rotation, velocity change and
//! displacement in the frame of the first instant, without gravity and without the initial
//! velocity. The Jacobians with respect to biases, scale and skew are exact for the discrete sums.
//! Those with respect to the two instants hold for the motion itself and allow estimating a time
//! offset without resampling (the idea of Qin and Shen, Online Temporal Calibration for Monocular
//! Visual-Inertial Systems, 2018).
//!
//! One step: rotation to fourth order for a linearly varying rate (Bortz 1971); specific force
//! rotated at both ends and taken as linear between them.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::so3;
use super::track::{Correction, Raw};

/// Sensor parameters: gyroscope bias 3, accelerometer bias 3, gyroscope scale and skew 9
/// (row-major), accelerometer's 9.
pub(super) const SENSOR: usize = 24;
/// Index of each group.
pub(super) const GYRO_BIAS: usize = 0;
pub(super) const ACCEL_BIAS: usize = 3;
pub(super) const GYRO_SHAPE: usize = 6;
pub(super) const ACCEL_SHAPE: usize = 15;

type BySensor = SMatrix<f64, 3, SENSOR>;

/// Preintegrated motion; see the module. Order of the nine rows: rotation, velocity, displacement.
#[derive(Clone, Debug)]
pub(super) struct Preintegration {
    pub seconds: f64,
    /// `first_from_last`.
    pub turn: Matrix3<f64>,
    /// m/s.
    pub velocity: Vector3<f64>,
    /// m.
    pub displacement: Vector3<f64>,
    /// Jacobian with respect to the sensor parameters; that of the rotation as a small rotation on
    /// its right.
    pub by_sensor: SMatrix<f64, 9, SENSOR>,
    /// Jacobians with respect to the first and the last instant, per second.
    pub by_time: [SMatrix<f64, 9, 1>; 2],
    /// Covariance due to gyroscope noise.
    pub gyro_noise: SMatrix<f64, 9, 9>,
    /// Covariance due to accelerometer noise.
    pub accel_noise: SMatrix<f64, 9, 9>,
}

/// Jacobian of a corrected value with respect to bias (at `bias`) and scale and skew (at `shape`).
fn by_sensor(
    value: &Vector3<f64>,
    shape_inverse: &Matrix3<f64>,
    bias: usize,
    shape: usize,
) -> BySensor {
    let mut out = BySensor::zeros();
    out.fixed_view_mut::<3, 3>(0, bias)
        .copy_from(&-shape_inverse);
    for row in 0..3 {
        for column in 0..3 {
            let by = -shape_inverse.column(row) * value[column];
            out.set_column(shape + 3 * row + column, &by);
        }
    }
    out
}

/// Preintegrates the values at two instants and the samples between them, at least two. `densities`
/// are the noise densities, rad/s/√Hz and m/s²/√Hz.
pub(super) fn preintegrate(
    raw: &[Raw],
    correction: &Correction,
    densities: [f64; 2],
) -> Preintegration {
    let (first, last) = (&raw[0], &raw[raw.len() - 1]);
    let mut turn = Matrix3::identity();
    let mut velocity = Vector3::zeros();
    let mut displacement = Vector3::zeros();
    let mut turn_by = BySensor::zeros();
    let mut velocity_by = BySensor::zeros();
    let mut displacement_by = BySensor::zeros();
    let mut gyro_noise = SMatrix::<f64, 9, 9>::zeros();
    let mut accel_noise = SMatrix::<f64, 9, 9>::zeros();

    let rate_by =
        |w: &Vector3<f64>| by_sensor(w, &correction.gyro_shape_inverse, GYRO_BIAS, GYRO_SHAPE);
    let force_by =
        |a: &Vector3<f64>| by_sensor(a, &correction.accel_shape_inverse, ACCEL_BIAS, ACCEL_SHAPE);
    let mut rate = correction.gyro(first);
    let mut force = correction.accel(first);
    let mut rate_changes = rate_by(&rate);
    // Specific force in the frame of the first instant, and its Jacobian.
    let mut rotated = force;
    let mut rotated_by = force_by(&force);

    for pair in raw.windows(2) {
        let h = pair[1].time_s - pair[0].time_s;
        let next_rate = correction.gyro(&pair[1]);
        let next_force = correction.accel(&pair[1]);
        let next_rate_changes = rate_by(&next_rate);

        let angle = (rate + next_rate) * (0.5 * h) + rate.cross(&next_rate) * (h * h / 12.0);
        let step = so3::exp(&angle);
        let jacobian = so3::right_jacobian(&angle);
        let half = Matrix3::identity() * (0.5 * h);
        let bend = h * h / 12.0;
        let angle_by = (half - next_rate.cross_matrix() * bend) * rate_changes
            + (half + rate.cross_matrix() * bend) * next_rate_changes;
        let next_turn = turn * step;
        let back = step.transpose();
        let next_turn_by = back * turn_by + jacobian * angle_by;
        let next_rotated = next_turn * next_force;
        let lean: Matrix3<f64> = next_turn * next_force.cross_matrix();
        let next_rotated_by = next_turn * force_by(&next_force) - lean * next_turn_by;

        // Noise as constant within a step.
        let mut carry = SMatrix::<f64, 9, 9>::identity();
        carry.fixed_view_mut::<3, 3>(0, 0).copy_from(&back);
        let tilt: Matrix3<f64> = turn * force.cross_matrix();
        let bent: Matrix3<f64> = lean * back;
        let by_turn = -(tilt + bent) * (0.5 * h);
        carry.fixed_view_mut::<3, 3>(3, 0).copy_from(&by_turn);
        let by_turn = -(tilt * 2.0 + bent) * (h * h / 6.0);
        carry.fixed_view_mut::<3, 3>(6, 0).copy_from(&by_turn);
        carry
            .fixed_view_mut::<3, 3>(6, 3)
            .copy_from(&(Matrix3::identity() * h));
        let mut of_rate = SMatrix::<f64, 9, 3>::zeros();
        let of_angle = jacobian * h;
        of_rate.fixed_view_mut::<3, 3>(0, 0).copy_from(&of_angle);
        let leaning = lean * of_angle;
        of_rate
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&(leaning * (-0.5 * h)));
        of_rate
            .fixed_view_mut::<3, 3>(6, 0)
            .copy_from(&(leaning * (-h * h / 6.0)));
        let carried = carry.transpose();
        gyro_noise = carry * gyro_noise * carried
            + of_rate * of_rate.transpose() * (densities[0] * densities[0] / h);
        accel_noise = carry * accel_noise * carried;
        let q = densities[1] * densities[1];
        for k in 0..3 {
            accel_noise[(3 + k, 3 + k)] += q * h;
            accel_noise[(3 + k, 6 + k)] += q * h * h / 2.0;
            accel_noise[(6 + k, 3 + k)] += q * h * h / 2.0;
            accel_noise[(6 + k, 6 + k)] += q * h * h * h / 3.0;
        }

        displacement += velocity * h + (rotated * 2.0 + next_rotated) * (h * h / 6.0);
        displacement_by += velocity_by * h + (rotated_by * 2.0 + next_rotated_by) * (h * h / 6.0);
        velocity += (rotated + next_rotated) * (0.5 * h);
        velocity_by += (rotated_by + next_rotated_by) * (0.5 * h);
        turn = next_turn;
        turn_by = next_turn_by;
        (rate, force, rate_changes) = (next_rate, next_force, next_rate_changes);
        (rotated, rotated_by) = (next_rotated, next_rotated_by);
    }

    let seconds = last.time_s - first.time_s;
    let (start_rate, start_force) = (correction.gyro(first), correction.accel(first));
    let mut by_start = SMatrix::<f64, 9, 1>::zeros();
    by_start
        .fixed_rows_mut::<3>(0)
        .copy_from(&-(turn.transpose() * start_rate));
    by_start
        .fixed_rows_mut::<3>(3)
        .copy_from(&(-start_force - start_rate.cross(&velocity)));
    by_start
        .fixed_rows_mut::<3>(6)
        .copy_from(&(-start_force * seconds - start_rate.cross(&displacement)));
    let mut by_end = SMatrix::<f64, 9, 1>::zeros();
    by_end.fixed_rows_mut::<3>(0).copy_from(&rate);
    by_end.fixed_rows_mut::<3>(3).copy_from(&rotated);
    by_end.fixed_rows_mut::<3>(6).copy_from(&velocity);

    let mut by_sensor = SMatrix::<f64, 9, SENSOR>::zeros();
    by_sensor.fixed_rows_mut::<3>(0).copy_from(&turn_by);
    by_sensor.fixed_rows_mut::<3>(3).copy_from(&velocity_by);
    by_sensor.fixed_rows_mut::<3>(6).copy_from(&displacement_by);
    Preintegration {
        seconds,
        turn,
        velocity,
        displacement,
        by_sensor,
        by_time: [by_start, by_end],
        gyro_noise,
        accel_noise,
    }
}

#[cfg(test)]
mod tests {
    use super::super::ImuSample;
    use super::super::track::Track;
    use super::*;

    /// A lively motion, sampled at `rate_hz`.
    fn track(rate_hz: f64) -> Track {
        let samples: Vec<ImuSample> = (0..(2.0 * rate_hz) as i64)
            .map(|k| {
                let t = k as f64 / rate_hz;
                ImuSample {
                    time_ns: (t * 1e9).round() as i64,
                    gyro: [
                        (3.0 * t).sin(),
                        1.4 * (4.0 * t).cos(),
                        0.7 * (2.0 * t).sin(),
                    ],
                    accel: [3.0 * (5.0 * t).cos(), 1.0 + t, 9.0 + (6.0 * t).sin()],
                }
            })
            .collect();
        Track::new(
            &samples,
            0,
            [f64::INFINITY; 2],
            &super::super::config::SampleConfig::default(),
        )
    }

    fn correction(parameters: &[f64; SENSOR]) -> Correction {
        let shape = |k: usize| {
            let skewed = Matrix3::from_row_slice(&parameters[k..k + 9]) + Matrix3::identity();
            skewed.try_inverse().unwrap()
        };
        Correction {
            gyro_bias: Vector3::from_row_slice(&parameters[0..3]),
            accel_bias: Vector3::from_row_slice(&parameters[3..6]),
            gyro_shape_inverse: shape(GYRO_SHAPE),
            accel_shape_inverse: shape(ACCEL_SHAPE),
        }
    }

    const DENSITIES: [f64; 2] = [1e-4, 1e-3];

    fn of(track: &Track, from_s: f64, to_s: f64, parameters: &[f64; SENSOR]) -> Preintegration {
        let mut raw = Vec::new();
        track.between(from_s, to_s, &mut raw).unwrap();
        preintegrate(&raw, &correction(parameters), DENSITIES)
    }

    fn difference(a: &Preintegration, b: &Preintegration) -> SMatrix<f64, 9, 1> {
        let mut out = SMatrix::<f64, 9, 1>::zeros();
        out.fixed_rows_mut::<3>(0)
            .copy_from(&so3::log(&(a.turn.transpose() * b.turn)));
        out.fixed_rows_mut::<3>(3)
            .copy_from(&(b.velocity - a.velocity));
        out.fixed_rows_mut::<3>(6)
            .copy_from(&(b.displacement - a.displacement));
        out
    }

    fn parameters() -> [f64; SENSOR] {
        std::array::from_fn(|k| 0.01 * ((k * k + 3 * k) as f64).sin())
    }

    #[test]
    fn jacobians_with_respect_to_the_sensor_agree_with_differences() {
        let track = track(400.0);
        let parameters = parameters();
        let found = of(&track, 0.3012, 0.3671, &parameters);
        for k in 0..SENSOR {
            let h = 1e-5;
            let (mut low, mut high) = (parameters, parameters);
            low[k] -= h;
            high[k] += h;
            let by = difference(
                &of(&track, 0.3012, 0.3671, &low),
                &of(&track, 0.3012, 0.3671, &high),
            ) / (2.0 * h);
            let error = (by - found.by_sensor.column(k)).amax();
            assert!(error < 1e-8, "{k}: {error}");
        }
    }

    #[test]
    fn jacobians_with_respect_to_the_instants_agree_with_differences() {
        // Linear interpolation makes steps in the derivatives; they shrink with the sample period.
        let track = track(20_000.0);
        let parameters = parameters();
        let (from, to) = (0.3012, 0.3671);
        let found = of(&track, from, to, &parameters);
        let h = 1e-4;
        let by_start = difference(
            &of(&track, from - h, to, &parameters),
            &of(&track, from + h, to, &parameters),
        ) / (2.0 * h);
        let by_end = difference(
            &of(&track, from, to - h, &parameters),
            &of(&track, from, to + h, &parameters),
        ) / (2.0 * h);
        assert!((by_start - found.by_time[0]).amax() < 1e-6);
        assert!((by_end - found.by_time[1]).amax() < 1e-6);
    }

    #[test]
    fn coarse_samples_approximate_fine_ones() {
        let parameters = parameters();
        let fine = of(&track(20_000.0), 0.25, 0.35, &parameters);
        for (rate_hz, most) in [(200.0, 1e-4), (400.0, 3e-5), (800.0, 1e-5)] {
            let coarse = of(&track(rate_hz), 0.25, 0.35, &parameters);
            let error = difference(&fine, &coarse).amax();
            assert!(error < most, "{rate_hz}: {error}");
        }
    }

    #[test]
    fn noise_covariance_agrees_with_monte_carlo() {
        let parameters = parameters();
        let track = track(400.0);
        let mut raw = Vec::new();
        // Boundaries on samples, so that a sample's weight at an end is half a step.
        track.between(0.3, 0.4, &mut raw).unwrap();
        let correction = correction(&parameters);
        let clean = preintegrate(&raw, &correction, DENSITIES);
        let expected = clean.gyro_noise + clean.accel_noise;
        let draws = 4000;
        let mut sum = SMatrix::<f64, 9, 9>::zeros();
        let mut random = super::super::simulate::Random::new(3);
        for _ in 0..draws {
            let mut noisy = raw.clone();
            for sample in &mut noisy {
                for k in 0..3 {
                    sample.gyro[k] += random.normal() * DENSITIES[0] * 20.0;
                    sample.accel[k] += random.normal() * DENSITIES[1] * 20.0;
                }
            }
            let d = difference(&clean, &preintegrate(&noisy, &correction, DENSITIES));
            sum += d * d.transpose() / f64::from(draws);
        }
        for k in 0..9 {
            let ratio = sum[(k, k)] / expected[(k, k)];
            assert!((ratio - 1.0).abs() < 0.1, "{k}: {ratio}");
        }
    }
}
