//! Covariance of the points of a curve of overlapping Allan variances.
//!
//! A point is the mean of squares of second differences of phase. For Gaussian noise the covariance
//! of two such means is twice the sum of the squared covariances of their differences over all
//! pairs (the fourth moments of normal numbers), and the covariance of two differences follows from
//! the generalised autocovariance of the phase (Greenhall and Riley, *Uncertainty of stability
//! variances based on finite differences*, PTTI 2003):
//!
//! ```text
//! s(t) = Q² [t = 0]  −  N² |t| / 2  +  B² t² ln|t| / (2π)  +  K² |t|³ / 12
//! ```
//!
//! whose scale is fixed by σ²(τ) = (6 s(0) − 8 s(τ) + 2 s(2τ)) / 2τ². The covariance is thus a
//! quadratic form in (Q², N², B², K²), whose ten matrices depend on averaging factors and run
//! lengths alone: they are made once for a curve and serve all models tried on it, and every axis
//! with the same runs.

use nalgebra::DMatrix;

use super::variance::{Curve, MIN_LENGTHS};

/// Powers of a model: Q², N², B², K².
pub(crate) type Powers = [f64; 4];

/// The pairs of powers whose product a matrix belongs to.
const PAIRS: [(usize, usize); 10] = [
    (0, 0),
    (0, 1),
    (0, 2),
    (0, 3),
    (1, 1),
    (1, 2),
    (1, 3),
    (2, 2),
    (2, 3),
    (3, 3),
];
/// Weights of a second difference.
const WEIGHTS: [f64; 3] = [1.0, -2.0, 1.0];
/// Maximum factor for which sums over lags are exact; beyond it they are integrals.
const EXACT: usize = 24;
/// Distance of the centers of two differences, in sums of their factors, beyond which the
/// covariance of flicker is expanded.
const FAR: f64 = 4.0;
/// Nodes and weights of Gauss–Legendre quadrature with five points on -1 to 1, exact up to degree
/// 9: without flicker, the integrand is of degree 7 between the lags at which two ends of the
/// differences meet.
const GAUSS: [(f64, f64); 5] = [
    (-0.906_179_845_938_664, 0.236_926_885_056_189_1),
    (-0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (0.0, 0.568_888_888_888_888_9),
    (0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (0.906_179_845_938_664, 0.236_926_885_056_189_1),
];

/// The quadratic form for the shape of a curve.
#[derive(Clone, Debug)]
pub(crate) struct Covariances {
    forms: [DMatrix<f64>; 10],
}

impl Covariances {
    /// Of all curves with the factors and runs of this one.
    pub(crate) fn new(curve: &Curve) -> Self {
        let n = curve.points.len();
        let mut forms = [(); 10].map(|()| DMatrix::zeros(n, n));
        for i in 0..n {
            for j in i..n {
                let values = pair(curve, i, j);
                for (form, value) in forms.iter_mut().zip(values) {
                    form[(i, j)] = value;
                    form[(j, i)] = value;
                }
            }
        }
        Self { forms }
    }

    /// The covariance of the points under a model.
    pub(crate) fn of(&self, powers: &Powers) -> DMatrix<f64> {
        let n = self.forms[0].nrows();
        let mut sum = DMatrix::zeros(n, n);
        for ((p, q), form) in PAIRS.iter().zip(&self.forms) {
            let product = powers[*p] * powers[*q];
            if product != 0.0 {
                sum += form * product;
            }
        }
        sum
    }
}

/// The ten terms of the covariance of points `i` and `j`.
fn pair(curve: &Curve, i: usize, j: usize) -> [f64; 10] {
    let (first, second) = (&curve.points[i], &curve.points[j]);
    let (m1, m2) = (first.factor, second.factor);
    let runs: Vec<[f64; 2]> = curve
        .runs
        .iter()
        .filter(|&&n| n >= MIN_LENGTHS * m1.max(m2))
        .map(|&n| [m1, m2].map(|m| (n + 1 - 2 * m) as f64))
        .collect();
    // Pairs of differences that are `lag` apart, in all runs.
    let pairs_at = |lag: f64| -> f64 {
        let of = |[a, b]: &[f64; 2]| (a.min(b - lag) - (-lag).max(0.0)).max(0.0);
        runs.iter().map(of).sum()
    };
    let most = |k: usize| runs.iter().map(|r| r[k]).fold(1.0, f64::max) - 1.0;
    let (low, high) = (-most(0), most(1));
    let (m1, m2) = (m1 as f64, m2 as f64);

    let mut sums = [0.0; 10];
    let mut add = |weight: f64, r: &[f64; 4]| {
        for ((p, q), sum) in PAIRS.iter().zip(&mut sums) {
            let double = if p == q { 1.0 } else { 2.0 };
            *sum += weight * double * r[*p] * r[*q];
        }
    };
    if m1.max(m2) <= EXACT as f64 {
        // Flicker alone has covariance beyond the differences themselves, and it decays fast.
        let reach = 8.0 * (m1 + m2);
        let mut lag = low.max(-2.0 * m2 - reach);
        while lag <= high.min(2.0 * m1 + reach) {
            add(pairs_at(lag), &of_differences(lag, m1, m2));
            lag += 1.0;
        }
    } else {
        let meets = meets(m1, m2);
        let mut corners: Vec<f64> = meets.to_vec();
        let reach = [0.5, 2.0, 8.0].map(|k| k * (m1 + m2));
        corners.extend(reach.map(|r| -2.0 * m2 - r));
        corners.extend(reach.map(|r| 2.0 * m1 + r));
        corners.extend([0.0, low, high, high + low]);
        corners.retain(|corner| (low..=high).contains(corner));
        corners.sort_by(f64::total_cmp);
        corners.dedup();
        for ends in corners.windows(2) {
            let (middle, half) = (0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0]));
            for (node, weight) in GAUSS {
                let lag = middle + half * node;
                add(
                    half * weight * pairs_at(lag),
                    &smooth_of_differences(lag, m1, m2),
                );
            }
        }
        // Quantization contributes at single lags only.
        let mut single = meets.to_vec();
        single.sort_by(f64::total_cmp);
        single.dedup();
        for lag in single {
            let with = of_differences(lag, m1, m2);
            let without = [0.0, with[1], with[2], with[3]];
            add(pairs_at(lag), &with);
            add(-pairs_at(lag), &without);
        }
    }
    let (tau1, tau2) = (first.tau_s, second.tau_s);
    let terms = first.terms as f64 * second.terms as f64;
    let scale = 2.0 / (terms * 4.0 * tau1 * tau1 * tau2 * tau2);
    // From samples to seconds: each power has its own dimension.
    let seconds = [0, 1, 2, 3].map(|k| curve.period_s.powi(k));
    let mut scaled = [0.0; 10];
    for (k, (p, q)) in PAIRS.iter().enumerate() {
        scaled[k] = sums[k] * scale * seconds[*p] * seconds[*q];
    }
    scaled
}

