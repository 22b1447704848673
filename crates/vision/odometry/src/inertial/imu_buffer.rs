//! IMU sample buffer and preintegration.
//!
//! On-manifold preintegration (Forster, Carlone, Dellaert and Scaramuzza, On-Manifold
//! Preintegration for Real-Time Visual-Inertial Odometry, 2017): rotation, velocity change and
//! displacement in the frame of the first instant, without gravity and initial velocity, with their
//! covariance and their Jacobians by the biases, so that biases can change without a new
//! integration. Rate and specific force are linearly interpolated between samples.

use std::collections::VecDeque;

use camera_models::ImuNoise;
use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector3};

use crate::config::InertialConfig;
use cad_transforms::so3;
use camera_models::ImuSample;

/// IMU sample with its time, ns: angular rate in rad/s, specific force in m/s².
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reading {
    pub(crate) time_ns: i64,
    pub(crate) gyro: Vector3<f64>,
    pub(crate) accel: Vector3<f64>,
    /// Whether the sensor was saturated.
    pub(crate) saturated: bool,
}

/// Recent samples, in order of time.
#[derive(Clone, Debug)]
pub(crate) struct ImuBuffer {
    config: InertialConfig,
    readings: VecDeque<Reading>,
    /// Maximum interval between samples without a gap, ns.
    gap_ns: i64,
    /// Per axis, gyroscope first: number of identical consecutive samples, and estimated saturation
    /// level.
    same: [usize; 6],
    saturation_levels: [f64; 6],
}

/// Coverage of an interval by samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Coverage {
    /// Samples without a gap.
    Complete,
    /// Samples are missing.
    Gap,
}

impl ImuBuffer {
    /// Creates the buffer of an IMU with this nominal rate, Hz.
    pub(crate) fn new(config: &InertialConfig, rate_hz: f64) -> Self {
        Self {
            config: *config,
            readings: VecDeque::new(),
            gap_ns: (config.max_interval_ratio * 1e9 / rate_hz) as i64,
            same: [0; 6],
            saturation_levels: [f64::INFINITY; 6],
        }
    }

    /// Adds a sample; one that is not later than the last, or not finite, is dropped.
    pub(crate) fn push(&mut self, sample: &ImuSample, range: [f64; 2]) {
        let is_late = (self.readings.back()).is_some_and(|last| last.time_ns >= sample.time_ns);
        let mut numbers = sample.gyro.iter().chain(&sample.accel);
        if is_late || !numbers.all(|v| v.is_finite()) {
            return;
        }
        let range_ratio = self.config.saturation.range_ratio;
        let at_end =
            |values: &[f64; 3], range: f64| values.iter().any(|v| v.abs() >= range_ratio * range);
        self.readings.push_back(Reading {
            time_ns: sample.time_ns,
            gyro: sample.gyro.into(),
            accel: sample.accel.into(),
            saturated: at_end(&sample.gyro, range[0]) || at_end(&sample.accel, range[1]),
        });
        self.detect_saturation();
    }

    /// Marks saturation below the nominal range: an axis with constant samples at a value that it
    /// cannot have at rest.
    fn detect_saturation(&mut self) {
        let config = self.config.saturation;
        let count = self.readings.len();
        let axis = |reading: &Reading, k: usize| match k {
            0..3 => reading.gyro[k],
            _ => reading.accel[k - 3],
        };
        for k in 0..6 {
            let value = axis(&self.readings[count - 1], k);
            let before = count.checked_sub(2).map(|i| axis(&self.readings[i], k));
            let may_end = value.abs() >= config.min_level[k / 3];
            let min_run = match value.abs() < config.moving_threshold[k / 3] {
                true => config.stuck_samples,
                false => config.stuck_samples_moving[k / 3],
            };
            // With noise, identical consecutive samples are unlikely, and long runs of them much
            // more so.
            self.same[k] = match before {
                Some(before) if may_end && before.to_bits() == value.to_bits() => self.same[k] + 1,
                _ => 0,
            };
            if value.abs() > 1.01 * self.saturation_levels[k] {
                self.saturation_levels[k] = f64::INFINITY;
            }
            if self.same[k] + 1 >= min_run {
                self.saturation_levels[k] = value.abs();
                for reading in self.readings.iter_mut().rev().take(self.same[k] + 1) {
                    reading.saturated = true;
                }
            }
            if value.abs() >= 0.999 * self.saturation_levels[k] {
                self.readings[count - 1].saturated = true;
            }
        }
    }

