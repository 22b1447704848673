//! IMU samples by time and by number.
//!
//! Samples are ordered by their own times, whatever the order in which batches were stored: where a
//! clock map was replaced, times of neighbouring batches may overlap.

use std::ops::{Bound, Range, RangeBounds};
use std::sync::Arc;

use session_archive::index::{Access, BatchEntry, IndexError};
use session_archive::record::ImuBatch;
use session_archive::time::HostTime;

use super::error::{ImuFault, ReadError};

/// One sample of an IMU, in the IMU's own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Its number in the IMU's stream.
    pub number: u64,
    /// Device clock.
    pub ticks: i64,
    /// Host clock.
    pub time: HostTime,
    /// Whether the time is unreliable: its sigma may not hold.
    pub time_unreliable: bool,
    /// Angular rate, rad/s: the stored value, or stored counts times the stored scale.
    pub gyro: [f64; 3],
    /// Specific force, m/s²: the stored value, or stored counts times the stored scale.
    pub accel: [f64; 3],
}

/// Finds the batches that may hold a time.
#[derive(Debug)]
pub(super) struct BatchTimes {
    /// The latest time in any batch up to this one: rises.
    latest_before: Vec<i64>,
    /// The earliest time in any batch from this one on: rises.
    earliest_after: Vec<i64>,
}

impl BatchTimes {
    pub(super) fn new(batches: &[BatchEntry]) -> Self {
        let mut latest = i64::MIN;
        let mut earliest = i64::MAX;
        let mut times = Self {
            latest_before: Vec::with_capacity(batches.len()),
            earliest_after: Vec::with_capacity(batches.len()),
        };
        for batch in batches {
            latest = latest.max(batch.start_ns).max(batch.end_ns);
            times.latest_before.push(latest);
        }
        for batch in batches.iter().rev() {
            earliest = earliest.min(batch.start_ns).min(batch.end_ns);
            times.earliest_after.push(earliest);
        }
        times.earliest_after.reverse();
        times
    }

    /// Positions of the batches that may hold samples in `range`, judged by their ends.
    pub(super) fn candidates(&self, range: &impl RangeBounds<HostTime>) -> Range<usize> {
        let bound = |bound: Bound<&HostTime>, open: i64| match bound {
            Bound::Included(t) | Bound::Excluded(t) => t.0,
            Bound::Unbounded => open,
        };
        let from = bound(range.start_bound(), i64::MIN);
        let to = bound(range.end_bound(), i64::MAX);
        let start = self.latest_before.partition_point(|&t| t < from);
        let end = self.earliest_after.partition_point(|&t| t <= to);
        start..end.max(start)
    }
}

/// The samples of one batch, in the order of their numbers.
pub(super) fn samples(
    imu: &str,
    access: &Access,
    entry: &BatchEntry,
) -> Result<Vec<ImuSample>, ReadError> {
    let failed = |fault| ReadError::Imu {
        imu: imu.to_owned(),
        first: entry.first_number,
        last: (entry.first_number).saturating_add(u64::from(entry.samples.max(1)) - 1),
        fault,
    };
    let bytes = |error: IndexError| failed(ImuFault::Bytes(Arc::new(error)));
    convert(&access.batch(entry).map_err(bytes)?).map_err(failed)
}

fn convert(batch: &ImuBatch) -> Result<Vec<ImuSample>, ImuFault> {
    let samples = batch.device_ticks.len();
    if batch.times.len() != samples {
        return Err(ImuFault::Lengths {
            what: "times",
            found: batch.times.len(),
            samples,
        });
    }
    let gyro = vectors(
        "gyro values",
        samples,
        &batch.gyro_counts,
        batch.gyro_scale,
        &batch.gyro,
    )?;
    let accel = vectors(
        "accelerometer values",
        samples,
        &batch.accel_counts,
        batch.accel_scale,
        &batch.accel,
    )?;
    let times = batch.times.iter().zip(&batch.device_ticks);
    let samples = times
        .zip(gyro.into_iter().zip(accel))
        .zip((0..).map(|k| batch.first_number.saturating_add(k)));
    Ok(samples
        .map(|(((&time, &ticks), (gyro, accel)), number)| ImuSample {
            number,
            ticks,
            time: HostTime(time),
            time_unreliable: batch.time_unreliable,
            gyro,
            accel,
        })
        .collect())
}

