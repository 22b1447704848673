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
    /// Whether gyroscope and accelerometer were saturated.
    pub(crate) saturated: [bool; 2],
}

/// Indices of pairs of the two sensors of an IMU.
pub(crate) const GYROSCOPE: usize = 0;
const ACCELEROMETER: usize = 1;

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
    /// The accelerometer was saturated.
    GyroscopeOnly,
    /// The gyroscope was saturated.
    AccelerometerOnly,
    /// Samples are missing, or both sensors were saturated.
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
            saturated: [
                at_end(&sample.gyro, range[GYROSCOPE]),
                at_end(&sample.accel, range[ACCELEROMETER]),
            ],
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
                    reading.saturated[k / 3] = true;
                }
            }
            if value.abs() >= 0.999 * self.saturation_levels[k] {
                self.readings[count - 1].saturated[k / 3] = true;
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
    /// is interpolated and the result is [`Coverage::Gap`]; it is empty without samples. A sensor
    /// that was saturated in any of them does not count.
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
        let is_saturated = |sensor: usize| out.iter().any(|r| r.saturated[sensor]);
        match (whole, is_saturated(GYROSCOPE), is_saturated(ACCELEROMETER)) {
            (true, false, false) => Coverage::Complete,
            (true, false, true) => Coverage::GyroscopeOnly,
            (true, true, false) => Coverage::AccelerometerOnly,
            (true, true, true) | (false, ..) => Coverage::Gap,
        }
    }

    /// Start of the samples without gaps or saturation up to a time; `None` without samples.
    pub(crate) fn continuous_since(&self, until_ns: i64) -> Option<i64> {
        let end = self.readings.partition_point(|r| r.time_ns <= until_ns);
        let mut since = until_ns;
        for reading in self.readings.range(..end).rev() {
            if reading.saturated != [false; 2] || since - reading.time_ns > self.gap_ns {
                break;
            }
            since = reading.time_ns;
        }
        (end > 0).then_some(since)
    }

    /// Time since the last sample up to a time, ns; `None` without one.
    pub(crate) fn silence_ns(&self, time_ns: i64) -> Option<i64> {
        let end = self.readings.partition_point(|r| r.time_ns <= time_ns);
        end.checked_sub(1)
            .map(|last| time_ns - self.readings[last].time_ns)
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
            saturated: [0, 1].map(|sensor| a.saturated[sensor] || b.saturated[sensor]),
        };
        Some((reading, b.time_ns - a.time_ns <= self.gap_ns))
    }
}

/// An IMU that is not at the origin of the body frame but has its axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LeverArm {
    /// Position of the IMU in the body frame, m.
    pub(crate) arm: Vector3<f64>,
    /// Angular rates at the first and the last instant without bias, rad/s.
    pub(crate) rates: [Vector3<f64>; 2],
    /// Their white noise, rad/s.
    pub(crate) rate_sigma: f64,
    /// Their relative error.
    pub(crate) scale_error: f64,
}

/// Components of a preintegrated motion: rotation, velocity, displacement.
pub(crate) type Nine = SMatrix<f64, 9, 1>;

/// Preintegrated motion.
#[derive(Clone, Debug)]
pub(crate) struct Preintegration {
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
    /// Jacobian of the nine components by the scale errors of the gyroscope, in sigmas.
    pub(crate) by_gyro_scale: SMatrix<f64, 9, 3>,
    /// Covariance of the nine components.
    pub(crate) covariance: SMatrix<f64, 9, 9>,
    /// Biases of the linearization point.
    pub(crate) gyro_bias: Vector3<f64>,
    pub(crate) accel_bias: Vector3<f64>,
}

