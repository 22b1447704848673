//! Which of several told numbers is wrong, if any is.
//!
//! What was measured depends on what may be off (a camera that turned, an IMU that sits otherwise in its camera, a clock) in a
//! linear way: `y = H x + noise`, with `x` about 0 within tolerances. For each thing that may be off the best estimate
//! of how far it is off is made, all others being within tolerance (generalised least squares). It is *off* where the
//! estimate is longer than tolerance (2 sigma) and measurement ([`SURE`] sigma) explain together; the thing whose
//! being off explains most of `y` is named, and the rest is judged anew with that one set free. Where two things
//! explain `y` nearly as well, as with two cameras that are turned against each other, both are named.

use nalgebra::{DMatrix, DVector};

/// Sigmas of measurement beyond tolerance that are no chance: with three axes 1 in 250 for one thing that is at the
/// edge of its tolerance, and next to never for one that is well within.
pub const SURE: f64 = 3.3;
/// Sigmas of tolerance that are no surprise.
pub(super) const TOLERATED: f64 = 2.0;
/// Sigmas by which what is found falls short of what is true once in 40 times.
pub(super) const SHORT: f64 = 2.0;
/// Another thing explains nearly as much if its chi-squared is this close.
const CLOSE: f64 = 6.0;

/// A thing that may be off.
#[derive(Clone, Debug)]
pub(super) struct Thing {
    /// Its columns of `H`.
    pub(super) first: usize,
    pub(super) size: usize,
    /// Tolerance, one standard deviation of each column.
    pub(super) sigma: f64,
}

/// Everything that was measured.
#[derive(Clone, Debug, Default)]
pub(super) struct Measured {
    rows: Vec<(DMatrix<f64>, DVector<f64>, DMatrix<f64>)>,
}

/// How far one thing is off.
#[derive(Clone, Debug)]
pub(super) struct Estimate {
    pub(super) off: Vec<f64>,
    /// Standard deviations along `off`: of the measurement, and of what is tolerated.
    pub(super) sigma: f64,
    pub(super) tolerated: f64,
    /// The largest of the measurement, along any direction.
    pub(super) largest: f64,
    /// The largest of what is tolerated, along any direction.
    pub(super) loosest: f64,
    /// Beyond what it is off, along the direction in which least is seen.
    pub(super) bound: f64,
    /// What would be noticed nearly always, along that direction: so large that it is beyond the bound even where tolerance and
    /// measurement fall short by [`SHORT`] sigma.
    pub(super) noticed: f64,
    /// How much of chi-squared it explains.
    gain: f64,
}

/// What became of one thing.
#[derive(Clone, Debug)]
pub(super) enum Judged {
    /// Nothing was measured that depends on it.
    Unseen,
    /// Within what tolerance and measurement explain, or explained by another thing that is off.
    Within(Estimate),
    /// Off, or one of these is.
    Off(Estimate, Vec<usize>),
}

impl Estimate {
    pub(super) fn length(&self) -> f64 {
        self.off.iter().map(|v| v * v).sum::<f64>().sqrt()
    }

    /// By how much more than tolerance and measurement explain.
    pub(super) fn beyond(&self) -> f64 {
        self.length() - TOLERATED * self.tolerated - SURE * self.sigma
    }
}

impl Measured {
    /// Adds rows of `H`, of `y`, and their covariance; independent of all others.
    pub(super) fn add(&mut self, by: DMatrix<f64>, value: DVector<f64>, covariance: DMatrix<f64>) {
        self.rows.push((by, value, covariance));
    }

    fn stacked(&self) -> Option<(DMatrix<f64>, DVector<f64>, DMatrix<f64>)> {
        let columns = self.rows.first()?.0.ncols();
        let count = self.rows.iter().map(|r| r.1.len()).sum();
        let mut by = DMatrix::zeros(count, columns);
        let mut value = DVector::zeros(count);
        let mut covariance = DMatrix::zeros(count, count);
        let mut at = 0;
        for (h, y, r) in &self.rows {
            let n = y.len();
            by.view_mut((at, 0), (n, columns)).copy_from(h);
            value.rows_mut(at, n).copy_from(y);
            covariance.view_mut((at, at), (n, n)).copy_from(r);
            at += n;
        }
        Some((by, value, covariance))
    }

    /// Judges all things.
    pub(super) fn judge(&self, things: &[Thing]) -> Vec<Judged> {
        let mut judged: Vec<Judged> = things.iter().map(|_| Judged::Unseen).collect();
        let Some((by, value, noise)) = self.stacked() else {
            return judged;
        };
        let mut free = vec![false; things.len()];
        loop {
            let estimates: Vec<Option<Estimate>> = (0..things.len())
                .map(|k| estimate(&by, &value, &noise, things, &free, k))
                .collect();
            for (k, found) in estimates.iter().enumerate() {
                if !free[k]
                    && let Some(found) = found
                {
                    judged[k] = Judged::Within(found.clone());
                }
            }
            let off = |k: &usize| {
                let found = estimates[*k].as_ref();
                !free[*k] && found.is_some_and(|e| e.beyond() > 0.0)
            };
            let gain = |k: usize| estimates[k].as_ref().map_or(0.0, |e| e.gain);
            let worst = (0..things.len())
                .filter(off)
                .max_by(|a, b| gain(*a).total_cmp(&gain(*b)));
            let Some(worst) = worst else {
                return judged;
            };
            let close: Vec<usize> = (0..things.len())
                .filter(|k| off(k) && *k != worst && gain(*k) > gain(worst) - CLOSE)
                .collect();
            if let Some(found) = &estimates[worst] {
                judged[worst] = Judged::Off(found.clone(), close);
            }
            free[worst] = true;
        }
    }
}

