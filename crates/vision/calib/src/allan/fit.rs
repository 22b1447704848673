//! Noise coefficients of a curve of Allan variances.
//!
//! Method: the model is linear in Q², N², B² and K². Each choice of terms is fitted to the
//! variances by generalized least squares, weighted by the covariance of the points under this
//! model (`covariance.rs`: neighbouring points overlap and are correlated), repeated until it no
//! longer changes. Of the choices with positive powers, the most likely is taken; quantization must
//! lower the Bayesian information criterion as well. If the shortest averaging times do not fit,
//! for example because the sensor filters its output, the fit begins after them, at 2 s at the
//! latest. A curve that does not follow the model has [`Fit::misfit`] above zero: this fraction of
//! each point is then added to its uncertainty, with the value of maximum likelihood.
//!
//! Uncertainties: one standard deviation from the fit, and an interval of 95 % that treats each
//! power as chi-squared with the degrees of freedom that match its variance. They are those of the
//! model with bias instability *and* random walk, even if one of the two is estimated as zero:
//! either can raise the end of a short curve, and excluding one because the other is sufficient
//! makes the other too large and its uncertainty too small. The interval also contains two standard
//! deviations on either side. A power less than three standard deviations above zero is not
//! determined.

use nalgebra::{DMatrix, DVector};

use super::chi2;
use super::config::FitConfig;
use super::covariance::{Covariances, Powers};
use super::variance::{Curve, POINTS_PER_OCTAVE};

/// The four kinds of noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coefficient {
    /// Q, rad for a gyroscope.
    Quantisation,
    /// N, rad/s/√Hz.
    White,
    /// B, rad/s; the curve is flat at 0.664 B.
    Instability,
    /// K, rad/s²/√Hz.
    Walk,
}

impl Coefficient {
    /// All coefficients, in the order of a model's powers.
    pub const ALL: [Self; 4] = [
        Self::Quantisation,
        Self::White,
        Self::Instability,
        Self::Walk,
    ];

    /// Allan variance at τ for a coefficient of 1.
    pub fn variance(self, tau_s: f64) -> f64 {
        match self {
            Self::Quantisation => 3.0 / (tau_s * tau_s),
            Self::White => 1.0 / tau_s,
            Self::Instability => 2.0 * std::f64::consts::LN_2 / std::f64::consts::PI,
            Self::Walk => tau_s / 3.0,
        }
    }
}

/// Estimate of a coefficient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// It is determined.
    Known {
        /// The best estimate.
        value: f64,
        /// One standard deviation.
        sigma: f64,
        /// 95 % confidence interval.
        interval: [f64; 2],
    },
    /// Not determined; upper limit at 95 %.
    Below(f64),
}

impl Value {
    /// The value, if it is determined.
    pub fn known(self) -> Option<f64> {
        match self {
            Self::Known { value, .. } => Some(value),
            Self::Below(_) => None,
        }
    }
}

/// A point with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scatter {
    /// Averaging time, s.
    pub tau_s: f64,
    /// Equivalent degrees of freedom of the Allan variance, under the fitted model.
    pub freedom: f64,
    /// Measured Allan deviation.
    pub deviation: f64,
    /// Its 95 % confidence interval.
    pub interval: [f64; 2],
}

/// A fitted model.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    values: [Value; 4],
    powers: Powers,
    /// The shortest averaging time that was used, s.
    pub from_s: f64,
    /// Fraction by which points deviate from the model beyond their scatter; 0 for a curve that
    /// follows it.
    pub misfit: f64,
    /// Every point of the curve with its uncertainty.
    pub points: Vec<Scatter>,
}

impl Fit {
    /// Estimate of a coefficient.
    pub fn value(&self, coefficient: Coefficient) -> Value {
        self.values[coefficient as usize]
    }

    /// Allan deviation of the fitted model at τ.
    pub fn deviation(&self, tau_s: f64) -> f64 {
        model(&self.powers, tau_s).sqrt()
    }

    /// Contribution of a term of the model to the deviation at τ; `None` for a term that is absent.
    pub fn part(&self, coefficient: Coefficient, tau_s: f64) -> Option<f64> {
        let power = self.powers[coefficient as usize];
        (power > 0.0).then(|| (power * coefficient.variance(tau_s)).sqrt())
    }
}

