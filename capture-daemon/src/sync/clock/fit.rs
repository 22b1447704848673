//! Fit of a line below the points: clock offset and rate with their uncertainty.
//!
//! An arrival is late, never early. Near the line of the fastest possible arrivals the samples
//! therefore resemble a Poisson process above a sharp edge, with some density per ns of height; the
//! distribution of the latencies further up does not matter. Under that model, with a flat prior on
//! the offset and on the rate within its limits, the posterior of the line has a closed form: the
//! probability of a rate falls exponentially with the distance of the best line of that rate below
//! the best line of all (measured above the samples' mean time), and only points on the lower
//! convex hull enter. One pass over the hull gives mean, variance and evidence.
//!
//! * The estimate is the posterior mean: the maximum (the hull's edge above the mean time, the
//!   linear program of Moon, Skelly and Towsley, INFOCOM 1999) is always too high, the mean is not.
//! * *Constant or affine* is decided by the ratio of their marginal likelihoods.
//! * *The length of a line's window* is decided by Lepski's rule: of the windows that end now, each
//!   twice as long as the last, take the longest one that agrees with every shorter one.
//! * The density is measured from the lowest samples of the window's blocks, at three depths, and
//!   the most conservative of the three is used, as is the gap that must be expected below the
//!   lowest sample: latencies that are rarely near their minimum get a wide sigma.

use std::collections::VecDeque;

use super::config::FitConfig;
use super::hull::{Block, Point, extend};

/// Prior of a clock's rate: without samples, or from before a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct RatePrior {
    /// Expected rate. Host ns per device ns, minus 1.
    pub expected: f64,
    /// Maximum deviation of the rate from zero.
    pub limit: f64,
}

/// `lag(x) = lag_ref + rate * (x - x_ref)`, fitted to samples from `from_x` to `to_x`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Line {
    pub x_ref: f64,
    pub lag_ref: f64,
    pub rate: f64,
    /// Sigma of `lag_ref`, ns.
    pub sigma_ref: f64,
    /// Sigma of `rate`, independent of `sigma_ref`.
    pub sigma_rate: f64,
    pub from_x: f64,
    pub to_x: f64,
}

impl Line {
    pub(super) fn lag(&self, x: f64) -> f64 {
        self.lag_ref + self.rate * (x - self.x_ref)
    }

    /// Sigma of `lag(x)`; beyond the samples the rate may change by `wander` per ns.
    pub(super) fn sigma(&self, x: f64, wander: f64) -> f64 {
        let beyond = (x - self.to_x).max(self.from_x - x).max(0.0);
        let statistical = self.sigma_ref.hypot(self.sigma_rate * (x - self.x_ref));
        statistical + 0.5 * wander * beyond * beyond
    }
}

/// A line and how it was chosen.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Fit {
    pub line: Line,
    /// The samples do not support a rate other than the expected one.
    pub constant: bool,
}

/// Parameters of a fit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Terms {
    pub prior: RatePrior,
    /// Latency jitter to assume while there are too few samples to measure it, ns.
    pub jitter: f64,
    /// Rounding of ticks and arrivals, ns.
    pub floor: f64,
    /// Lower bound of the sigma of a time, ns.
    pub min_sigma: f64,
}

