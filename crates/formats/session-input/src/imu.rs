//! IMU samples in SI units.
//!
//! A session stores batches of samples: counts with a scale, or SI values. This module is the only
//! conversion. Values are the stored SI values, or counts times the scale, in double precision.
//!
//! No sample is ever interpolated, repeated or shifted. There are four ways in which samples can be
//! absent or out of order, with one rule each; users differ in what they need, so each rule is a
//! function of its own:
//!
//! | situation | rule | user, reason |
//! |---|---|---|
//! | a batch that contradicts itself | [`samples`] refuses the whole batch | reconstruction: a sealed session has none, so the lists cannot be assigned to samples with certainty; the batch is reported as one loss |
//! | a sample without all six values | [`complete_samples`] leaves it out | calibration and export: sessions that were never validated; what is complete is used, and calibration sees a gap in the numbers |
//! | numbers that jump | [`recording`] makes a gap of each jump, with the recorded cause | calibration: noise is measured on runs without gaps, in the device's own order |
//! | times that go back, where a clock map was replaced | [`sort_by_time`] sorts, and of equal times keeps the first measured | reconstruction: every sample carries information on the motion, and the estimator bridges gaps in time by itself |
//! | the same | [`increasing_in_time`] leaves out what does not increase | camera-IMU calibration: a rate is wrong across a replaced map, and few samples of a long recording are concerned |

use session_archive::record::ImuBatch;

pub(crate) mod batch_times;
pub mod recording;

/// One sample of an IMU, in the IMU's own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Its number in the IMU's stream.
    pub number: u64,
    /// Device clock, ticks.
    pub ticks: i64,
    /// Host clock, ns, by the clock map in force.
    pub time_ns: i64,
    /// Angular rate, rad/s.
    pub gyro_rad_s: [f64; 3],
    /// Specific force, m/s²: a sensor at rest measures 9.8 upwards.
    pub accel_m_s2: [f64; 3],
    /// Temperature of the sensor, °C, if the device delivers it.
    pub temperature_c: Option<f32>,
    /// Whether the time is unreliable: its sigma may not hold.
    pub time_unreliable: bool,
}

impl From<&ImuSample> for camera_models::ImuSample {
    fn from(sample: &ImuSample) -> Self {
        Self {
            time_ns: sample.time_ns,
            gyro: sample.gyro_rad_s,
            accel: sample.accel_m_s2,
        }
    }
}

/// A batch whose lists have lengths that do not fit: the whole batch is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{found} {what} for {samples} samples")]
pub struct LengthMismatch {
    /// Name of the values.
    pub what: &'static str,
    /// Their number.
    pub found: usize,
    /// Number of samples of the batch.
    pub samples: usize,
}

/// All samples of a batch, in the order of their numbers.
///
/// # Errors
/// The number of times or values does not fit that of the samples, or values are stored both as
/// counts and in SI units.
pub fn samples(batch: &ImuBatch) -> Result<Vec<ImuSample>, LengthMismatch> {
    let samples = batch.device_ticks.len();
    let mismatch = |what, found| LengthMismatch {
        what,
        found,
        samples,
    };
    if batch.times.len() != samples {
        return Err(mismatch("times", batch.times.len()));
    }
    let sensors = [
        ("gyro values", &batch.gyro_counts, &batch.gyro),
        ("accelerometer values", &batch.accel_counts, &batch.accel),
    ];
    for (what, counts, si) in sensors {
        let found = counts.len() + si.len();
        // Both kinds present are caught by the first test, both empty by the second.
        if found != 3 * samples || (!counts.is_empty() && !si.is_empty()) {
            return Err(mismatch(what, found));
        }
    }
    Ok(complete_samples(batch).map(|(_, sample)| sample).collect())
}

/// The samples of a batch that have a time, ticks and all six values, in the order of their
/// numbers, each with its position in the batch.
pub fn complete_samples(batch: &ImuBatch) -> impl Iterator<Item = (usize, ImuSample)> + '_ {
    (0..batch.times.len()).filter_map(|k| Some((k, sample(batch, k)?)))
}

/// Sample `k` of a batch; `None` if one of its values is missing.
fn sample(batch: &ImuBatch, k: usize) -> Option<ImuSample> {
    Some(ImuSample {
        number: batch.first_number.saturating_add(k as u64),
        ticks: *batch.device_ticks.get(k)?,
        time_ns: *batch.times.get(k)?,
        gyro_rad_s: vector(&batch.gyro_counts, batch.gyro_scale, &batch.gyro, k)?,
        accel_m_s2: vector(&batch.accel_counts, batch.accel_scale, &batch.accel, k)?,
        temperature_c: temperature_c(batch, k).map(|t| t as f32),
        time_unreliable: batch.time_unreliable,
    })
}

/// Vector `k`: counts times their scale where there are any, else the SI values.
fn vector(counts: &[i32], scale: f64, si: &[f64], k: usize) -> Option<[f64; 3]> {
    let at = 3 * k..3 * k + 3;
    match counts.get(at.clone()) {
        Some(c) => Some([c[0], c[1], c[2]].map(|c| f64::from(c) * scale)),
        None => si.get(at).map(|v| [v[0], v[1], v[2]]),
    }
}

/// Temperature of sample `k` of a batch, °C, in the precision of its scale.
pub fn temperature_c(batch: &ImuBatch, k: usize) -> Option<f64> {
    let counts = batch.temperature_counts.get(k)?;
    Some(f64::from(*counts) * batch.temperature_scale_c)
}

/// Sorts samples by time. Of samples with the same time the one measured first is kept.
pub fn sort_by_time(samples: &mut Vec<ImuSample>) {
    samples.sort_by_key(|s| (s.time_ns, s.number));
    samples.dedup_by_key(|s| s.time_ns);
}

/// The samples whose time is after those of all before them, in the given order.
pub fn increasing_in_time(samples: &[ImuSample]) -> impl Iterator<Item = &ImuSample> {
    let mut last = None;
    samples.iter().filter(move |sample| {
        let is_later = last.is_none_or(|last| sample.time_ns > last);
        if is_later {
            last = Some(sample.time_ns);
        }
        is_later
    })
}

#[cfg(test)]
mod tests;