fn estimate(
    by: &DMatrix<f64>,
    value: &DVector<f64>,
    noise: &DMatrix<f64>,
    things: &[Thing],
    free: &[bool],
    of: usize,
) -> Option<Estimate> {
    // What is free may be anywhere: far beyond any tolerance, but small enough to compute with.
    let mut tolerance = DMatrix::zeros(value.len(), value.len());
    for (thing, free) in things.iter().zip(free) {
        let columns = by.columns(thing.first, thing.size);
        let sigma = if *free {
            1e3 * thing.sigma
        } else {
            thing.sigma
        };
        tolerance += columns * columns.transpose() * (sigma * sigma);
    }
    let thing = &things[of];
    let own = by.columns(thing.first, thing.size);
    let total = noise + &tolerance;
    let weight = total.cholesky()?.inverse();
    let information = own.transpose() * &weight * own;
    // Chi-squared of a length of 1 that nothing measured depends on.
    if information.amax() * thing.sigma * thing.sigma < 1e-6 {
        return None;
    }
    let from_value = information.clone().cholesky()?.inverse() * own.transpose() * &weight;
    let off = &from_value * value;
    let gain = (off.transpose() * &information * &off)[0];
    let measured = &from_value * noise * from_value.transpose();
    let tolerated = &from_value * tolerance * from_value.transpose();
    let length = off.norm();
    let along = |matrix: &DMatrix<f64>| match length > 0.0 {
        true => ((off.transpose() * matrix * &off)[0].max(0.0)).sqrt() / length,
        false => 0.0,
    };
    let largest = |matrix: &DMatrix<f64>| {
        let values = matrix.clone().symmetric_eigenvalues();
        values.iter().copied().fold(0.0, f64::max).sqrt()
    };
    let (worst, loosest) = (largest(&measured), largest(&tolerated));
    let bound = TOLERATED * loosest + SURE * worst;
    Some(Estimate {
        sigma: along(&measured),
        tolerated: along(&tolerated),
        largest: worst,
        loosest,
        bound,
        noticed: bound + SHORT * worst.hypot(loosest),
        off: off.iter().copied().collect(),
        gain,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Differences of things, each measured with an error of 0.1.
    fn differences(count: usize, values: &[(usize, usize, f64)]) -> (Measured, Vec<Thing>) {
        let mut measured = Measured::default();
        for (a, b, value) in values {
            let mut by = DMatrix::zeros(1, count);
            by[(0, *a)] = 1.0;
            by[(0, *b)] = -1.0;
            let covariance = DMatrix::from_element(1, 1, 0.01);
            measured.add(by, DVector::from_element(1, *value), covariance);
        }
        let thing = |first| Thing {
            first,
            size: 1,
            sigma: 0.1,
        };
        (measured, (0..count).map(thing).collect())
    }

    #[test]
    fn of_three_the_one_that_disagrees_with_the_two_others_is_named() {
        let (measured, things) = differences(3, &[(0, 1, -2.0), (0, 2, 0.05), (1, 2, 2.1)]);
        let judged = measured.judge(&things);
        let Judged::Off(found, close) = &judged[1] else {
            panic!("{judged:?}");
        };
        assert!((found.off[0] - 2.0).abs() < 0.2, "{found:?}");
        assert!(close.is_empty(), "{close:?}");
        assert!(matches!(judged[0], Judged::Within(_)), "{judged:?}");
        assert!(matches!(judged[2], Judged::Within(_)), "{judged:?}");
    }

    #[test]
    fn of_two_that_disagree_both_are_named() {
        let (measured, things) = differences(2, &[(0, 1, 2.0)]);
        let judged = measured.judge(&things);
        let named: Vec<bool> = judged
            .iter()
            .map(|j| matches!(j, Judged::Off(..)))
            .collect();
        assert_eq!(named.iter().filter(|n| **n).count(), 1, "{judged:?}");
        let close = judged.iter().find_map(|j| match j {
            Judged::Off(_, close) => Some(close.len()),
            _ => None,
        });
        assert_eq!(close, Some(1), "{judged:?}");
    }

    #[test]
    fn what_tolerance_explains_is_within_and_what_was_not_measured_is_unseen() {
        let (measured, things) = differences(4, &[(0, 1, 0.3), (1, 2, 0.0)]);
        let judged = measured.judge(&things);
        assert!(matches!(judged[0], Judged::Within(_)), "{judged:?}");
        assert!(matches!(judged[3], Judged::Unseen), "{judged:?}");
        assert!(matches!(
            Measured::default().judge(&things)[0],
            Judged::Unseen
        ));
    }
}
