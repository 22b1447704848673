//! The account of a stream's numbers: which ones are stored, and the gaps between them.
//!
//! A [`SequenceTracker`] takes every sample that is stored and every one that is reported as lost,
//! and returns the gap records that account for the rest: from the first sample stored, samples and
//! gaps together cover every number exactly once. *Late or repeated* samples are rejected; a gap
//! record for them may already be written. *A gap that nobody reported* is attributed to the
//! device; *at the end*, where an unreported sample may only be in transit, it counts as late.
//! [`Renumber`](super::renumber::Renumber) comes before it.

use std::collections::BTreeMap;

use session_archive::record::Gap;
use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;

/// Report of numbers that will not arrive.
#[derive(Clone, Debug)]
struct Report {
    last: u64,
    cause: Cause,
    detail: String,
}

/// Accounts for every number of one stream.
#[derive(Clone, Debug)]
pub struct SequenceTracker {
    stream: String,
    /// The next number, once there is a first.
    next: Option<u64>,
    newest: HostTime,
    /// By first number.
    reports: BTreeMap<u64, Report>,
}

impl SequenceTracker {
    /// A tracker for a stream, named as in gap records.
    pub fn new(stream: &str) -> Self {
        let stream = stream.to_owned();
        Self {
            stream,
            next: None,
            newest: HostTime::MIN,
            reports: BTreeMap::new(),
        }
    }

    /// Samples `first..first + count` are to be stored. Returns the gaps before them, or `None` if
    /// they are late or repeated and must not be stored.
    pub fn samples(
        &mut self,
        first: u64,
        count: u64,
        start: HostTime,
        end: HostTime,
    ) -> Option<Vec<Gap>> {
        let after = first.checked_add(count)?;
        let next = *self.next.get_or_insert(first);
        if first < next {
            if after > next {
                self.dropped(next, after - 1, Cause::Late, "came with repeated samples");
            }
            return None;
        }
        let gaps = self.fill(next, first, Some(start));
        self.next = Some(after);
        self.newest = self.newest.max(end);
        Some(gaps)
    }

    /// Numbers `first..=last` will not arrive.
    pub fn dropped(&mut self, first: u64, last: u64, cause: Cause, detail: &str) {
        if first > last || self.next.is_some_and(|next| last < next) {
            return;
        }
        // Consecutive drops extend one report.
        if let Some((_, before)) = self.reports.range_mut(..=first).next_back()
            && before.cause == cause
            && before.detail == detail
            && before.last.saturating_add(1) >= first
        {
            before.last = before.last.max(last);
            return;
        }
        let report = Report {
            last,
            cause,
            detail: detail.to_owned(),
        };
        match self.reports.get_mut(&first) {
            Some(known) if known.last >= last => {}
            _ => {
                self.reports.insert(first, report);
            }
        }
    }

    /// The stream has ended: returns gaps for losses reported behind the last sample.
    pub fn finish(&mut self) -> Vec<Gap> {
        let Some(next) = self.next else {
            return Vec::new();
        };
        let last = self.reports.values().map(|r| r.last).max();
        match last {
            Some(last) if last >= next => {
                let end = last.saturating_add(1);
                self.next = Some(end);
                self.fill(next, end, None)
            }
            _ => Vec::new(),
        }
    }