/// Fits the noise model to a curve. `None` with fewer than eight points or if one of them is not
/// above zero: a sensor with constant values has no measurable noise.
pub fn fit(curve: &Curve, config: &FitConfig) -> Option<Fit> {
    Fitter::new(curve, config).fit(curve)
}

/// Fits curves with the same factors and runs, such as the axes of one sensor.
pub struct Fitter {
    config: FitConfig,
    covariances: Covariances,
}

impl Fitter {
    /// Prepares curves of this shape.
    pub fn new(curve: &Curve, config: &FitConfig) -> Self {
        Self {
            config: *config,
            covariances: Covariances::new(curve),
        }
    }

    /// As [`fit`].
    ///
    /// # Panics
    /// If the number of points differs from the curve given to [`Self::new`].
    pub fn fit(&self, curve: &Curve) -> Option<Fit> {
        let config = &self.config;
        let taus: Vec<f64> = curve.points.iter().map(|p| p.tau_s).collect();
        let variances: Vec<f64> = curve.points.iter().map(|p| p.variance).collect();
        let usable = |v: &f64| v.is_finite() && *v > 0.0;
        if taus.len() < config.min_points || !variances.iter().all(usable) {
            return None;
        }
        let starts =
            (0..=taus.len() - config.min_points).take_while(|&i| taus[i] <= config.max_start_s);
        let at = |from: usize| Job {
            config,
            covariances: &self.covariances,
            taus: &taus,
            variances: &variances,
            from,
            period_s: curve.period_s,
            price: (curve.runs.iter().sum::<usize>() as f64).ln(),
        };
        let sound = |job: &Job<'_>| job.best(&[0.0]).filter(|found| !job.is_misfit(found));
        let whole = at(0);
        if let Some(solution) = sound(&whole) {
            return Some(whole.report(&solution));
        }
        // The shortest averages deviate. A filter has an effect far beyond its own length, so the
        // white noise must be the same an octave later.
        let octave = POINTS_PER_OCTAVE as usize;
        let starts: Vec<usize> = starts.collect();
        for &from in starts
            .iter()
            .skip(1)
            .take(starts.len().saturating_sub(octave + 1))
        {
            let (near, far) = (at(from), at(from + octave));
            let Some((before, after)) = sound(&near).zip(sound(&far)) else {
                continue;
            };
            let moved = (before.powers[1] - after.powers[1]).abs();
            if moved <= after.white_sigma() {
                return Some(far.report(&after));
            }
        }
        let solution = whole.best(&config.misfits)?;
        Some(whole.report(&solution))
    }
}

/// Allan variance of a model.
fn model(powers: &Powers, tau_s: f64) -> f64 {
    let parts = Coefficient::ALL.iter().zip(powers);
    parts.map(|(c, power)| power * c.variance(tau_s)).sum()
}

/// A curve from one of its points on.
struct Job<'a> {
    config: &'a FitConfig,
    covariances: &'a Covariances,
    taus: &'a [f64],
    variances: &'a [f64],
    from: usize,
    period_s: f64,
    /// Penalty of quantization: the logarithm of the number of samples (Schwarz 1978).
    price: f64,
}

/// One choice of terms, fitted.
struct Solution {
    terms: Vec<usize>,
    powers: Powers,
    /// Covariance of the terms' powers.
    covariance: DMatrix<f64>,
    misfit: f64,
    /// Sum of the squared, weighted residuals.
    residual: f64,
    /// Criterion to minimize: twice the negative log likelihood plus the penalty of the terms.
    criterion: f64,
}

impl Solution {
    /// Standard deviation of N².
    fn white_sigma(&self) -> f64 {
        let k = self.terms.iter().position(|term| *term == 1);
        k.map_or(0.0, |k| self.covariance[(k, k)].sqrt())
    }
}

