//! The Allan variance of a rate over the averaging time.

use std::ops::Range;

use super::deviation::{phase, second_differences};

/// Averaging times per octave of τ in a curve made by [`curve`].
pub(super) const POINTS_PER_OCTAVE: f64 = 4.0;
/// Minimum length of a run, in averaging times.
pub(super) const MIN_LENGTHS: usize = 5;

/// One point of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Averaging factor: samples in each average.
    pub factor: usize,
    /// Averaging time, s.
    pub tau_s: f64,
    /// Allan variance, the square of the rate's unit.
    pub variance: f64,
    /// Number of overlapping differences in the mean.
    pub terms: u64,
}

impl Point {
    /// Allan deviation, in the rate's unit.
    pub fn deviation(&self) -> f64 {
        self.variance.sqrt()
    }
}

/// A curve of overlapping Allan variances.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Time from sample to sample, s.
    pub period_s: f64,
    /// Lengths of the runs without a gap, samples.
    pub runs: Vec<usize>,
    /// The points, by averaging time.
    pub points: Vec<Point>,
}

/// The overlapping Allan variance of a rate, at averaging factors four to the octave, up to a fifth
/// of the longest run. `runs` are the runs without a gap; a run that is too short for a factor is
/// not used for it. Time is proportional to samples times factors, memory is 8 bytes per sample.
///
/// # Panics
/// If a run extends beyond the samples.
///
/// White noise of 0.01 rad/s in each sample, at 100 Hz: the density is 0.01 rad/s times the root of
/// the period.
///
/// ```
/// use calib::allan::{Coefficient, FitConfig, curve, fit};
///
/// # let mut state = 7_u64;
/// # let mut uniform = || {
/// #     state ^= state << 13;
/// #     state ^= state >> 7;
/// #     state ^= state << 17;
/// #     (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
/// # };
/// // The sum of twelve uniform numbers has a variance of 1.
/// let rate: Vec<f64> = (0..6000).map(|_| 0.01 * (0..12).map(|_| uniform()).sum::<f64>()).collect();
/// let curve = curve(&rate, &[0..rate.len()], 0.01);
/// let fit = fit(&curve, &FitConfig::default()).ok_or("no noise")?;
/// let density = fit.value(Coefficient::White).known().ok_or("not determined")?;
/// assert!((density / 1e-3 - 1.0).abs() < 0.1, "{density} rad/s/sqrt(Hz)");
/// // A minute does not determine a random walk: there is a limit and no value.
/// assert_eq!(fit.value(Coefficient::Walk).known(), None);
/// # Ok::<(), &str>(())
/// ```
pub fn curve(rate: &[f64], runs: &[Range<usize>], period_s: f64) -> Curve {
    let longest = runs.iter().map(Range::len).max().unwrap_or(0);
    let factors = factors(longest / MIN_LENGTHS);
    let mut sums = vec![(0.0, 0_u64); factors.len()];
    for run in runs {
        let phase = phase(&rate[run.clone()]);
        for (factor, (sum, terms)) in factors.iter().zip(&mut sums) {
            if run.len() >= MIN_LENGTHS * factor {
                *sum += second_differences(&phase, *factor);
                *terms += (phase.len() - 2 * factor) as u64;
            }
        }
    }
    let points = factors.into_iter().zip(sums);
    let points = points.filter(|(_, (_, terms))| *terms > 0);
    let points = points.map(|(factor, (sum, terms))| Point {
        factor,
        tau_s: factor as f64 * period_s,
        // The phase is in units of rate times samples.
        variance: sum / (2.0 * (factor as f64).powi(2) * terms as f64),
        terms,
    });
    Curve {
        period_s,
        runs: runs.iter().map(Range::len).collect(),
        points: points.collect(),
    }
}

/// Whole factors from 1 to `last`, as evenly spaced on a log scale as whole numbers allow.
pub(super) fn factors(last: usize) -> Vec<usize> {
    let steps = (0..).map(|i| (f64::from(i) / POINTS_PER_OCTAVE).exp2().round() as usize);
    let mut factors: Vec<usize> = steps.take_while(|factor| *factor <= last).collect();
    factors.dedup();
    factors
}