impl Preintegration {
    /// Preintegrates at least two samples.
    pub(crate) fn new(
        readings: &[Reading],
        gyro_bias: &Vector3<f64>,
        accel_bias: &Vector3<f64>,
        noise: &ImuNoise,
        config: &InertialConfig,
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
        // Relative errors are proportional to the measured motion and persist: their sigma is added
        // for the whole motion.
        let angle = so3::log(&rotation);
        let [gyro, accel] = config.relative_error;
        let systematic_error = [
            gyro * angle.norm(),
            accel * velocity.norm(),
            accel * displacement.norm(),
        ];
        for k in 0..9 {
            covariance[(k, k)] += systematic_error[k / 3] * systematic_error[k / 3];
        }
        let (first, last) = (&readings[0], &readings[readings.len() - 1]);
        let seconds = (last.time_ns - first.time_ns) as f64 * 1e-9;
        // A scale error acts as a bias that is proportional to the mean rate.
        let mean_rate = angle / seconds.max(1e-6);
        let by_gyro_bias = by_bias.fixed_columns::<3>(0);
        let by_sigma = mean_rate * config.gyro_scale_sigma;
        let by_gyro_scale = by_gyro_bias * Matrix3::from_diagonal(&by_sigma);
        Self {
            seconds,
            rotation,
            velocity,
            displacement,
            by_bias,
            by_gyro_scale,
            covariance,
            gyro_bias: *gyro_bias,
            accel_bias: *accel_bias,
        }
    }

    /// Whether it has the rotation of a gyroscope.
    pub(crate) fn has_gyroscope(&self) -> bool {
        self.by_bias.fixed_view::<3, 3>(0, 0).amax() > 0.0
    }

    /// The motion of the origin of the body frame from that of an IMU elsewhere in it.
    ///
    /// With the arm `r`, the rotation `R` and the rates `a`, `b` at both ends, the position of the
    /// IMU is `p + R r` and its velocity `v + R (w x r)`, so that the displacement becomes
    /// `d + r + (a x r) t - R r` and the velocity change `v + a x r - R (b x r)`. The noise of the
    /// rates at the ends is added as if it were independent of the rotation and of the motions
    /// before and after.
    pub(crate) fn at_body_origin(mut self, lever: &LeverArm) -> Self {
        let (t, arm, [first, last]) = (self.seconds, lever.arm, lever.rates);
        let rotation = self.rotation.to_rotation_matrix().into_inner();
        self.displacement += arm + first.cross(&arm) * t - rotation * arm;
        self.velocity += first.cross(&arm) - rotation * last.cross(&arm);
        // By the error of the rotation, and by those of the rates.
        let mut transfer = SMatrix::<f64, 9, 9>::identity();
        let mut set = |row: usize, block: Matrix3<f64>| {
            transfer.fixed_view_mut::<3, 3>(row, 0).copy_from(&block);
        };
        set(3, rotation * last.cross(&arm).cross_matrix());
        set(6, rotation * arm.cross_matrix());
        let (mut by_first, mut by_last) =
            (SMatrix::<f64, 9, 3>::zeros(), SMatrix::<f64, 9, 3>::zeros());
        let cross = arm.cross_matrix();
        by_first.fixed_view_mut::<3, 3>(3, 0).copy_from(&-cross);
        by_first
            .fixed_view_mut::<3, 3>(6, 0)
            .copy_from(&(-cross * t));
        by_last
            .fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&(rotation * cross));
        self.covariance = transfer * self.covariance * transfer.transpose();
        for (by_rate, rate) in [(by_first, first), (by_last, last)] {
            let variance = lever.rate_sigma.powi(2) + (lever.scale_error * rate.norm()).powi(2);
            self.covariance += by_rate * by_rate.transpose() * variance;
        }
        self.by_bias = transfer * self.by_bias;
        self.by_gyro_scale = transfer * self.by_gyro_scale;
        let mut by_gyro_bias = self.by_bias.fixed_columns_mut::<3>(0);
        by_gyro_bias -= by_first + by_last;
        self
    }

    /// Rotation, velocity and displacement for other biases and scale errors, to first order.
    pub(crate) fn corrected(
        &self,
        gyro_bias: &Vector3<f64>,
        accel_bias: &Vector3<f64>,
        gyro_scale: &Vector3<f64>,
    ) -> (UnitQuaternion<f64>, Vector3<f64>, Vector3<f64>) {
        let mut change = SMatrix::<f64, 6, 1>::zeros();
        change
            .fixed_rows_mut::<3>(0)
            .copy_from(&(gyro_bias - self.gyro_bias));
        change
            .fixed_rows_mut::<3>(3)
            .copy_from(&(accel_bias - self.accel_bias));
        let nine: Nine = self.by_bias * change + self.by_gyro_scale * gyro_scale;
        (
            self.rotation * so3::exp(nine.fixed_rows::<3>(0).into_owned()),
            self.velocity + nine.fixed_rows::<3>(3),
            self.displacement + nine.fixed_rows::<3>(6),
        )
    }
}

#[cfg(test)]
mod tests;