    /// Gaps for `from..to`: each number by the report that covers it, else by the device, or, if no
    /// sample follows at `after`, as late.
    fn fill(&mut self, mut from: u64, to: u64, after: Option<HostTime>) -> Vec<Gap> {
        let mut gaps: Vec<Gap> = Vec::new();
        let (otherwise, why) = match after {
            Some(_) => (Cause::Device, "the device skipped these numbers"),
            None => (
                Cause::Late,
                "not through the encoder when the session was closed",
            ),
        };
        while from < to {
            // The report that covers `from`, or the beginning of the next one.
            let covering = self
                .reports
                .range(..=from)
                .rev()
                .find(|(_, r)| r.last >= from);
            let (end, cause, detail) = match covering {
                Some((_, r)) => (r.last.saturating_add(1).min(to), r.cause, r.detail.clone()),
                None => {
                    let next = self
                        .reports
                        .range(from..to)
                        .next()
                        .map_or(to, |(first, _)| *first);
                    (next, otherwise, why.to_owned())
                }
            };
            match gaps.last_mut() {
                Some(gap) if gap.cause == cause as i32 && gap.detail == detail => {
                    gap.last = end - 1;
                }
                _ => gaps.push(Gap {
                    stream: self.stream.clone(),
                    first: from,
                    last: end - 1,
                    cause: cause.into(),
                    time_before: (self.newest > HostTime::MIN).then_some(self.newest.0),
                    time_after: after.map(|t| t.0),
                    detail,
                }),
            }
            from = end;
        }
        self.reports.retain(|_, r| r.last >= to);
        gaps
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn t(n: u64) -> HostTime {
        HostTime(n as i64 * 10)
    }

    fn ranges(gaps: &[Gap]) -> Vec<(u64, u64, Cause)> {
        gaps.iter().map(|g| (g.first, g.last, g.cause())).collect()
    }

    #[test]
    fn gaps_have_the_reported_causes() {
        let mut tracker = SequenceTracker::new("feet");
        assert_eq!(tracker.samples(10, 1, t(10), t(10)), Some(vec![]));
        tracker.dropped(12, 13, Cause::EncoderOverload, "full");
        tracker.dropped(13, 14, Cause::WriterOverload, "slow");
        let gaps = tracker.samples(17, 1, t(17), t(17)).expect("new");
        let expected = [
            (11, 11, Cause::Device),
            (12, 13, Cause::EncoderOverload),
            (14, 14, Cause::WriterOverload),
            (15, 16, Cause::Device),
        ];
        assert_eq!(ranges(&gaps), expected);
        assert_eq!(
            (gaps[0].time_before, gaps[0].time_after),
            (Some(100), Some(170))
        );
        assert_eq!(tracker.samples(17, 1, t(17), t(17)), None, "twice");
        assert_eq!(tracker.samples(12, 1, t(12), t(12)), None, "late");
        tracker.dropped(18, 18, Cause::EncoderRestart, "stuck");
        assert_eq!(ranges(&tracker.finish()), [(18, 18, Cause::EncoderRestart)]);
        assert_eq!(tracker.finish(), vec![]);
    }

    #[test]
    fn drops_before_the_first_sample_are_no_gap() {
        let mut tracker = SequenceTracker::new("feet");
        tracker.dropped(0, 4, Cause::EncoderRestart, "starting");
        assert_eq!(tracker.samples(5, 3, t(5), t(7)), Some(vec![]));
        assert_eq!(tracker.finish(), vec![]);
    }

    proptest! {
        /// Whatever is stored, dropped, late or repeated: from the first sample on, every number is
        /// either stored or in exactly one gap.
        #[test]
        fn samples_and_gaps_cover_every_number(
            steps in prop::collection::vec((0_u64..60, 1_u64..5, prop::bool::ANY), 1..80)
        ) {
            let mut tracker = SequenceTracker::new("s");
            let mut counts: BTreeMap<u64, u32> = BTreeMap::new();
            let mut first_stored = None;
            let mut gaps = Vec::new();
            for (first, count, stored) in steps {
                if stored {
                    if let Some(new) = tracker.samples(first, count, t(first), t(first + count)) {
                        gaps.extend(new);
                        first_stored.get_or_insert(first);
                        for n in first..first + count {
                            *counts.entry(n).or_default() += 1;
                        }
                    }
                } else {
                    tracker.dropped(first, first + count - 1, Cause::Device, "");
                }
            }
            gaps.extend(tracker.finish());
            for gap in &gaps {
                for n in gap.first..=gap.last {
                    *counts.entry(n).or_default() += 1;
                }
            }
            prop_assert!(counts.values().all(|n| *n == 1), "{counts:?}");
            if let (Some(first), Some((&last, _))) = (first_stored, counts.iter().next_back()) {
                prop_assert_eq!(counts.len() as u64, last - first + 1);
            }
        }
    }

    #[test]
    fn stream_of_drops_produces_one_report() {
        let mut tracker = SequenceTracker::new("feet");
        tracker.samples(0, 1, t(0), t(0));
        for n in 1..10_000 {
            tracker.dropped(n, n, Cause::EncoderOverload, "full");
        }
        assert_eq!(tracker.reports.len(), 1);
        let expected = [(1, 9999, Cause::EncoderOverload)];
        assert_eq!(ranges(&tracker.finish()), expected);
    }
}
