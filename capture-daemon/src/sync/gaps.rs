//! Sequence numbers, and what is missing between them.
//!
//! A [`SequenceTracker`] is told of every sample that is stored and of every one that will not come,
//! and gives the gap records that account for the rest: from the first sample stored, samples and
//! gaps together are every number exactly once. *Late or repeated* samples are refused; a gap
//! record for them may already be written. *A hole that nobody reported* is the device's.
//! [`Renumber`] comes before it, where devices restart their counters or let them wrap.

use std::collections::BTreeMap;

use session_archive::record::Gap;
use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;

/// What was reported about numbers that will not come.
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
    /// A tracker for a stream, named as gap records name it.
    pub fn new(stream: &str) -> Self {
        let stream = stream.to_owned();
        Self {
            stream,
            next: None,
            newest: HostTime::MIN,
            reports: BTreeMap::new(),
        }
    }

    /// Samples `first..first + count` are to be stored. Gives the gaps before them, or nothing
    /// if they are late or repeated and must not be stored.
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

    /// Numbers `first..=last` will not come.
    pub fn dropped(&mut self, first: u64, last: u64, cause: Cause, detail: &str) {
        if first > last || self.next.is_some_and(|next| last < next) {
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

    /// The stream has ended: gaps for what was reported behind the last sample.
    pub fn finish(&mut self) -> Vec<Gap> {
        let Some(next) = self.next else {
            return Vec::new();
        };
        let last = self.reports.values().map(|r| r.last).max();
        match last {
            Some(last) if last >= next => {
                self.next = Some(last + 1);
                self.fill(next, last + 1, None)
            }
            _ => Vec::new(),
        }
    }

    /// Gaps for `from..to`: each number by the report that covers it, else by the device.
    fn fill(&mut self, mut from: u64, to: u64, after: Option<HostTime>) -> Vec<Gap> {
        let mut gaps: Vec<Gap> = Vec::new();
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
                    (
                        next,
                        Cause::Device,
                        "the device skipped these numbers".to_owned(),
                    )
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

/// A number that falls back by more than this did not come late: the device counts anew.
const REORDER: u64 = 64;

/// Unwraps a device's counter into numbers that only grow.
#[derive(Clone, Debug, Default)]
pub struct Renumber {
    bits: Option<u8>,
    offset: u64,
    newest: Option<u64>,
}

/// A number that came out of [`Renumber`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Numbered {
    /// The stream's number.
    pub number: u64,
    /// The device restarted its counter: how many samples are missing here cannot be known.
    pub restarted: bool,
}

impl Renumber {
    /// For a counter of `bits` bits (none: it never wraps).
    pub fn new(bits: Option<u8>) -> Self {
        Self {
            bits: bits.filter(|b| (1..64).contains(b)),
            ..Self::default()
        }
    }

    /// The stream's number of the device's number.
    pub fn number(&mut self, raw: u64) -> Numbered {
        let number = raw.saturating_add(self.offset);
        let Some(newest) = self.newest else {
            self.newest = Some(number);
            return Numbered {
                number,
                restarted: false,
            };
        };
        if number.saturating_add(REORDER) > newest {
            self.newest = Some(newest.max(number));
            return Numbered {
                number,
                restarted: false,
            };
        }
        let turn = self.bits.map(|b| 1_u64 << b);
        let wrapped = turn.map(|t| number.saturating_add(t));
        // A wrap continues within half a turn; anything else is a restart.
        if let (Some(wrapped), Some(turn)) = (wrapped, turn)
            && wrapped > newest
            && wrapped - newest < turn / 2
        {
            self.offset = self.offset.saturating_add(turn);
            self.newest = Some(wrapped);
            return Numbered {
                number: wrapped,
                restarted: false,
            };
        }
        let number = newest.saturating_add(1);
        self.offset = number.saturating_sub(raw);
        self.newest = Some(number);
        Numbered {
            number,
            restarted: true,
        }
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
    fn holes_have_the_causes_that_were_reported() {
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
    fn what_was_dropped_before_the_first_sample_is_no_gap() {
        let mut tracker = SequenceTracker::new("feet");
        tracker.dropped(0, 4, Cause::EncoderRestart, "starting");
        assert_eq!(tracker.samples(5, 3, t(5), t(7)), Some(vec![]));
        assert_eq!(tracker.finish(), vec![]);
    }

    proptest! {
        /// Whatever is stored, dropped, late or repeated: from the first sample on, every number
        /// is either stored or in exactly one gap.
        #[test]
        fn samples_and_gaps_are_every_number(
            steps in prop::collection::vec((0_u64..60, 1_u64..5, prop::bool::ANY), 1..80)
        ) {
            let mut tracker = SequenceTracker::new("s");
            let mut seen: BTreeMap<u64, u32> = BTreeMap::new();
            let mut first_stored = None;
            let mut gaps = Vec::new();
            for (first, count, stored) in steps {
                if stored {
                    if let Some(new) = tracker.samples(first, count, t(first), t(first + count)) {
                        gaps.extend(new);
                        first_stored.get_or_insert(first);
                        for n in first..first + count {
                            *seen.entry(n).or_default() += 1;
                        }
                    }
                } else {
                    tracker.dropped(first, first + count - 1, Cause::Device, "");
                }
            }
            gaps.extend(tracker.finish());
            for gap in &gaps {
                for n in gap.first..=gap.last {
                    *seen.entry(n).or_default() += 1;
                }
            }
            prop_assert!(seen.values().all(|n| *n == 1), "{seen:?}");
            if let (Some(first), Some((&last, _))) = (first_stored, seen.iter().next_back()) {
                prop_assert_eq!(seen.len() as u64, last - first + 1);
            }
        }
    }

    #[test]
    fn counters_wrap_and_restart() {
        let mut plain = Renumber::new(None);
        let mut numbers = |raw| plain.number(raw);
        assert_eq!(
            numbers(1000),
            Numbered {
                number: 1000,
                restarted: false
            }
        );
        assert_eq!(
            numbers(998),
            Numbered {
                number: 998,
                restarted: false
            }
        );
        assert_eq!(numbers(1001).number, 1001);
        assert_eq!(
            numbers(0),
            Numbered {
                number: 1002,
                restarted: true
            }
        );
        assert_eq!(
            numbers(3),
            Numbered {
                number: 1005,
                restarted: false
            }
        );

        let mut narrow = Renumber::new(Some(8));
        assert_eq!(narrow.number(250).number, 250);
        assert_eq!(narrow.number(255).number, 255);
        assert_eq!(
            narrow.number(2),
            Numbered {
                number: 258,
                restarted: false
            }
        );
        assert_eq!(narrow.number(254).number, 510);
    }
}
