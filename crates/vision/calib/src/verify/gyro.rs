//! Gyroscope samples as rotations between any two times.
//!
//! Contract: the rate is interpolated linearly between samples. Beyond the ends and across gaps
//! longer than the maximum gap the result is `None`.

use cad_transforms::so3;
use nalgebra::{UnitQuaternion, Vector3};

use super::robust::median;

/// Samples of a gyroscope, in order of time.
#[derive(Clone, Debug, Default)]
pub struct Gyro {
    times_ns: Vec<i64>,
    /// rad/s.
    rates: Vec<Vector3<f64>>,
}

/// A gyroscope with its bias removed, integrated.
#[derive(Clone, Debug)]
pub(super) struct IntegratedGyro<'a> {
    gyro: &'a Gyro,
    scale: Vector3<f64>,
    bias: Vector3<f64>,
    /// Maximum interval between two samples, s.
    max_gap_s: f64,
    /// `start_from_imu` at each sample.
    start_from_imu: Vec<UnitQuaternion<f64>>,
    /// Integral of the rates since the start, rad, for quantities that are linear in them.
    sums: Vec<Vector3<f64>>,
}

impl Gyro {
    /// Samples with times in ns and rates in rad/s in the frame of the IMU. Samples that are not
    /// finite, or whose time does not increase, are dropped.
    pub fn new(samples: impl IntoIterator<Item = (i64, [f64; 3])>) -> Self {
        let mut new = Self::default();
        for (time_ns, rate) in samples {
            let rises = new.times_ns.last().is_none_or(|last| time_ns > *last);
            if rises && rate.iter().all(|v| v.is_finite()) {
                new.times_ns.push(time_ns);
                new.rates.push(Vector3::from(rate));
            }
        }
        new
    }

    /// First and last time, ns.
    pub fn span_ns(&self) -> Option<[i64; 2]> {
        Some([*self.times_ns.first()?, *self.times_ns.last()?])
    }

    /// The same samples, stamped later by `ns`.
    #[must_use]
    pub fn shifted_by_ns(&self, ns: i64) -> Self {
        Self {
            times_ns: self.times_ns.iter().map(|t| t + ns).collect(),
            rates: self.rates.clone(),
        }
    }

    /// Noise standard deviation of a sample, rad/s, from the second differences of consecutive
    /// samples. The motion of a body is slow against it; the median rejects steps.
    pub(super) fn noise(&self) -> f64 {
        let bend = |w: &[Vector3<f64>]| {
            (w[0] - w[1] * 2.0 + w[2])
                .iter()
                .map(|v| v.abs())
                .sum::<f64>()
                / 3.0
        };
        let mut bends: Vec<f64> = self.rates.windows(3).map(bend).collect();
        // The mean of three absolute normal values has its median near their mean, 0.798; the
        // variance of a second difference is 6.
        median(&mut bends) / (0.798 * 6.0_f64.sqrt())
    }

    /// Samples from one time to another, ns.
    pub fn between_ns(&self, from: i64, to: i64) -> impl Iterator<Item = (i64, Vector3<f64>)> + '_ {
        let first = self.times_ns.partition_point(|t| *t < from);
        let last = self.times_ns.partition_point(|t| *t <= to);
        (first..last.max(first)).map(|i| (self.times_ns[i], self.rates[i]))
    }

    /// Integrates `scale * rate - bias`, per axis. Intervals above `max_gap_s` are gaps.
    pub(super) fn integrate(
        &self,
        scale: Vector3<f64>,
        bias: Vector3<f64>,
        max_gap_s: f64,
    ) -> IntegratedGyro<'_> {
        let count = self.rates.len();
        let (mut attitudes, mut sums) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let (mut attitude, mut sum) = (UnitQuaternion::identity(), Vector3::zeros());
        for i in 0..count {
            if i > 0 {
                let dt = (self.times_ns[i] - self.times_ns[i - 1]) as f64 * 1e-9;
                let angle =
                    (0.5 * (self.rates[i] + self.rates[i - 1]).component_mul(&scale) - bias) * dt;
                attitude = UnitQuaternion::new_normalize((attitude * so3::exp(angle)).into_inner());
                sum += angle;
            }
            attitudes.push(attitude);
            sums.push(sum);
        }
        IntegratedGyro {
            gyro: self,
            scale,
            bias,
            max_gap_s,
            start_from_imu: attitudes,
            sums,
        }
    }
}

