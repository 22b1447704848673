//! IMU measurements as a function of time.
//!
//! Values are interpolated linearly between two samples. A gap is a missing sample or a saturated
//! value: nothing is integrated across it.

use nalgebra::{Matrix3, Vector3};

use super::config::SampleConfig;
use camera_models::ImuSample;

/// A measurement, s, rad/s and m/s².
#[derive(Clone, Copy, Debug)]
pub(super) struct Raw {
    pub time_s: f64,
    pub gyro: Vector3<f64>,
    pub accel: Vector3<f64>,
}

/// All samples in order of time.
#[derive(Clone, Debug)]
pub(super) struct Track {
    samples: Vec<Raw>,
    /// Number of gaps that end at or before sample `i`.
    gaps: Vec<u32>,
    /// Integrals of angular rate and specific force up to sample `i`.
    sums: Vec<[Vector3<f64>; 2]>,
    /// Median interval between two samples, s.
    pub period_s: f64,
}

impl Track {
    /// Builds the track from samples in strict order of time. `range` is that of the gyroscope and
    /// of the accelerometer.
    pub(super) fn new(
        samples: &[ImuSample],
        zero_ns: i64,
        range: [f64; 2],
        config: &SampleConfig,
    ) -> Self {
        let samples: Vec<Raw> = samples
            .iter()
            .map(|s| Raw {
                time_s: (s.time_ns - zero_ns) as f64 * 1e-9,
                gyro: Vector3::from(s.gyro),
                accel: Vector3::from(s.accel),
            })
            .collect();
        let mut steps: Vec<f64> = samples
            .windows(2)
            .map(|pair| pair[1].time_s - pair[0].time_s)
            .collect();
        steps.sort_by(f64::total_cmp);
        let period_s = steps.get(steps.len() / 2).copied().unwrap_or(1.0);
        let cut_off = |s: &Raw| {
            let at_end = |v: &Vector3<f64>, range: f64| v.amax() >= config.saturation_ratio * range;
            at_end(&s.gyro, range[0]) || at_end(&s.accel, range[1])
        };
        let mut gaps = vec![0; samples.len()];
        let mut sums = vec![[Vector3::zeros(); 2]; samples.len()];
        for i in 1..samples.len() {
            let (a, b) = (&samples[i - 1], &samples[i]);
            let step = b.time_s - a.time_s;
            let broken = step > config.max_interval_periods * period_s || cut_off(a) || cut_off(b);
            gaps[i] = gaps[i - 1] + u32::from(broken);
            sums[i][0] = sums[i - 1][0] + (a.gyro + b.gyro) * (0.5 * step);
            sums[i][1] = sums[i - 1][1] + (a.accel + b.accel) * (0.5 * step);
        }
        Self {
            samples,
            gaps,
            sums,
            period_s,
        }
    }

    /// The last sample at or before a time that has a successor.
    fn before(&self, time_s: f64) -> Option<usize> {
        let after = self.samples.partition_point(|s| s.time_s <= time_s);
        (after > 0 && after < self.samples.len()).then(|| after - 1)
    }

    fn at(&self, i: usize, time_s: f64) -> Raw {
        let (a, b) = (&self.samples[i], &self.samples[i + 1]);
        let part = (time_s - a.time_s) / (b.time_s - a.time_s);
        Raw {
            time_s,
            gyro: a.gyro + (b.gyro - a.gyro) * part,
            accel: a.accel + (b.accel - a.accel) * part,
        }
    }

    /// Values at two times and at all samples between them; `None` beyond the ends or across a gap.
    pub(super) fn between(&self, from_s: f64, to_s: f64, out: &mut Vec<Raw>) -> Option<()> {
        out.clear();
        let (first, last) = (self.before(from_s)?, self.before(to_s)?);
        if self.gaps[first] != self.gaps[last + 1] {
            return None;
        }
        out.push(self.at(first, from_s));
        let inner = self.samples[first + 1..=last.max(first)].iter();
        out.extend(inner.filter(|s| s.time_s > from_s && s.time_s < to_s));
        out.push(self.at(last, to_s));
        Some(())
    }

    /// Mean angular rate and specific force between two times; `None` as in [`Self::between`].
    pub(super) fn means(&self, from_s: f64, to_s: f64) -> Option<[Vector3<f64>; 2]> {
        let (first, last) = (self.before(from_s)?, self.before(to_s)?);
        if self.gaps[first] != self.gaps[last + 1] {
            return None;
        }
        let up_to = |i: usize, time_s: f64| {
            let (start, end) = (&self.samples[i], self.at(i, time_s));
            let half = 0.5 * (time_s - start.time_s);
            [
                self.sums[i][0] + (start.gyro + end.gyro) * half,
                self.sums[i][1] + (start.accel + end.accel) * half,
            ]
        };
        let (a, b) = (up_to(first, from_s), up_to(last, to_s));
        Some([0, 1].map(|k| (b[k] - a[k]) / (to_s - from_s)))
    }
}

/// Correction of measurements: `shape⁻¹ (measured - bias)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Correction {
    pub gyro_bias: Vector3<f64>,
    pub accel_bias: Vector3<f64>,
    /// Inverse of scale and skew.
    pub gyro_shape_inverse: Matrix3<f64>,
    pub accel_shape_inverse: Matrix3<f64>,
}

impl Correction {
    pub(super) fn gyro(&self, raw: &Raw) -> Vector3<f64> {
        self.gyro_shape_inverse * (raw.gyro - self.gyro_bias)
    }

    pub(super) fn accel(&self, raw: &Raw) -> Vector3<f64> {
        self.accel_shape_inverse * (raw.accel - self.accel_bias)
    }
}