/// SI vectors out of either counts or SI values.
fn vectors(
    what: &'static str,
    samples: usize,
    counts: &[i32],
    scale: f64,
    si: &[f64],
) -> Result<Vec<[f64; 3]>, ImuFault> {
    let found = counts.len() + si.len();
    // Both kinds present are caught by the first test, both empty by the second.
    if found != 3 * samples || (!counts.is_empty() && !si.is_empty()) {
        return Err(ImuFault::Lengths {
            what,
            found,
            samples,
        });
    }
    let scaled = counts
        .chunks_exact(3)
        .map(|c| [c[0], c[1], c[2]].map(|c| f64::from(c) * scale));
    let stored = si.chunks_exact(3).map(|v| [v[0], v[1], v[2]]);
    Ok(scaled.chain(stored).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn batch(start_ns: i64, end_ns: i64) -> BatchEntry {
        BatchEntry {
            first_number: 0,
            samples: 1,
            start_ns,
            end_ns,
            segment: 0,
            offset: 0,
            bytes: 0,
            crc32: 0,
        }
    }

    #[test]
    fn batches_that_overlap_in_time_are_all_found() {
        let times = BatchTimes::new(&[batch(0, 9), batch(10, 30), batch(20, 25), batch(26, 40)]);
        assert_eq!(times.candidates(&(HostTime(22)..)), 1..4);
        assert_eq!(times.candidates(&(HostTime(26)..=HostTime(28))), 1..4);
        assert_eq!(times.candidates(&(..HostTime(15))), 0..2);
        assert_eq!(times.candidates(&(HostTime(41)..)), 4..4);
        assert_eq!(times.candidates(&(..)), 0..4);
    }

    #[test]
    fn counts_and_si_values_come_out_in_si() {
        let batch = ImuBatch {
            first_number: 7,
            device_ticks: vec![1, 2],
            times: vec![100, 200],
            gyro_counts: vec![1, -2, 3, 4, 5, -6],
            gyro_scale: 0.1,
            time_unreliable: true,
            accel: vec![0.5, 9.81, -0.25, 0.1, 0.2, 0.3],
            ..ImuBatch::default()
        };
        let found = convert(&batch).expect("convert");
        let second = ImuSample {
            number: 8,
            ticks: 2,
            time: HostTime(200),
            time_unreliable: true,
            gyro: [4.0 * 0.1, 5.0 * 0.1, -6.0 * 0.1],
            accel: [0.1, 0.2, 0.3],
        };
        assert_eq!((found.len(), found[1]), (2, second));
    }

    #[test]
    fn a_batch_that_contradicts_itself_is_refused() {
        let whole = ImuBatch {
            device_ticks: vec![1, 2],
            times: vec![100, 200],
            gyro: vec![0.0; 6],
            accel: vec![0.0; 6],
            ..ImuBatch::default()
        };
        assert!(convert(&whole).is_ok());
        // Numbers that no device reaches are odd, but must not panic.
        let last = ImuBatch {
            first_number: u64::MAX,
            ..whole.clone()
        };
        assert_eq!(convert(&last).expect("convert")[1].number, u64::MAX);
        let breaks: [fn(&mut ImuBatch); 4] = [
            |b| b.times.truncate(1),
            |b| b.gyro.truncate(5),
            |b| b.gyro_counts.push(3),
            |b| b.accel.clear(),
        ];
        for break_it in breaks {
            let mut batch = whole.clone();
            break_it(&mut batch);
            assert!(
                matches!(convert(&batch), Err(ImuFault::Lengths { .. })),
                "{batch:?}"
            );
        }
    }
}