    /// Drops samples before a time, except the last one before it.
    pub(crate) fn forget_before(&mut self, time_ns: i64) {
        while self.readings.len() > 1 && self.readings[1].time_ns <= time_ns {
            self.readings.pop_front();
        }
    }

    /// Samples of an interval, with interpolated ones at both ends. If samples are missing, the gap
    /// is interpolated and the result is [`Coverage::Gap`]; it is empty without samples.
    pub(crate) fn between(&self, from_ns: i64, to_ns: i64, out: &mut Vec<Reading>) -> Coverage {
        out.clear();
        let first = self.readings.partition_point(|r| r.time_ns <= from_ns);
        let end = self.readings.partition_point(|r| r.time_ns < to_ns);
        let (Some(start), Some(stop)) = (self.at(from_ns), self.at(to_ns)) else {
            return Coverage::Gap;
        };
        out.push(start.0);
        out.extend(self.readings.range(first..end.max(first)).copied());
        out.push(stop.0);
        let lo = first.saturating_sub(1);
        let hi = (end + 1).min(self.readings.len());
        let mut whole = start.1 && stop.1;
        for k in lo + 1..hi {
            whole &= self.readings[k].time_ns - self.readings[k - 1].time_ns <= self.gap_ns;
        }
        whole &= !out.iter().any(|r| r.saturated);
        if whole {
            Coverage::Complete
        } else {
            Coverage::Gap
        }
    }

    /// Start of the samples without gaps or saturation up to a time; `None` without samples.
    pub(crate) fn continuous_since(&self, until_ns: i64) -> Option<i64> {
        let end = self.readings.partition_point(|r| r.time_ns <= until_ns);
        let mut since = until_ns;
        for reading in self.readings.range(..end).rev() {
            if reading.saturated || since - reading.time_ns > self.gap_ns {
                break;
            }
            since = reading.time_ns;
        }
        (end > 0).then_some(since)
    }

    /// Time of the newest sample, ns.
    pub(crate) fn last_ns(&self) -> Option<i64> {
        self.readings.back().map(|r| r.time_ns)
    }

    /// Interpolated sample at a time, and whether its neighbors are near. The last sample is held
    /// for up to the maximum interval.
    pub(crate) fn at(&self, time_ns: i64) -> Option<(Reading, bool)> {
        let next = self.readings.partition_point(|r| r.time_ns < time_ns);
        let test_rig = |r: &Reading| Reading { time_ns, ..*r };
        if next == self.readings.len() {
            let last = self.readings.back()?;
            let near = time_ns - last.time_ns <= self.gap_ns;
            return Some((test_rig(last), near));
        }
        let b = &self.readings[next];
        if b.time_ns == time_ns {
            return Some((*b, true));
        }
        if next == 0 {
            let near = b.time_ns - time_ns <= self.gap_ns;
            return Some((test_rig(b), near));
        }
        let a = &self.readings[next - 1];
        let t = (time_ns - a.time_ns) as f64 / (b.time_ns - a.time_ns) as f64;
        let reading = Reading {
            time_ns,
            gyro: a.gyro.lerp(&b.gyro, t),
            accel: a.accel.lerp(&b.accel, t),
            saturated: a.saturated || b.saturated,
        };
        Some((reading, b.time_ns - a.time_ns <= self.gap_ns))
    }
}

/// Components of a preintegrated motion: rotation, velocity, displacement.
pub(crate) type Nine = SMatrix<f64, 9, 1>;

/// Preintegrated motion.
#[derive(Clone, Debug)]
pub(crate) struct Preintegrated {
    pub(crate) seconds: f64,
    /// Rotation: first from last body frame.
    pub(crate) rotation: UnitQuaternion<f64>,
    /// Velocity change, m/s.
    pub(crate) velocity: Vector3<f64>,
    /// Displacement, m.
    pub(crate) displacement: Vector3<f64>,
    /// Jacobians of the nine components by the biases of gyroscope and accelerometer; that of the
    /// rotation as a small rotation on its right.
    pub(crate) by_bias: SMatrix<f64, 9, 6>,
    /// Covariance of the nine components.
    pub(crate) covariance: SMatrix<f64, 9, 9>,
    /// Biases of the linearization point.
    pub(crate) gyro_bias: Vector3<f64>,
    pub(crate) accel_bias: Vector3<f64>,
}

