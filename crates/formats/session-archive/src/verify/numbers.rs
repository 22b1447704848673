//! The numbers of one stream: which are there, in which order they came, and which are missing.
//!
//! A sample is there wherever in the session it is: one that comes behind a later number is out of
//! order, and its number is not missing. No gap record is due for it.

use super::ranges::{subtract, union};
use super::report::{LostSamples, StreamReport};
use crate::manifest::Extent;
use crate::time::HostTime;

/// Consecutive samples.
#[derive(Clone, Copy)]
struct Run {
    first: u64,
    last: u64,
    /// Time of the first sample.
    start: HostTime,
    /// Time of the last sample.
    end: HostTime,
    /// Whether every number before them was lower.
    in_order: bool,
}

/// A numbered stream while it is being read.
#[derive(Default)]
pub(super) struct Numbers {
    pub(super) report: StreamReport,
    /// Everything that is there, as it came.
    runs: Vec<Run>,
    pub(super) gaps: Vec<(u64, u64)>,
    /// The highest number so far.
    newest: Option<u64>,
    /// What the manifest says was on disk.
    pub(super) extent: Option<Extent>,
}

impl Numbers {
    pub(super) fn samples(&mut self, first: u64, count: u64, start: HostTime, end: HostTime) {
        let last = first.saturating_add(count.saturating_sub(1));
        let in_order = self.newest.is_none_or(|newest| first > newest);
        if !in_order {
            self.report.repeated += count;
        }
        self.newest = self.newest.max(Some(last));
        match self.runs.last_mut() {
            Some(run) if run.in_order == in_order && run.last.checked_add(1) == Some(first) => {
                (run.last, run.end) = (last, end);
            }
            Some(run) if run.first <= first && last <= run.last => {}
            _ => self.runs.push(Run {
                first,
                last,
                start,
                end,
                in_order,
            }),
        }
    }

    /// The highest number so far.
    pub(super) fn newest(&self) -> Option<u64> {
        self.newest
    }

    /// The numbers that are there.
    pub(super) fn present(&self) -> impl Iterator<Item = (u64, u64)> + '_ {
        self.runs.iter().map(|run| (run.first, run.last))
    }

    /// Of those, the ones that came in order.
    pub(super) fn in_order(&self) -> impl Iterator<Item = (u64, u64)> + '_ {
        let runs = self.runs.iter().filter(|run| run.in_order);
        runs.map(|run| (run.first, run.last))
    }

    /// Subtracts the gap records from the missing numbers; returns the losses that no gap record
    /// explains.
    pub(super) fn settle(self, name: &str) -> (StreamReport, Vec<LostSamples>) {
        let gaps = union(self.gaps);
        let present = by_number(self.runs);
        let mut report = self.report;
        let sampled = present.first().zip(present.last());
        if let Some((lowest, highest)) = sampled {
            (report.start, report.end) = (lowest.start, highest.end);
        }
        let sampled = sampled.map(|(lowest, highest)| (lowest.first, highest.last));
        let known = self.extent.map(|e| (e.first, e.last));
        let all = || gaps.iter().copied().chain(sampled).chain(known);
        let (Some(first), Some(last)) = (all().map(|r| r.0).min(), all().map(|r| r.1).max()) else {
            return (report, Vec::new());
        };
        (report.first, report.last) = (first, last);
        let samples = present.iter().map(|run| count(run.first, run.last));
        report.samples = samples.fold(0, u64::saturating_add);
        let mut unsampled: u64 = 0;
        let mut lost = Vec::new();
        for (from, to, after, before) in missing(&present, (first, last), self.extent) {
            unsampled = unsampled.saturating_add(count(from, to));
            for (a, b) in subtract((from, to), &gaps) {
                report.lost = report.lost.saturating_add(count(a, b));
                lost.push(LostSamples {
                    stream: name.to_owned(),
                    first: a,
                    last: b,
                    after,
                    before,
                });
            }
        }
        let gap_numbers = gaps.iter().map(|&(a, b)| count(a, b));
        report.gaps = gap_numbers.fold(0, u64::saturating_add);
        // Every gap has to lie within what is missing.
        report.contradicted = report.gaps.saturating_sub(unsampled - report.lost);
        (report, lost)
    }
}

fn count(first: u64, last: u64) -> u64 {
    (last - first).saturating_add(1)
}

/// The runs in the order of their numbers, those that touch or overlap as one.
fn by_number(mut runs: Vec<Run>) -> Vec<Run> {
    runs.sort_by_key(|run| (run.first, run.last));
    let mut out: Vec<Run> = Vec::with_capacity(runs.len());
    for run in runs {
        match out.last_mut() {
            Some(before) if run.first <= before.last.saturating_add(1) => {
                if run.last > before.last {
                    (before.last, before.end) = (run.last, run.end);
                }
            }
            _ => out.push(run),
        }
    }
    out
}

