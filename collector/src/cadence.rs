//! How regularly the samples of a stream come.

use crate::session_stats::{NO_STEP, Sample};

/// The rhythm of one stream. All values are 0 where there are not two samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cadence {
    /// Median distance of neighbouring samples by the device's clock, ns.
    pub period_ns: f64,
    /// 99.9 % of neighbouring samples deviate from that by no more than this, ns. By the device's
    /// clock, so that a refined clock map does not count as an irregular camera.
    pub deviation_ns: f64,
    /// Longest distance of one sample from the next, host clock, ns.
    pub longest_gap_ns: i64,
    /// Time of the sample before it.
    pub longest_gap_at: i64,
    /// Samples whose time is not after that of the sample before.
    pub backwards: u64,
}

impl Cadence {
    /// The rhythm of samples in the order recorded.
    pub fn of(samples: impl Iterator<Item = Sample>) -> Self {
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
    pub fn rate_hz(&self) -> f64 {
        if self.period_ns > 0.0 {
            1e9 / self.period_ns
        } else {
            0.0
        }
    }
}

/// The value that 99.9 % do not exceed (nearest rank): of fewer than 1000 values the greatest.
pub fn percentile_99_9<T: Ord + Copy>(values: &mut [T]) -> Option<T> {
    let rank = (values.len() * 999).div_ceil(1000);
    let index = rank.checked_sub(1)?;
    Some(*values.select_nth_unstable(index).1)
}

/// The middle value; the upper one of two.
pub fn median<T: Ord + Copy>(values: &mut [T]) -> Option<T> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable(middle).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_outlier_in_a_thousand_is_forgiven_and_two_are_not() {
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
    fn time_that_does_not_rise_is_counted() {
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
    fn ranks() {
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