impl Job<'_> {
    /// The best choice of terms, with one of these misfit fractions.
    fn best(&self, misfits: &[f64]) -> Option<Solution> {
        let mut best: Option<Solution> = None;
        // Every choice of terms, white noise is not always seen either: under a large random walk
        // the curve shows none of it.
        for subset in 1..16_usize {
            let terms: Vec<usize> = (0..4).filter(|term| subset >> term & 1 == 1).collect();
            for &misfit in misfits {
                let Some(solution) = self.solve(&terms, misfit) else {
                    continue;
                };
                if best
                    .as_ref()
                    .is_none_or(|b| solution.criterion < b.criterion)
                {
                    best = Some(solution);
                }
            }
        }
        best
    }

    /// Whether the residuals of a fit are significantly too large.
    fn is_misfit(&self, solution: &Solution) -> bool {
        let freedom = (self.taus.len() - self.from - solution.terms.len()) as f64;
        solution.residual > chi2::quantile(1.0 - self.config.max_misfit_probability, freedom)
    }

    /// Covariance of the points under a model, with a misfit fraction.
    fn scatter(&self, powers: &Powers, misfit: f64) -> DMatrix<f64> {
        let n = self.taus.len() - self.from;
        let whole = self.covariances.of(powers);
        let mut part = whole.view((self.from, self.from), (n, n)).clone_owned();
        for i in 0..n {
            let variance = model(powers, self.taus[self.from + i]);
            // Fractions of the deviation; the error of the variance is twice as large. The small
            // rest keeps the matrix positive where sums over lags were integrals.
            part[(i, i)] += (2.0 * misfit * variance).powi(2) + 1e-6 * part[(i, i)];
        }
        part
    }

    /// Fits these terms; `None` if one of them becomes negative.
    fn solve(&self, terms: &[usize], misfit: f64) -> Option<Solution> {
        let (taus, n) = (&self.taus[self.from..], self.taus.len() - self.from);
        let measured = DVector::from_row_slice(&self.variances[self.from..]);
        let design = self.design(terms);
        let mut powers = self.first_guess(terms);
        for _ in 0..60 {
            let (found, ..) = self.step(&design, &measured, &powers, misfit)?;
            let mut next = [0.0; 4];
            let mut change: f64 = 0.0;
            for (k, &term) in terms.iter().enumerate() {
                // A step to zero or below is shortened; a term that keeps decreasing is rejected in
                // the end.
                next[term] = found[k].max(0.1 * powers[term]);
                change = change.max((next[term] / powers[term] - 1.0).abs());
            }
            powers = next;
            if change < 1e-7 {
                break;
            }
        }
        let (found, covariance, residual, log_determinant) =
            self.step(&design, &measured, &powers, misfit)?;
        let negligible = |(k, term): (usize, &usize)| {
            // A contribution below a thousandth of the curve everywhere counts as zero.
            let share = |i: usize| found[k] * design[(i, k)] / model(&powers, taus[i]);
            found[k] < 0.5 * powers[*term] || (0..n).all(|i| share(i) < 1e-3)
        };
        if terms.iter().enumerate().any(negligible) {
            return None;
        }
        Some(Solution {
            terms: terms.to_vec(),
            powers,
            covariance,
            misfit,
            residual,
            criterion: residual
                + log_determinant
                + if terms.contains(&0) { self.price } else { 0.0 },
        })
    }

    /// Initial guess: each term as large as the curve allows it alone, so that none starts from
    /// zero.
    fn first_guess(&self, terms: &[usize]) -> Powers {
        let mut powers = [0.0; 4];
        for &term in terms {
            let of = |i: usize| self.variances[i] / Coefficient::ALL[term].variance(self.taus[i]);
            let all = (self.from..self.taus.len()).map(of);
            powers[term] = all.fold(f64::INFINITY, f64::min);
        }
        powers
    }

    /// One iteration of generalized least squares, weighted by `powers`: powers, their covariance,
    /// the weighted residual and the log determinant of the weights.
    fn step(
        &self,
        design: &DMatrix<f64>,
        measured: &DVector<f64>,
        powers: &Powers,
        misfit: f64,
    ) -> Option<(DVector<f64>, DMatrix<f64>, f64, f64)> {
        // In units of the model's value at each point, so that nothing is tiny.
        let n = measured.len();
        let scale: Vec<f64> = (0..n)
            .map(|i| model(powers, self.taus[self.from + i]))
            .collect();
        let mut scatter = self.scatter(powers, misfit);
        for i in 0..n {
            for j in 0..n {
                scatter[(i, j)] /= scale[i] * scale[j];
            }
        }
        let root = scatter.cholesky()?.unpack();
        let mut whitened = DMatrix::from_fn(n, design.ncols() + 1, |i, k| {
            let value = if k < design.ncols() {
                design[(i, k)]
            } else {
                measured[i]
            };
            value / scale[i]
        });
        if !root.solve_lower_triangular_mut(&mut whitened) {
            return None;
        }
        // Columns in their own units too: Q² and K² are many powers of ten apart.
        let terms = design.ncols();
        let units: Vec<f64> = (0..terms).map(|k| whitened.column(k).norm()).collect();
        let columns = DMatrix::from_fn(n, terms, |i, k| whitened[(i, k)] / units[k]);
        let target = whitened.column(terms).clone_owned();
        let normal = (columns.transpose() * &columns).cholesky()?;
        let solved = normal.solve(&(columns.transpose() * &target));
        let residual = (&target - &columns * &solved).norm_squared();
        let inverse = normal.inverse();
        let found = DVector::from_fn(terms, |k, _| solved[k] / units[k]);
        let covariance =
            DMatrix::from_fn(terms, terms, |a, b| inverse[(a, b)] / (units[a] * units[b]));
        let log_scale: f64 = scale.iter().map(|s| s.ln()).sum();
        let log_root: f64 = (0..n).map(|i| root[(i, i)].ln()).sum();
        Some((found, covariance, residual, 2.0 * (log_root + log_scale)))
    }

    fn report(&self, solution: &Solution) -> Fit {
        let values = [0, 1, 2, 3].map(|term| self.value(term, solution));
        let whole = self.covariances.of(&solution.powers);
        let points = self.taus.iter().zip(self.variances).enumerate();
        let points = points.map(|(i, (&tau_s, &variance))| {
            let expected = model(&solution.powers, tau_s);
            let freedom = 2.0 * expected * expected / whole[(i, i)];
            let at = |p: f64| (variance * freedom / chi2::quantile(p, freedom)).sqrt();
            Scatter {
                tau_s,
                freedom,
                deviation: variance.sqrt(),
                interval: [at(0.975), at(0.025)],
            }
        });
        Fit {
            values,
            powers: solution.powers,
            from_s: self.taus[self.from],
            misfit: solution.misfit,
            points: points.collect(),
        }
    }

    fn value(&self, term: usize, solution: &Solution) -> Value {
        let power = solution.powers[term];
        let Some((_, sigma)) = self.with_all(term, &solution.powers, solution.misfit) else {
            return Value::Below(f64::INFINITY);
        };
        let least = self.config.min_significance_sigma * sigma + self.sampled(term, solution);
        if power > 0.0 && power >= least && self.follows(term, solution) {
            let freedom = 2.0 * (power / sigma).powi(2);
            let at = |p: f64| (power * freedom / chi2::quantile(p, freedom)).sqrt();
            let (value, sigma) = (power.sqrt(), sigma / (2.0 * power.sqrt()));
            return Value::Known {
                value,
                sigma,
                interval: [
                    at(0.975).min(value - 2.0 * sigma),
                    at(0.025).max(value + 2.0 * sigma),
                ],
            };
        }
        Value::Below(self.limit(term, solution).sqrt())
    }

    /// Whether the curve has the slope of a term where the term matters, that is where its part of
    /// the model is at least half of its largest. A curve that follows the model does, and one that
    /// does not may lend its size to any term.
    fn follows(&self, term: usize, solution: &Solution) -> bool {
        if solution.misfit == 0.0 {
            return true;
        }
        let points = self.taus.iter().zip(self.variances).skip(self.from);
        let points: Vec<(f64, f64)> = points
            .map(|(&tau_s, &variance)| {
                let model = model(&solution.powers, tau_s);
                let part = solution.powers[term] * Coefficient::ALL[term].variance(tau_s);
                (part / model, (variance / model).sqrt() - 1.0)
            })
            .collect();
        let largest = points.iter().map(|(share, _)| *share).fold(0.0, f64::max);
        let there = points.iter().filter(|(share, _)| *share >= 0.5 * largest);
        let (sum, count) = there.fold((0.0, 0.0), |(sum, count), (_, off)| {
            (sum + off * off, count + 1.0)
        });
        sum <= count * self.config.max_known_misfit.powi(2)
    }

    /// Power of a term that the samples of another one show. A random walk that is sampled, not
    /// averaged over the period T, has the variance K² τ / 3 + K² T² / 6τ: that is no white noise,
    /// and which of the two a sensor does is not known.
    fn sampled(&self, term: usize, solution: &Solution) -> f64 {
        match term {
            1 => solution.powers[3] * self.period_s.powi(2) / 6.0,
            _ => 0.0,
        }
    }

    /// Estimate and standard deviation of a term in the model with bias instability and random
    /// walk, with the scatter of these powers.
    fn with_all(&self, term: usize, powers: &Powers, misfit: f64) -> Option<(f64, f64)> {
        let mut terms = vec![1, 2, 3];
        if term == 0 || powers[0] > 0.0 {
            terms.insert(0, 0);
        }
        let measured = DVector::from_row_slice(&self.variances[self.from..]);
        let (found, covariance, ..) = self.step(&self.design(&terms), &measured, powers, misfit)?;
        let k = terms.iter().position(|t| *t == term)?;
        Some((found[k].max(0.0), covariance[(k, k)].sqrt()))
    }

    /// Upper limit of a term: the smallest power whose estimate would almost always be larger than
    /// the one found. The scatter of an estimate depends on the power itself, so powers are tried
    /// in ascending order; the others are refitted each time.
    fn limit(&self, term: usize, solution: &Solution) -> f64 {
        let misfit = solution.misfit;
        let mut powers = solution.powers;
        powers[term] = 0.0;
        let Some((_, mut power)) = self.with_all(term, &powers, misfit) else {
            return f64::INFINITY;
        };
        // Steps of a fifth of the power are a tenth of the coefficient; a hundred of them are 1e8.
        for _ in 0..100 {
            powers[term] = power;
            self.refit_others(term, &mut powers, solution);
            let Some((found, sigma)) = self.with_all(term, &powers, misfit) else {
                break;
            };
            let freedom = 2.0 * (power / sigma).powi(2);
            let low = if freedom > 4.0 {
                power * chi2::quantile(self.config.limit_probability, freedom) / freedom
            } else {
                power - self.config.limit_sigma * sigma
            };
            if low >= found {
                return power;
            }
            power *= 1.2;
        }
        f64::INFINITY
    }

    /// Fits the other terms beside a fixed one; negative ones are set to zero.
    fn refit_others(&self, term: usize, powers: &mut Powers, solution: &Solution) {
        let held = powers[term];
        let rest = self.taus[self.from..]
            .iter()
            .zip(&self.variances[self.from..]);
        let rest = rest.map(|(tau, v)| v - held * Coefficient::ALL[term].variance(*tau));
        let rest = DVector::from_iterator(self.taus.len() - self.from, rest);
        let is_other = |t: &usize| *t != term && solution.powers[*t] > 0.0;
        let mut others: Vec<usize> = (0..4).filter(is_other).collect();
        for _ in 0..4 {
            if others.is_empty() {
                return;
            }
            let step = self.step(&self.design(&others), &rest, powers, solution.misfit);
            let Some((found, ..)) = step else {
                return;
            };
            for (k, &other) in others.iter().enumerate() {
                powers[other] = found[k].max(0.0);
            }
            others.retain(|&other| powers[other] > 0.0);
        }
    }

    /// Allan variances at the averaging times for these terms at 1.
    fn design(&self, terms: &[usize]) -> DMatrix<f64> {
        let taus = &self.taus[self.from..];
        DMatrix::from_fn(taus.len(), terms.len(), |i, k| {
            Coefficient::ALL[terms[k]].variance(taus[i])
        })
    }
}
