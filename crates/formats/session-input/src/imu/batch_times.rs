//! Finds the batches that may hold a time.
//!
//! Where a clock map was replaced, times of neighbouring batches may overlap, whatever the order in
//! which they were stored.

use std::ops::{Bound, Range, RangeBounds};

use session_archive::index::BatchEntry;
use session_archive::time::HostTime;

/// See the module.
#[derive(Debug)]
pub(crate) struct BatchTimes {
    /// The latest time in any batch up to this one: rises.
    latest_before: Vec<i64>,
    /// The earliest time in any batch from this one on: rises.
    earliest_after: Vec<i64>,
}

impl BatchTimes {
    pub(crate) fn new(batches: &[BatchEntry]) -> Self {
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
    pub(crate) fn candidates(&self, range: &impl RangeBounds<HostTime>) -> Range<usize> {
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
}