impl Preintegrated {
    /// Preintegrates at least two samples.
    pub(crate) fn new(
        readings: &[Reading],
        gyro_bias: &Vector3<f64>,
        accel_bias: &Vector3<f64>,
        noise: &ImuNoise,
        scale_error: &[f64; 2],
    ) -> Self {
        let mut rotation = UnitQuaternion::identity();
        let (mut velocity, mut displacement) = (Vector3::zeros(), Vector3::zeros());
        let mut rotation_by_bias = Matrix3::<f64>::zeros();
        let mut velocity_by = SMatrix::<f64, 3, 6>::zeros();
        let mut displacement_by = SMatrix::<f64, 3, 6>::zeros();
        let mut covariance = SMatrix::<f64, 9, 9>::zeros();
        let (gyro_q, accel_q) = (
            noise.gyro_noise_density.powi(2),
            noise.accel_noise_density.powi(2),
        );
        for pair in readings.windows(2) {
            let h = (pair[1].time_ns - pair[0].time_ns) as f64 * 1e-9;
            if h <= 0.0 {
                continue;
            }
            let rate = (pair[0].gyro + pair[1].gyro) * 0.5 - gyro_bias;
            let angle = rate * h;
            let step = so3::exp(angle);
            let jacobian = so3::right_jacobian(&angle);
            let next_rotation = rotation * step;
            let (r0, r1) = (
                rotation.to_rotation_matrix().into_inner(),
                next_rotation.to_rotation_matrix().into_inner(),
            );
            let (f0, f1) = (pair[0].accel - accel_bias, pair[1].accel - accel_bias);
            let (a0, a1) = (r0 * f0, r1 * f1);
            let back = step.inverse().to_rotation_matrix().into_inner();

            let next_rotation_by_bias = back * rotation_by_bias - jacobian * h;
            let mut force_by = SMatrix::<f64, 3, 6>::zeros();
            let by_gyro = -(r0 * f0.cross_matrix() * rotation_by_bias
                + r1 * f1.cross_matrix() * next_rotation_by_bias);
            force_by
                .fixed_columns_mut::<3>(0)
                .copy_from(&(by_gyro * 0.5));
            force_by
                .fixed_columns_mut::<3>(3)
                .copy_from(&(-(r0 + r1) * 0.5));
            displacement_by += velocity_by * h + force_by * (0.5 * h * h);
            velocity_by += force_by * h;
            rotation_by_bias = next_rotation_by_bias;

            // Noise, constant within a step; rows rotation, velocity, displacement.
            let mut transfer = SMatrix::<f64, 9, 9>::identity();
            transfer.fixed_view_mut::<3, 3>(0, 0).copy_from(&back);
            let lean = -(r0 * f0.cross_matrix() + r1 * f1.cross_matrix() * back) * 0.5;
            transfer.fixed_view_mut::<3, 3>(3, 0).copy_from(&(lean * h));
            transfer
                .fixed_view_mut::<3, 3>(6, 0)
                .copy_from(&(lean * (0.5 * h * h)));
            transfer
                .fixed_view_mut::<3, 3>(6, 3)
                .copy_from(&(Matrix3::identity() * h));
            covariance = transfer * covariance * transfer.transpose();
            for k in 0..3 {
                covariance[(k, k)] += gyro_q * h;
                covariance[(3 + k, 3 + k)] += accel_q * h;
                covariance[(3 + k, 6 + k)] += accel_q * h * h / 2.0;
                covariance[(6 + k, 3 + k)] += accel_q * h * h / 2.0;
                covariance[(6 + k, 6 + k)] += accel_q * h * h * h / 3.0;
            }

            displacement += velocity * h + (a0 * 2.0 + a1) * (h * h / 6.0);
            velocity += (a0 + a1) * (0.5 * h);
            rotation = next_rotation;
        }
        let mut by_bias = SMatrix::<f64, 9, 6>::zeros();
        by_bias
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&rotation_by_bias);
        by_bias.fixed_view_mut::<3, 6>(3, 0).copy_from(&velocity_by);
        by_bias
            .fixed_view_mut::<3, 6>(6, 0)
            .copy_from(&displacement_by);
        // Scale and misalignment errors are proportional to the measured motion and persist: their
        // sigma is added for the whole motion.
        let angle = so3::log(&rotation).norm();
        let systematic_error = [
            scale_error[0] * angle,
            scale_error[1] * velocity.norm(),
            scale_error[1] * displacement.norm(),
        ];
        for k in 0..9 {
            covariance[(k, k)] += systematic_error[k / 3] * systematic_error[k / 3];
        }
        let (first, last) = (&readings[0], &readings[readings.len() - 1]);
        Self {
            seconds: (last.time_ns - first.time_ns) as f64 * 1e-9,
            rotation,
            velocity,
            displacement,
            by_bias,
            covariance,
            gyro_bias: *gyro_bias,
            accel_bias: *accel_bias,
        }
    }

    /// Rotation, velocity and displacement for other biases, to first order.
    pub(crate) fn bias_corrected(
        &self,
        gyro_bias: &Vector3<f64>,
        accel_bias: &Vector3<f64>,
    ) -> (UnitQuaternion<f64>, Vector3<f64>, Vector3<f64>) {
        let mut change = SMatrix::<f64, 6, 1>::zeros();
        change
            .fixed_rows_mut::<3>(0)
            .copy_from(&(gyro_bias - self.gyro_bias));
        change
            .fixed_rows_mut::<3>(3)
            .copy_from(&(accel_bias - self.accel_bias));
        let nine: Nine = self.by_bias * change;
        (
            self.rotation * so3::exp(nine.fixed_rows::<3>(0).into_owned()),
            self.velocity + nine.fixed_rows::<3>(3),
            self.displacement + nine.fixed_rows::<3>(6),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE: ImuNoise = ImuNoise {
        gyro_noise_density: 1e-3,
        gyro_random_walk: 1e-5,
        accel_noise_density: 1e-2,
        accel_random_walk: 1e-4,
    };

    fn readings(rate_hz: f64, seconds: f64) -> Vec<Reading> {
        (0..=(seconds * rate_hz) as i64)
            .map(|k| {
                let t = k as f64 / rate_hz;
                Reading {
                    time_ns: (t * 1e9).round() as i64,
                    gyro: Vector3::new((3.0 * t).sin(), 1.4 * (4.0 * t).cos(), (2.0 * t).sin()),
                    accel: Vector3::new(3.0 * (5.0 * t).cos(), 1.0 + t, 9.0 + (6.0 * t).sin()),
                    saturated: false,
                }
            })
            .collect()
    }

    fn nine(a: &Preintegrated, b: &Preintegrated) -> Nine {
        let mut out = Nine::zeros();
        out.fixed_rows_mut::<3>(0)
            .copy_from(&so3::log(&(a.rotation.inverse() * b.rotation)));
        out.fixed_rows_mut::<3>(3)
            .copy_from(&(b.velocity - a.velocity));
        out.fixed_rows_mut::<3>(6)
            .copy_from(&(b.displacement - a.displacement));
        out
    }

    #[test]
    fn constant_samples_of_a_moving_axis_are_saturated() {
        let range = [10.0, 80.0];
        let clip = |limit: f64| {
            let mut samples = ImuBuffer::new(&InertialConfig::default(), 400.0);
            let mut saturated = Vec::new();
            for k in 0..400_i64 {
                let t = k as f64 / 400.0;
                let gyro = [(2.0 * (9.0 * t).sin()).clamp(-limit, limit), 0.1, 0.0];
                // Gravity with noise in the last digit.
                let sample = ImuSample {
                    time_ns: k,
                    gyro: [gyro[0], gyro[1] + 1e-3 * (k % 3) as f64, gyro[2]],
                    accel: [0.0, 0.0, 9.8 + 0.002 * (k % 7 / 3) as f64],
                };
                samples.push(&sample, range);
            }
            saturated.extend(samples.readings.iter().map(|r| r.saturated));
            let beyond = |r: &Reading| (2.0 * (9.0 * r.time_ns as f64 / 400.0).sin()).abs() > limit;
            let all = samples.readings.iter().filter(|r| beyond(r)).count();
            (all, saturated.iter().filter(|c| **c).count())
        };
        let (all, found) = clip(1.0);
        assert!(all > 200 && found.abs_diff(all) < 8, "{found} of {all}");
        // At rest samples repeat.
        assert_eq!(clip(5.0), (0, 0));
    }

    #[test]
    fn gravity_beyond_the_range_is_saturated() {
        let saturated = |limit: f64| {
            let mut samples = ImuBuffer::new(&InertialConfig::default(), 100.0);
            for k in 0..200_i64 {
                // Gravity with noise, with a tilted axis.
                let noise = 0.02 * ((k * k % 17) as f64 / 8.0 - 1.0);
                let accel = [1.8 + noise, 0.2 - noise, 9.6 + noise];
                samples.push(
                    &ImuSample {
                        time_ns: k,
                        gyro: [0.0; 3],
                        accel: accel.map(|a| a.clamp(-limit, limit)),
                    },
                    [10.0, 80.0],
                );
            }
            samples.readings.iter().filter(|r| r.saturated).count()
        };
        assert_eq!(saturated(80.0), 0);
        assert!(saturated(1.5) >= 199, "{}", saturated(1.5));
    }

    #[test]
    fn bias_jacobians_equal_finite_differences() {
        let readings = readings(400.0, 0.2);
        let (bg, ba) = (
            Vector3::new(0.01, -0.02, 0.03),
            Vector3::new(0.1, 0.2, -0.1),
        );
        let here = Preintegrated::new(
            &readings,
            &bg,
            &ba,
            &NOISE,
            &InertialConfig::default().scale_error,
        );
        for k in 0..6 {
            let h = 1e-5;
            let mut d = SMatrix::<f64, 6, 1>::zeros();
            d[k] = h;
            let (dg, da) = (
                d.fixed_rows::<3>(0).into_owned(),
                d.fixed_rows::<3>(3).into_owned(),
            );
            let there = Preintegrated::new(
                &readings,
                &(bg + dg),
                &(ba + da),
                &NOISE,
                &InertialConfig::default().scale_error,
            );
            let by = nine(&here, &there) / h;
            // The mean of the rotated force at both ends approximates a 2 : 1 weighting in the
            // displacement.
            assert!((by - here.by_bias.column(k)).amax() < 2e-4, "{k}");
            let (rotation, velocity, displacement) = here.bias_corrected(&(bg + dg), &(ba + da));
            assert!(rotation.angle_to(&there.rotation) < 1e-9);
            assert!((velocity - there.velocity).norm() < 1e-8);
            assert!((displacement - there.displacement).norm() < 1e-8);
        }
    }

    #[test]
    fn preintegration_converges_with_the_sample_rate() {
        let zero = Vector3::zeros();
        let fine = Preintegrated::new(
            &readings(20_000.0, 0.2),
            &zero,
            &zero,
            &NOISE,
            &InertialConfig::default().scale_error,
        );
        for (rate_hz, limit) in [(200.0, 2e-4), (800.0, 2e-5)] {
            let coarse = Preintegrated::new(
                &readings(rate_hz, 0.2),
                &zero,
                &zero,
                &NOISE,
                &InertialConfig::default().scale_error,
            );
            let systematic_error = nine(&fine, &coarse).amax();
            assert!(systematic_error < limit, "{rate_hz}: {systematic_error}");
        }
    }

    #[test]
    fn sample_that_is_not_finite_is_dropped() {
        let mut samples = ImuBuffer::new(&InertialConfig::default(), 100.0);
        for k in 0..20 {
            let mut sample = ImuSample {
                time_ns: k * 10_000_000,
                gyro: [0.01 * k as f64, 0.0, 0.0],
                accel: [0.0, 0.0, 9.8 + 1e-3 * k as f64],
            };
            match k {
                5 => sample.gyro[1] = f64::NAN,
                9 => sample.accel[2] = f64::INFINITY,
                _ => {}
            }
            samples.push(&sample, [f64::INFINITY; 2]);
        }
        let mut out = Vec::new();
        assert_eq!(
            samples.between(0, 190_000_000, &mut out),
            Coverage::Complete
        );
        assert_eq!(out.len(), 18);
        assert!(out.iter().all(|r| r.gyro.y == 0.0 && r.accel.z < 9.9));
    }

    #[test]
    fn gap_and_end_of_samples_are_reported() {
        let mut samples = ImuBuffer::new(&InertialConfig::default(), 100.0);
        for k in (0..50).chain(80..100) {
            let sample = ImuSample {
                time_ns: k * 10_000_000,
                gyro: [k as f64, 0.0, 0.0],
                accel: [0.0; 3],
            };
            samples.push(&sample, [f64::INFINITY; 2]);
        }
        let mut out = Vec::new();
        assert_eq!(
            samples.between(105_000_000, 305_000_000, &mut out),
            Coverage::Complete
        );
        assert_eq!(out.len(), 22);
        assert!((out[0].gyro.x - 10.5).abs() < 1e-9 && (out[21].gyro.x - 30.5).abs() < 1e-9);
        assert_eq!(
            samples.between(400_000_000, 850_000_000, &mut out),
            Coverage::Gap
        );
        assert_eq!(
            samples.between(900_000_000, 1_200_000_000, &mut out),
            Coverage::Gap
        );
    }
}