/// Fits the present line. `blocks` run from old to new and are not empty.
pub(super) fn fit(
    blocks: &VecDeque<Block>,
    terms: &Terms,
    config: &FitConfig,
    scratch: &mut Scratch,
) -> Fit {
    let Scratch { hull, minima } = scratch;
    hull.clear();
    let (mut count, mut x_sum, mut lag_sum) = (0_u32, 0.0, 0.0);
    let to_x = blocks[blocks.len() - 1].last_x();
    let mut accepted: Vec<Fit> = Vec::with_capacity(8);
    // The newest block is still open and does not count.
    let mut next = (config.min_blocks + 1).min(blocks.len());
    for (age, block) in blocks.iter().rev().enumerate() {
        for &p in block.hull().iter().rev() {
            extend(hull, p);
        }
        count += block.count;
        x_sum += block.x_sum();
        lag_sum += block.lag_sum();
        if age + 1 != next {
            continue;
        }
        let window = Window {
            hull,
            count: f64::from(count),
            x_mean: x_sum / f64::from(count),
            lag_mean: lag_sum / f64::from(count),
            from_x: block.first_x(),
            to_x,
        };
        let longer = window.fit(
            blocks.range(blocks.len() - next..blocks.len() - 1),
            terms,
            config,
            minima,
        );
        let agrees = |shorter: &Fit| {
            [to_x, shorter.line.from_x].into_iter().all(|x| {
                let apart = (longer.line.lag(x) - shorter.line.lag(x)).abs();
                apart <= config.agreement_sigmas * shorter.line.sigma(x, 0.0)
            })
        };
        if !accepted.iter().all(agrees) {
            break;
        }
        accepted.push(longer);
        next = (2 * next - 1).min(blocks.len());
    }
    let Some((mut chosen, shorter)) = accepted.split_last().map(|(c, rest)| (*c, rest)) else {
        unreachable!("the shortest window agrees with itself");
    };
    // The remaining distance from half the window, or from shorter ones beyond their own
    // uncertainty, is a curve or a step that the line does not model.
    let unmodelled = shorter.iter().rev().enumerate().map(|(i, s)| {
        let apart = (chosen.line.lag(to_x) - s.line.lag(to_x)).abs();
        if i == 0 {
            apart
        } else {
            apart - s.line.sigma(to_x, 0.0)
        }
    });
    let unmodelled = unmodelled.fold(0.0, f64::max);
    let sigma = chosen
        .line
        .sigma_ref
        .hypot(config.window_difference_ratio * unmodelled);
    chosen.line.sigma_ref = sigma.max(terms.min_sigma);
    chosen
}

/// Buffers reused by every fit.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    hull: Vec<Point>,
    minima: Vec<f64>,
}

/// The samples of one window. `hull` runs from right to left.
struct Window<'a> {
    hull: &'a [Point],
    count: f64,
    x_mean: f64,
    lag_mean: f64,
    from_x: f64,
    to_x: f64,
}

impl Window<'_> {
    fn fit<'b>(
        &self,
        blocks: impl Iterator<Item = &'b Block>,
        terms: &Terms,
        config: &FitConfig,
        minima: &mut Vec<f64>,
    ) -> Fit {
        let (rate, height) = self.highest(terms.prior.limit);
        minima.clear();
        let at_zero = height - rate * self.x_mean;
        minima.extend(blocks.map(|b| b.lowest_above(at_zero, rate)));
        let scale = if minima.len() < config.min_blocks {
            // Too few for the edge alone: as if the latencies were exponential. The expected jitter
            // counts as one sample.
            let heights = self.count * (self.lag_mean - height) + terms.jitter;
            heights / (self.count - 1.0).max(1.0) / self.count
        } else {
            // With fewer blocks, it is more likely that some of them look like a sharp edge by
            // chance.
            edge_scale(minima, config) * (1.0 + config.small_sample_blocks / minima.len() as f64)
        };
        let scale = scale.max(terms.floor);
        self.posterior(rate, height, scale, terms, config)
    }

    /// Height at `x_mean` of the highest line of this rate that lies below all points.
    fn height(&self, rate: f64) -> f64 {
        let at = |p: &Point| p.lag + rate * (self.x_mean - p.x);
        self.hull.iter().map(at).fold(f64::INFINITY, f64::min)
    }

    /// Rate and height of the line below all points that is highest at `x_mean`.
    fn highest(&self, limit: f64) -> (f64, f64) {
        let edge = self.hull.windows(2).find(|e| e[1].x <= self.x_mean);
        let rate = edge.map_or(0.0, |e| slope(e[1], e[0])).clamp(-limit, limit);
        (rate, self.height(rate))
    }

    /// Mean and spread of all lines below the points, each weighted by its likelihood.
    fn posterior(
        &self,
        best_rate: f64,
        best_height: f64,
        scale: f64,
        terms: &Terms,
        config: &FitConfig,
    ) -> Fit {
        let RatePrior { expected, limit } = terms.prior;
        let mut sums = Moments::default();
        for (i, p) in self.hull.iter().enumerate() {
            // A line of a rate between the slopes of the edges beside a hull point touches it.
            let left = self
                .hull
                .get(i + 1)
                .map_or(-limit, |&l| slope(l, *p).max(-limit));
            let right = match i.checked_sub(1) {
                Some(r) => slope(*p, self.hull[r]).min(limit),
                None => limit,
            };
            if left < right {
                let arm = self.x_mean - p.x;
                let nearest = if arm > 0.0 { right } else { left };
                let drop = (best_height - (p.lag + nearest * arm)).max(0.0);
                sums.add(nearest - best_rate, arm, right - left, drop, scale);
            }
        }
        let mean_rate = best_rate + sums.rate / sums.mass;
        let mean_drop = sums.drop / sums.mass;
        let var_rate = (sums.rate2 / sums.mass - (sums.rate / sums.mass).powi(2)).max(0.0);
        // Given the rate, the height falls below the highest one by an exponential of this scale.
        let var_height = (sums.drop2 / sums.mass - mean_drop.powi(2)).max(0.0) + scale * scale;
        let covariance = -(sums.rate_drop / sums.mass - sums.rate / sums.mass * mean_drop);

        let log_affine = (sums.mass / (2.0 * limit)).ln();
        let constant_height = self.height(expected);
        let log_constant = (constant_height - best_height) / scale;
        let constant = log_constant + config.min_log_evidence >= log_affine;

        let mean_height = best_height - mean_drop - scale;
        let (rate, height) = if constant {
            (expected, constant_height - scale)
        } else {
            (mean_rate, mean_height)
        };
        // At this time offset and rate are independent.
        let shift = if var_rate > 0.0 {
            -covariance / var_rate
        } else {
            0.0
        };
        let x_ref = (self.x_mean + shift).clamp(self.from_x, self.to_x);
        let shift = x_ref - self.x_mean;
        let var_ref = (var_height + 2.0 * shift * covariance + shift * shift * var_rate).max(0.0);
        let model_rate = rate - mean_rate;
        let model_ref = height - mean_height + model_rate * shift;
        let line = Line {
            x_ref,
            lag_ref: height + rate * shift,
            rate,
            sigma_ref: config.sigma_inflation * (var_ref + model_ref * model_ref).sqrt()
                + terms.floor,
            sigma_rate: config.sigma_inflation * (var_rate + model_rate * model_rate).sqrt(),
            from_x: self.from_x,
            to_x: self.to_x,
        };
        Fit { line, constant }
    }
}

