//! Distinguishes late samples from a line that is too low, by the heights of samples above the
//! line.
//!
//! After a device clock has stepped back, every sample is above the old line, as every sample is
//! during a burst of late arrivals. No distribution is assumed: past heights are stored as a
//! histogram, and a run of k samples none of which was lower than m has the probability S(m)^k,
//! where S is the fraction of samples that are usually above m. A run that is too improbable raises
//! an alarm; it ends when a sample is low enough to make the run probable again.

use super::config::TailConfig;
use super::fit::Line;
use super::hull::Point;

/// Histogram bins: four per factor of two, from 100 ns up to minutes.
const BINS: usize = 128;
const MIN_HEIGHT_NS: f64 = 100.0;
/// Maximum number of runs followed, from the longest to the newest.
const MAX_RUNS: usize = 24;

/// Heights of samples above the line, and the runs of high ones.
#[derive(Clone, Debug)]
pub(super) struct Tail {
    bins: [u32; BINS],
    total: u32,
    /// Samples in this bin or above, when the line was last fitted.
    above: [u32; BINS],
    runs: Vec<Run>,
    /// The last sample before all runs.
    start: Option<Before>,
    count: u64,
    /// Height of a usual delay, ns.
    usual: f64,
}

/// All samples since some sample, with their lowest height `lowest`.
#[derive(Clone, Copy, Debug)]
struct Run {
    lowest: Point,
    height: f64,
    /// Number and arrival of the lowest sample.
    at: u64,
    arrival: i64,
    /// The last sample before the run.
    after: Option<Before>,
}

#[derive(Clone, Copy, Debug)]
struct Before {
    x: f64,
    at: u64,
    arrival: i64,
}

impl Run {
    fn as_before(&self) -> Before {
        Before {
            x: self.lowest.x,
            at: self.at,
            arrival: self.arrival,
        }
    }
}

/// A run of samples that are all too high.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alarm {
    /// Arrival of the last sample before the run.
    pub after: Option<i64>,
    /// Height of the lowest sample of the run, ns.
    pub height: f64,
}

impl Tail {
    pub(super) fn new() -> Self {
        Self {
            bins: [0; BINS],
            total: 0,
            above: [0; BINS],
            runs: Vec::with_capacity(MAX_RUNS + 1),
            start: None,
            count: 0,
            usual: 0.0,
        }
    }

    /// Processes a sample; returns an alarm if a run of samples higher than `tolerance` is
    /// improbable.
    pub(super) fn watch(
        &mut self,
        lowest: Point,
        height: f64,
        arrival: i64,
        tolerance: f64,
        config: &TailConfig,
    ) -> Option<Alarm> {
        self.count += 1;
        self.push(Run {
            lowest,
            height,
            at: self.count,
            arrival,
            after: self.start,
        });
        let improbable = |run: &&Run| {
            // A delayed sample delays those behind it: samples closer together than a usual delay
            // are not independent of each other.
            let (at, since) = run.after.map_or((0, f64::INFINITY), |before| {
                (before.at, arrival.saturating_sub(before.arrival) as f64)
            });
            let length = ((self.count - at) as f64).min(since / self.usual.max(1.0));
            run.height > tolerance && length * self.nats(run.height) > config.alarm_nats
        };
        let run = self.runs.iter().find(improbable)?;
        Some(Alarm {
            after: run.after.map(|before| before.arrival),
            height: run.height,
        })
    }

    /// Adds the run that starts with a sample; it replaces all runs that are not lower.
    fn push(&mut self, mut run: Run) {
        if let Some(last) = self.runs.last() {
            run.after = Some(last.as_before());
        }
        while let Some(last) = self.runs.pop_if(|last| last.height >= run.height) {
            run.after = last.after;
        }
        if self.runs.len() == MAX_RUNS {
            self.start = Some(self.runs.remove(0).as_before());
        }
        self.runs.push(run);
    }

    /// Adds a height to the histogram.
    pub(super) fn learn(&mut self, height: f64, config: &TailConfig) {
        self.bins[bin(height)] += 1;
        self.total += 1;
        if self.total >= config.halving_samples {
            self.bins.iter_mut().for_each(|b| *b /= 2);
            self.total = self.bins.iter().sum();
        }
    }