/// What of `first..=last` is not present, with the times of the samples around it; at the ends of
/// the stream, of the sample there and of the manifest's extent.
fn missing(
    present: &[Run],
    (first, last): (u64, u64),
    extent: Option<Extent>,
) -> Vec<(u64, u64, HostTime, HostTime)> {
    let (Some(lowest), Some(highest)) = (present.first(), present.last()) else {
        let (after, before) = extent.map_or_else(Default::default, |e| (e.start, e.end));
        return vec![(first, last, after, before)];
    };
    let holes = present.windows(2).map(|pair| {
        let (before, behind) = (pair[0], pair[1]);
        (before.last + 1, behind.first - 1, before.end, behind.start)
    });
    let mut missing: Vec<_> = holes.collect();
    if first < lowest.first {
        let after = extent.map_or(lowest.start, |e| e.start.min(lowest.start));
        missing.push((first, lowest.first - 1, after, lowest.start));
    }
    if last > highest.last {
        let before = extent.map_or(highest.end, |e| e.end.max(highest.end));
        missing.push((highest.last + 1, last, highest.end, before));
    }
    missing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_hole_is_explained_or_lost() {
        let mut n = Numbers::default();
        for (number, time) in [(10, 0), (11, 1), (15, 5), (16, 6), (20, 10)] {
            n.samples(number, 1, HostTime(time), HostTime(time));
        }
        n.gaps = vec![(12, 13), (17, 19), (21, 22)];
        let (report, lost) = n.settle("feet");
        assert_eq!((report.first, report.last, report.samples), (10, 22, 5));
        assert_eq!((report.gaps, report.lost, report.contradicted), (7, 1, 0));
        assert_eq!(
            report.samples + report.gaps + report.lost,
            report.expected()
        );
        assert_eq!(lost.len(), 1);
        assert_eq!((lost[0].first, lost[0].last), (14, 14));
        assert_eq!((lost[0].after, lost[0].before), (HostTime(1), HostTime(5)));
    }

    #[test]
    fn what_the_manifest_had_is_lost_at_the_ends() {
        let mut n = Numbers {
            extent: extent(5, 20),
            gaps: vec![(6, 6), (9, 9), (19, 19)],
            ..Numbers::default()
        };
        for number in [10, 11] {
            let time = HostTime(number as i64 * 10);
            n.samples(number, 1, time, time);
        }
        let (report, lost) = n.settle("feet");
        assert_eq!((report.first, report.last, report.samples), (5, 20, 2));
        assert_eq!((report.gaps, report.contradicted), (3, 0));
        let spans: Vec<_> = lost.iter().map(|l| (l.first, l.last)).collect();
        assert_eq!(spans, [(5, 5), (7, 8), (12, 18), (20, 20)]);
        assert_eq!(
            report.samples + report.gaps + report.lost,
            report.expected()
        );
        assert_eq!(
            (lost[3].after, lost[3].before),
            (HostTime(110), HostTime(200))
        );
        // Nothing of the stream is left at all.
        let n = Numbers {
            extent: extent(5, 20),
            ..Numbers::default()
        };
        let (report, lost) = n.settle("feet");
        assert_eq!((report.lost, report.expected(), lost.len()), (16, 16, 1));
    }

    fn extent(first: u64, last: u64) -> Option<Extent> {
        Some(Extent {
            first,
            last,
            start: HostTime(first as i64 * 10),
            end: HostTime(last as i64 * 10),
        })
    }

    #[test]
    fn a_gap_over_a_present_sample_is_a_contradiction() {
        let mut n = Numbers::default();
        for number in [1, 2, 4] {
            n.samples(number, 1, HostTime(0), HostTime(0));
        }
        n.gaps = vec![(2, 3)];
        let (report, _) = n.settle("feet");
        assert_eq!(report.contradicted, 1);
    }

    fn stream(runs: &[std::ops::RangeInclusive<u64>]) -> Numbers {
        let mut n = Numbers::default();
        for number in runs.iter().cloned().flatten() {
            let time = HostTime(number as i64 * 10);
            n.samples(number, 1, time, time);
        }
        n
    }

    /// What comes out of order fills the hole that it would have left, and nothing is lost twice.
    #[test]
    fn out_of_order_is_not_missing() {
        // 13 to 15 are nowhere.
        for (runs, repeated) in [
            (&[20..=29, 10..=12, 16..=19][..], 7),
            (&[10..=12, 20..=29, 16..=19], 4),
            (&[16..=29, 10..=12], 3),
            (&[16..=29, 20..=29, 10..=12, 20..=29], 23),
        ] {
            let (report, lost) = stream(runs).settle("feet");
            assert_eq!((report.first, report.last), (10, 29), "{runs:?}");
            assert_eq!((report.start, report.end), (HostTime(100), HostTime(290)));
            assert_eq!((report.samples, report.lost), (17, 3), "{runs:?}");
            assert_eq!(report.repeated, repeated, "{runs:?}");
            assert_eq!(lost.len(), 1, "{runs:?}");
            assert_eq!((lost[0].first, lost[0].last), (13, 15), "{runs:?}");
            let times = (lost[0].after, lost[0].before);
            assert_eq!(times, (HostTime(120), HostTime(160)), "{runs:?}");
        }
    }

    #[test]
    fn a_gap_over_a_sample_out_of_order_is_a_contradiction() {
        let mut n = stream(&[20..=29, 10..=19]);
        n.gaps = vec![(5, 12)];
        let (report, lost) = n.settle("feet");
        assert_eq!(
            (report.samples, report.gaps, report.contradicted),
            (20, 8, 3)
        );
        assert_eq!(lost, []);
    }

    /// A batch that begins with what was there and goes on behind it.
    #[test]
    fn a_batch_that_overlaps_leaves_no_hole() {
        let mut n = stream(&[0..=9]);
        n.samples(5, 10, HostTime(50), HostTime(140));
        n.samples(15, 5, HostTime(150), HostTime(190));
        let (report, lost) = n.settle("feet");
        assert_eq!((report.first, report.last, report.samples), (0, 19, 20));
        assert_eq!((report.repeated, report.end), (10, HostTime(190)));
        assert_eq!(lost, []);
    }
}