fn slope(a: Point, b: Point) -> f64 {
    (b.lag - a.lag) / (b.x - a.x)
}

/// Mean distance between neighbouring samples right above the line, ns: one over the density.
///
/// `minima` holds the lowest height of each block. The line itself used up two of them.
fn edge_scale(minima: &mut [f64], config: &FitConfig) -> f64 {
    let n = minima.len();
    let mut kth = |depth: usize| *minima.select_nth_unstable_by(depth - 1, f64::total_cmp).1;
    let mut widest = 0.0_f64;
    let [.., last] = config.edge_depths;
    for depth in config.edge_depths {
        if 2 * depth <= n || depth == last {
            widest = widest.max(kth(depth) / (depth - 2) as f64);
        }
    }
    if n >= 64 {
        // Heights grow as the depth's power 1/a; if a is more than 1 the density falls towards the
        // edge, and below the lowest sample there is a gap of this size (the estimator of Pickands
        // 1975, at depths that are four times each other).
        let (low, middle, high) = (kth(n / 64), kth(n / 16), kth(n / 4));
        let growth = (high - middle) / (middle - low).max(f64::MIN_POSITIVE);
        let gap = (middle - low) * growth / (growth - 1.0).max(config.min_growth) - middle;
        widest = widest.max(gap);
    }
    widest
}

/// Unnormalized moments of (rate, drop), rate relative to the best one.
#[derive(Default)]
struct Moments {
    mass: f64,
    rate: f64,
    rate2: f64,
    drop: f64,
    drop2: f64,
    rate_drop: f64,
}

impl Moments {
    /// Adds the rates that touch one hull point, a stretch of length `width` from `nearest` (where
    /// the drop is smallest) away. Along it the drop grows by `|arm|` per unit of rate.
    fn add(&mut self, nearest: f64, arm: f64, width: f64, drop: f64, scale: f64) {
        let away = if arm > 0.0 { -1.0 } else { 1.0 };
        let arm = arm.abs();
        let [p0, p1, p2] = exponential_moments(arm * width / scale);
        let weight = (-drop / scale).exp();
        let (m0, m1, m2) = (
            weight * width * p0,
            weight * width * width * p1,
            weight * width.powi(3) * p2,
        );
        self.mass += m0;
        self.rate += nearest * m0 + away * m1;
        self.rate2 += nearest * nearest * m0 + 2.0 * nearest * away * m1 + m2;
        self.drop += drop * m0 + arm * m1;
        self.drop2 += drop * drop * m0 + 2.0 * drop * arm * m1 + arm * arm * m2;
        self.rate_drop +=
            nearest * drop * m0 + (nearest * arm + away * drop) * m1 + away * arm * m2;
    }
}