impl IntegratedGyro<'_> {
    /// The sample before a time, and the remaining time, s; `None` where nothing is known.
    fn before(&self, time_ns: f64) -> Option<(usize, f64)> {
        let times = &self.gyro.times_ns;
        let next = times.partition_point(|t| (*t as f64) <= time_ns);
        let (i, next) = (next.checked_sub(1)?, next.min(times.len() - 1));
        let gap_s = (times[next] - times[i]) as f64 * 1e-9;
        let rest_s = (time_ns - times[i] as f64) * 1e-9;
        (gap_s <= self.max_gap_s && rest_s <= gap_s).then_some((i, rest_s))
    }

    /// Rotation since sample `i`.
    fn rotation_after(&self, i: usize, rest_s: f64) -> Vector3<f64> {
        (self.rate_after(i, 0.5 * rest_s)) * rest_s
    }

    fn rate_after(&self, i: usize, rest_s: f64) -> Vector3<f64> {
        let (times, rates) = (&self.gyro.times_ns, &self.gyro.rates);
        let rate = match rates.get(i + 1) {
            Some(next) => {
                let part = rest_s * 1e9 / (times[i + 1] - times[i]) as f64;
                rates[i].lerp(next, part)
            }
            None => rates[i],
        };
        rate.component_mul(&self.scale) - self.bias
    }

    /// Angular rate without the bias, rad/s, in the frame of the IMU.
    pub(super) fn rate(&self, time_ns: f64) -> Option<Vector3<f64>> {
        let (i, rest_s) = self.before(time_ns)?;
        Some(self.rate_after(i, rest_s))
    }

    /// Takes directions in the IMU's frame at one time to the one at another.
    pub(super) fn to_from(&self, to_ns: f64, from_ns: f64) -> Option<UnitQuaternion<f64>> {
        let attitude = |time_ns: f64| {
            let (i, rest_s) = self.before(time_ns)?;
            let rest = so3::exp(self.rotation_after(i, rest_s));
            Some(self.start_from_imu[i] * rest)
        };
        self.is_continuous(from_ns, to_ns)
            .then(|| Some(attitude(to_ns)?.inverse() * attitude(from_ns)?))?
    }

    /// Integral of the rates between two times, rad: not a rotation, but linear in the rates.
    pub(super) fn sum(&self, from_ns: f64, to_ns: f64) -> Option<Vector3<f64>> {
        let until = |time_ns: f64| {
            let (i, rest_s) = self.before(time_ns)?;
            Some(self.sums[i] + self.rotation_after(i, rest_s))
        };
        self.is_continuous(from_ns, to_ns)
            .then(|| Some(until(to_ns)? - until(from_ns)?))?
    }

    /// Whether there is no gap between two times.
    fn is_continuous(&self, a_ns: f64, b_ns: f64) -> bool {
        let (from, to) = (a_ns.min(b_ns), a_ns.max(b_ns));
        let times = &self.gyro.times_ns;
        let first = times.partition_point(|t| (*t as f64) <= from);
        let last = times.partition_point(|t| (*t as f64) < to);
        let longest = (self.max_gap_s * 1e9) as i64;
        (first.saturating_sub(1)..last.min(times.len().saturating_sub(1)))
            .all(|i| times[i + 1] - times[i] <= longest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steady(rate: [f64; 3]) -> Gyro {
        Gyro::new((0..400).map(|n| (n * 2_500_000, rate)))
    }

    #[test]
    fn constant_rate_rotates_by_rate_times_time() {
        let gyro = steady([0.1, -0.5, 2.0]);
        let bias = Vector3::new(0.1, 0.0, 0.0);
        let integrated = gyro.integrate(Vector3::repeat(1.0), bias, 0.03);
        let (from, to) = (101_234_567.0, 801_000_001.0);
        let turn = integrated.to_from(from, to).unwrap().scaled_axis();
        let expected = Vector3::new(0.0, -0.5, 2.0) * (to - from) * 1e-9;
        assert!((turn - expected).norm() < 1e-12, "{turn}");
        let sum = integrated.sum(from, to).unwrap();
        assert!((sum - expected).norm() < 1e-12, "{sum}");
    }

    #[test]
    fn integration_stops_at_the_ends_and_at_gaps() {
        let samples = (0..400).filter(|n| !(100..120).contains(n));
        let gyro = Gyro::new(samples.map(|n| (n * 2_500_000, [0.0, 0.0, 1.0])));
        let integrated = gyro.integrate(Vector3::repeat(1.0), Vector3::zeros(), 0.03);
        assert!(integrated.to_from(0.0, 200e6).is_some());
        assert!(integrated.to_from(200e6, 400e6).is_none());
        assert!(integrated.to_from(400e6, 900e6).is_some());
        assert!(integrated.to_from(400e6, 1100e6).is_none());
        assert!(integrated.rate(260e6).is_none());
        assert!(integrated.rate(-1.0).is_none());
    }

    #[test]
    fn samples_out_of_order_or_not_finite_are_dropped() {
        let gyro = Gyro::new([
            (0, [0.0; 3]),
            (10, [f64::NAN, 0.0, 0.0]),
            (20, [0.0; 3]),
            (20, [1.0; 3]),
            (5, [1.0; 3]),
        ]);
        assert_eq!(gyro.span_ns(), Some([0, 20]));
        assert_eq!(gyro.between_ns(0, 100).count(), 2);
    }
}
