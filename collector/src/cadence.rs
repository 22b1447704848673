//! Sampling regularity of a stream: period, jitter and gaps.

use crate::session_stats::{NO_STEP, Sample};

/// Sampling statistics of one stream. All values are 0 for fewer than two samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cadence {
    /// Median interval between consecutive samples on the device clock, ns.
    pub(crate) period_ns: f64,
    /// 99.9th percentile of the deviation from that median, ns. Measured on the device clock, so
    /// that a refined clock map does not count as an irregular camera.
    pub(crate) deviation_ns: f64,
    /// Longest interval between consecutive samples on the host clock, ns.
    pub(crate) longest_gap_ns: i64,
    /// Time of the sample before that gap, host clock, ns.
    pub(crate) longest_gap_at: i64,
    /// Samples whose time does not exceed that of the previous sample.
    pub(crate) backwards: u64,
}

impl Cadence {
    /// Statistics of the samples in recorded order.
    pub(crate) fn of(samples: impl Iterator<Item = Sample>) -> Self {
        let mut cadence = Self::default();
        let mut steps = Vec::new();
        let mut before: Option<i64> = None;
        for Sample { time, step_ns } in samples {
            if step_ns != NO_STEP {
                steps.push(step_ns);
            }
            if let Some(before) = before {
                let gap = time.saturating_sub(before);
                if gap <= 0 {
                    cadence.backwards += 1;
                }
                if gap > cadence.longest_gap_ns {
                    (cadence.longest_gap_ns, cadence.longest_gap_at) = (gap, before);
                }
            }
            before = Some(time);
        }
        if !steps.is_empty() {
            let middle = steps.len() / 2;
            let period = *steps.select_nth_unstable(middle).1;
            let mut off: Vec<u32> = steps.iter().map(|s| s.abs_diff(period)).collect();
            cadence.period_ns = f64::from(period);
            cadence.deviation_ns = f64::from(percentile_99_9(&mut off).unwrap_or(0));
        }
        cadence
    }

    /// Samples per second.
    pub(crate) fn rate_hz(&self) -> f64 {
        if self.period_ns > 0.0 {
            1e9 / self.period_ns
        } else {
            0.0
        }
    }
}

/// 99.9th percentile (nearest rank); the maximum for fewer than 1000 values.
pub(crate) fn percentile_99_9<T: Ord + Copy>(values: &mut [T]) -> Option<T> {
    let rank = (values.len() * 999).div_ceil(1000);
    let index = rank.checked_sub(1)?;
    Some(*values.select_nth_unstable(index).1)
}

/// Median; the upper one of the two middle values.
pub(crate) fn median<T: Ord + Copy>(values: &mut [T]) -> Option<T> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable(middle).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_outlier_in_a_thousand_is_ignored_and_two_are_not() {
        let stream = |odd: usize| {
            let mut time = 0;
            let samples: Vec<Sample> = (0..2001)
                .map(|i| {
                    let step_ns = if i > 0 && i <= odd {
                        10_600_000
                    } else {
                        10_000_000
                    };
                    time += i64::from(step_ns);
                    Sample { time, step_ns }
                })
                .collect();
            Cadence::of(samples.into_iter())
        };
        assert_eq!(stream(2).deviation_ns, 0.0);
        assert_eq!(stream(3).deviation_ns, 600_000.0);
        assert_eq!(stream(3).longest_gap_ns, 10_600_000);
        assert_eq!(stream(0).rate_hz(), 100.0);
    }

    #[test]
    fn non_increasing_times_are_counted() {
        let at = |time| Sample {
            time,
            step_ns: NO_STEP,
        };
        let cadence = Cadence::of([5, 5, 4, 9].map(at).into_iter());
        assert_eq!((cadence.backwards, cadence.longest_gap_ns), (2, 5));
        assert_eq!(cadence.longest_gap_at, 4);
        assert_eq!(Cadence::of([].into_iter()), Cadence::default());
    }

    #[test]
    fn nearest_rank_percentiles() {
        assert_eq!(percentile_99_9::<u32>(&mut []), None);
        assert_eq!(
            percentile_99_9(&mut (1..=999).collect::<Vec<u32>>()),
            Some(999)
        );
        assert_eq!(
            percentile_99_9(&mut (1..=1000).collect::<Vec<u32>>()),
            Some(999)
        );
        assert_eq!(median(&mut [3, 1, 2]), Some(2));
    }
}