/// Integrals over t from 0 to 1 of t^j exp(-z t), j = 0, 1, 2, for z >= 0.
fn exponential_moments(z: f64) -> [f64; 3] {
    if z < 0.5 {
        let mut sums = [0.0; 3];
        let mut term = 1.0;
        for k in 0..14 {
            for (j, sum) in sums.iter_mut().enumerate() {
                *sum += term / (k + j + 1) as f64;
            }
            term *= -z / (k + 1) as f64;
        }
        return sums;
    }
    let end = (-z).exp();
    let p0 = (1.0 - end) / z;
    let p1 = (p0 - end) / z;
    [p0, p1, (2.0 * p1 - end) / z]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closed_forms_of_the_moments_agree_at_the_switch() {
        let numeric = |z: f64, j: i32| {
            let n = 20_000;
            let at = |i: usize| (i as f64 + 0.5) / f64::from(n);
            (0..n as usize)
                .map(|i| at(i).powi(j) * (-z * at(i)).exp())
                .sum::<f64>()
                / f64::from(n)
        };
        for z in [0.0, 0.1, 0.499_999, 0.500_001, 3.0, 40.0, 900.0] {
            for (j, value) in exponential_moments(z).into_iter().enumerate() {
                let expected = numeric(z, j as i32);
                assert!(
                    (value - expected).abs() < 1e-5 * (1.0 + expected),
                    "z {z} j {j}"
                );
            }
        }
    }

    /// Reference implementation: the same posterior summed over a grid of rates and heights.
    #[test]
    fn posterior_equals_the_reference_sum_over_a_grid() {
        let points = [
            (0.0, 900.0),
            (1e6, 350.0),
            (3e6, 100.0),
            (6e6, 120.0),
            (9e6, 700.0),
        ];
        let mut hull: Vec<Point> = points.iter().map(|&(x, lag)| Point { x, lag }).collect();
        hull.reverse();
        let window = Window {
            hull: &hull,
            count: 5.0,
            x_mean: 4.2e6,
            lag_mean: 0.0,
            from_x: 0.0,
            to_x: 9e6,
        };
        let (scale, limit) = (60.0, 2e-4);
        let prior = RatePrior {
            expected: 1.0,
            limit,
        };
        let terms = Terms {
            prior,
            jitter: 0.0,
            floor: 0.0,
            min_sigma: 0.0,
        };
        let (rate, height) = window.highest(limit);
        let config = FitConfig::default();
        let fit = window.posterior(rate, height, scale, &terms, &config).line;

        let (mut mass, mut r, mut rr, mut end, mut end2) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let steps = 4000;
        for i in 0..steps {
            let b = -limit + (f64::from(i) + 0.5) * 2.0 * limit / f64::from(steps);
            let top = window.height(b);
            for k in 0..400 {
                let h = top - (f64::from(k) + 0.5) * 3.0;
                let weight = ((h - height) / scale).exp();
                let at_end = h + b * (9e6 - window.x_mean);
                mass += weight;
                r += weight * b;
                rr += weight * b * b;
                end += weight * at_end;
                end2 += weight * at_end * at_end;
            }
        }
        let (mean, sd) = (r / mass, (rr / mass - (r / mass).powi(2)).sqrt());
        assert!((fit.rate - mean).abs() < 0.01 * sd, "{} {}", fit.rate, mean);
        assert!((fit.sigma_rate / config.sigma_inflation - sd).abs() < 0.01 * sd);
        let (mean, sd) = (end / mass, (end2 / mass - (end / mass).powi(2)).sqrt());
        assert!(
            (fit.lag(9e6) - mean).abs() < 0.02 * sd,
            "{} {}",
            fit.lag(9e6),
            mean
        );
        assert!((fit.sigma(9e6, 0.0) / config.sigma_inflation - sd).abs() < 0.02 * sd);
    }
}