    /// The line has changed: heights of the runs are recomputed.
    pub(super) fn follow(&mut self, line: &Line, config: &TailConfig) {
        let mut sum = 0;
        for (above, count) in self.above.iter_mut().zip(self.bins).rev() {
            sum += count;
            *above = sum;
        }
        self.usual = self.quantile(config.delay_quantile);
        for mut run in std::mem::take(&mut self.runs) {
            if run.lowest.x < line.from_x {
                // The line gives no height for it.
                self.start = Some(run.as_before());
                continue;
            }
            if run.after.map_or(0.0, |before| before.x) < line.from_x {
                run.after = Some(run.as_before());
            }
            run.height = run.lowest.lag - line.lag(run.lowest.x);
            self.push(run);
        }
    }

    /// Discards the runs but not the histogram: the line has been replaced.
    pub(super) fn restart(&mut self) {
        self.runs.clear();
        self.start = None;
        self.count = 0;
    }

    /// Number of samples after which one lower than `height` is overdue.
    pub(super) fn overdue(&self, height: f64, config: &TailConfig) -> u64 {
        (config.alarm_nats / self.nats(height).max(1e-3)).ceil() as u64
    }

    /// Height at which one lower sample in `samples` is not overdue yet, ns.
    pub(super) fn unnoticed(&self, samples: f64, config: &TailConfig) -> f64 {
        let share = (-config.alarm_nats / samples.max(1.0)).exp();
        let least = share * (f64::from(self.above[0]) + 1.0) - 1.0;
        let below = |above: &u32| f64::from(*above) < least;
        self.above.iter().position(below).map_or(0.0, upper_edge)
    }

    /// -ln of the fraction of samples that are as high or higher.
    fn nats(&self, height: f64) -> f64 {
        let [total, above] = [self.above[0], self.above[bin(height)]].map(|n| f64::from(n) + 1.0);
        (total / above).ln()
    }

    /// Height that this fraction of the samples does not exceed, ns, rounded up to a bin's edge.
    pub(super) fn quantile(&self, share: f64) -> f64 {
        let rank = (f64::from(self.total) * share).ceil() as u32;
        let mut below = 0;
        for (i, &count) in self.bins.iter().enumerate() {
            below += count;
            if below >= rank.max(1) {
                return upper_edge(i);
            }
        }
        0.0
    }
}

/// Bin of a height: the exponent and the first two bits of the mantissa.
fn bin(height: f64) -> usize {
    let scaled = (height / MIN_HEIGHT_NS).max(1.0);
    let index = (scaled.to_bits() >> 50).saturating_sub(1023 << 2);
    (index as usize).min(BINS - 1)
}

fn upper_edge(bin: usize) -> f64 {
    MIN_HEIGHT_NS * f64::from_bits((bin as u64 + 1 + (1023 << 2)) << 50)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_cover_their_heights() {
        for height in [0.0, 99.0, 100.0, 124.9, 125.1, 1e4, 3.3e6, 1e9, 1e15] {
            let edge = upper_edge(bin(height));
            assert!(edge > height || bin(height) == BINS - 1, "{height} {edge}");
            assert!(edge <= 1.26 * height.max(MIN_HEIGHT_NS) || bin(height) == BINS - 1);
        }
    }

    #[test]
    fn a_run_of_high_samples_raises_an_alarm_and_a_low_one_ends_it() {
        let config = TailConfig::default();
        let mut tail = Tail::new();
        let mut number = 0_u64;
        let mut next = |tail: &mut Tail, height: f64| {
            number += 1;
            let p = Point {
                x: number as f64,
                lag: height,
            };
            tail.watch(p, height, number as i64 * 10_000_000, 1e3, &config)
        };
        // Heights spread evenly over 1 ms.
        for i in 0..1000_u64 {
            let height = (i * 7919 % 1000) as f64 * 1e3;
            assert!(next(&mut tail, height).is_none(), "sample {i}");
            tail.learn(height, &config);
            tail.follow(&Line::default(), &config);
        }
        let quiet = (0..100).position(|_| next(&mut tail, 0.8e6).is_some());
        assert!((8..16).contains(&quiet.expect("an alarm")), "{quiet:?}");
        let alarm = next(&mut tail, 0.9e6).expect("the run continues");
        assert_eq!(alarm.after, Some(1000 * 10_000_000));
        assert!(next(&mut tail, 1e4).is_none());
    }
}