/// The lags at which ends of the two differences meet.
fn meets(m1: f64, m2: f64) -> [f64; 9] {
    let mut lags = [0.0; 9];
    for (k, lag) in lags.iter_mut().enumerate() {
        *lag = (k / 3) as f64 * m1 - (k % 3) as f64 * m2;
    }
    lags
}

/// Covariance of two second differences whose beginnings are `lag` samples apart, for each power
/// at 1.
fn of_differences(lag: f64, m1: f64, m2: f64) -> [f64; 4] {
    let mut r = smooth_of_differences(lag, m1, m2);
    for (k, meet) in meets(m1, m2).into_iter().enumerate() {
        if meet == lag {
            r[0] += WEIGHTS[k / 3] * WEIGHTS[k % 3];
        }
    }
    r
}

/// The same without quantisation.
///
/// Where the differences do not overlap, the sum over the meets is zero for white noise and random
/// walk, and small for flicker: there it cancels from terms as large as (lag / factor)³. Over a day
/// and a half at 200 Hz these have lost every digit (a sum of 10¹⁸ terms for a result of 0), so
/// the zeros are written and the tail of flicker is expanded.
fn smooth_of_differences(lag: f64, m1: f64, m2: f64) -> [f64; 4] {
    // Lags in units of the longer factor keep the cubes small; t² ln|t| may be scaled so, because
    // two second differences remove what is quadratic.
    let unit = m1.max(m2);
    let center = (lag - (m1 - m2)) / unit;
    if center.abs() > FAR * (m1 + m2) / unit {
        return [
            0.0,
            0.0,
            flicker_tail(center, m1 / unit, m2 / unit) * unit.powi(2),
            0.0,
        ];
    }
    let overlaps = lag > -2.0 * m2 && lag < 2.0 * m1;
    let mut r = [0.0; 4];
    for (k, meet) in meets(m1, m2).into_iter().enumerate() {
        let weight = WEIGHTS[k / 3] * WEIGHTS[k % 3];
        let t = ((lag - meet) / unit).abs();
        if t > 0.0 {
            r[2] += weight * t * t * t.ln() / std::f64::consts::TAU;
            if overlaps {
                r[1] -= weight * t / 2.0;
                r[3] += weight * t * t * t / 12.0;
            }
        }
    }
    [0.0, r[1] * unit, r[2] * unit.powi(2), r[3] * unit.powi(3)]
}

/// Covariance of the differences of flicker `t` between their centers, far from each other: the
/// second differences of t² ln|t| / 2π as a series of its derivatives (δ² = m² D² + m⁴ D⁴ / 12 +
/// m⁶ D⁶ / 360), whose rest is 5e-5 of the first term at the nearest center.
fn flicker_tail(t: f64, m1: f64, m2: f64) -> f64 {
    let (a, b, t2) = (m1 * m1, m2 * m2, t * t);
    let fourth = -2.0 / t2;
    let sixth = -12.0 / t2.powi(2);
    let eighth = -240.0 / t2.powi(3);
    let sum = fourth + (a + b) / 12.0 * sixth + ((a * a + b * b) / 360.0 + a * b / 144.0) * eighth;
    a * b * sum / std::f64::consts::TAU
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tail of flicker joins the sum, and beyond the overlap the others are zero, however far.
    #[test]
    fn covariance_of_distant_differences_does_not_cancel() {
        for (m1, m2) in [(30.0, 30.0), (7.0, 90.0), (1000.0, 40.0)] {
            for side in [-1.0, 1.0] {
                let center = side * FAR * (m1 + m2);
                let at = |center: f64| smooth_of_differences(center + m1 - m2, m1, m2);
                let (near, far) = (at(center * 0.999_999), at(center * 1.000_001));
                assert!((near[2] / far[2] - 1.0).abs() < 1e-4, "{near:?} {far:?}");
                assert_eq!((far[1], far[3]), (0.0, 0.0));
                let farthest = at(side * 2e7);
                let expected = -(m1 * m2 / 2e7).powi(2) / std::f64::consts::PI;
                assert!((farthest[2] / expected - 1.0).abs() < 1e-3, "{farthest:?}");
            }
        }
    }
}
