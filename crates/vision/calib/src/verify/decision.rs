//! Decision which of several nominal parameters is wrong, if any.
//!
//! The measurements are linear in the deviations of the parameters (rotation of a camera, rotation
//! of an IMU in its camera, clock): `y = H x + noise`, with `x` about 0 within tolerances. For each
//! block of parameters the deviation is estimated by generalized least squares, all others within
//! tolerance. The block is *inconsistent* if the estimate is longer than tolerance (2 sigma) and
//! measurement ([`DecisionConfig::detection_sigma`]) explain together. The block that explains most
//! of `y` is reported, and the rest is tested again with that block free. If two blocks explain `y`
//! nearly equally well, as with two cameras rotated against each other, both are reported.

use nalgebra::{DMatrix, DVector};

use super::config::DecisionConfig;

/// A block of parameters that may deviate.
#[derive(Clone, Debug)]
pub(super) struct ParameterBlock {
    /// Its columns of `H`.
    pub(super) first: usize,
    pub(super) size: usize,
    /// Tolerance, one standard deviation of each column.
    pub(super) sigma: f64,
}

/// All measurements.
#[derive(Clone, Debug, Default)]
pub(super) struct Measurements {
    rows: Vec<(DMatrix<f64>, DVector<f64>, DMatrix<f64>)>,
}

/// Estimated deviation of one block.
#[derive(Clone, Debug)]
pub(super) struct Estimate {
    pub(super) error: Vec<f64>,
    /// Standard deviations along `error`: of the measurement, and of the tolerance.
    pub(super) sigma: f64,
    pub(super) tolerated: f64,
    /// Largest measurement sigma, along any direction.
    pub(super) largest: f64,
    /// Largest tolerance sigma, along any direction.
    pub(super) loosest: f64,
    /// Detection limit along the least constrained direction.
    pub(super) bound: f64,
    /// Minimum detectable deviation along that direction: it exceeds the limit even if tolerance
    /// and measurement fall short by [`DecisionConfig::power_sigma`].
    pub(super) min_detectable: f64,
    /// Decrease of chi-squared explained by the block.
    gain: f64,
}

/// Decision on one block.
#[derive(Clone, Debug)]
pub(super) enum Decision {
    /// No measurement depends on it.
    Unmeasured,
    /// Explained by tolerance and measurement, or by another block that is inconsistent.
    Consistent(Estimate),
    /// Inconsistent; alternatively one of these blocks is.
    Inconsistent(Estimate, Vec<usize>),
}

impl Estimate {
    pub(super) fn length(&self) -> f64 {
        self.error.iter().map(|v| v * v).sum::<f64>().sqrt()
    }

    /// Excess over tolerance and measurement.
    pub(super) fn excess(&self, config: &DecisionConfig) -> f64 {
        self.length()
            - config.tolerance_sigma * self.tolerated
            - config.detection_sigma * self.sigma
    }
}

impl Measurements {
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

    /// Decides on all blocks.
    pub(super) fn judge(
        &self,
        blocks: &[ParameterBlock],
        config: &DecisionConfig,
    ) -> Vec<Decision> {
        let mut decisions: Vec<Decision> = blocks.iter().map(|_| Decision::Unmeasured).collect();
        let Some((by, value, noise)) = self.stacked() else {
            return decisions;
        };
        let mut free = vec![false; blocks.len()];
        loop {
            let estimates: Vec<Option<Estimate>> = (0..blocks.len())
                .map(|k| estimate((&by, &value, &noise), blocks, &free, k, config))
                .collect();
            for (k, found) in estimates.iter().enumerate() {
                if !free[k]
                    && let Some(found) = found
                {
                    decisions[k] = Decision::Consistent(found.clone());
                }
            }
            let off = |k: &usize| {
                let found = estimates[*k].as_ref();
                !free[*k] && found.is_some_and(|e| e.excess(config) > 0.0)
            };
            let gain = |k: usize| estimates[k].as_ref().map_or(0.0, |e| e.gain);
            let worst = (0..blocks.len())
                .filter(off)
                .max_by(|a, b| gain(*a).total_cmp(&gain(*b)));
            let Some(worst) = worst else {
                return decisions;
            };
            let close: Vec<usize> = (0..blocks.len())
                .filter(|k| off(k) && *k != worst && gain(*k) > gain(worst) - config.ambiguity_chi2)
                .collect();
            if let Some(found) = &estimates[worst] {
                decisions[worst] = Decision::Inconsistent(found.clone(), close);
            }
            free[worst] = true;
        }
    }
}

fn estimate(
    (by, value, noise): (&DMatrix<f64>, &DVector<f64>, &DMatrix<f64>),
    blocks: &[ParameterBlock],
    free: &[bool],
    of: usize,
    config: &DecisionConfig,
) -> Option<Estimate> {
    // A free block is nearly unconstrained: far beyond any tolerance, but numerically harmless.
    let mut tolerance = DMatrix::zeros(value.len(), value.len());
    for (block, free) in blocks.iter().zip(free) {
        let columns = by.columns(block.first, block.size);
        let sigma = if *free {
            1e3 * block.sigma
        } else {
            block.sigma
        };
        tolerance += columns * columns.transpose() * (sigma * sigma);
    }
    let block = &blocks[of];
    let own = by.columns(block.first, block.size);
    let total = noise + &tolerance;
    let weight = total.cholesky()?.inverse();
    let information = own.transpose() * &weight * own;
    // Chi-squared of a deviation of one sigma, below which no measurement depends on the block.
    if information.amax() * block.sigma * block.sigma < 1e-6 {
        return None;
    }
    let from_value = information.clone().cholesky()?.inverse() * own.transpose() * &weight;
    let error = &from_value * value;
    let gain = (error.transpose() * &information * &error)[0];
    let measured = &from_value * noise * from_value.transpose();
    let tolerated = &from_value * tolerance * from_value.transpose();
    let length = error.norm();
    let along = |matrix: &DMatrix<f64>| match length > 0.0 {
        true => ((error.transpose() * matrix * &error)[0].max(0.0)).sqrt() / length,
        false => 0.0,
    };
    let largest = |matrix: &DMatrix<f64>| {
        let values = matrix.clone().symmetric_eigenvalues();
        values.iter().copied().fold(0.0, f64::max).sqrt()
    };
    let (worst, loosest) = (largest(&measured), largest(&tolerated));
    let bound = config.tolerance_sigma * loosest + config.detection_sigma * worst;
    Some(Estimate {
        sigma: along(&measured),
        tolerated: along(&tolerated),
        largest: worst,
        loosest,
        bound,
        min_detectable: bound + config.power_sigma * worst.hypot(loosest),
        error: error.iter().copied().collect(),
        gain,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Differences of parameters, each measured with an error of 0.1.
    fn differences(
        count: usize,
        values: &[(usize, usize, f64)],
    ) -> (Measurements, Vec<ParameterBlock>) {
        let mut measured = Measurements::default();
        for (a, b, value) in values {
            let mut by = DMatrix::zeros(1, count);
            by[(0, *a)] = 1.0;
            by[(0, *b)] = -1.0;
            let covariance = DMatrix::from_element(1, 1, 0.01);
            measured.add(by, DVector::from_element(1, *value), covariance);
        }
        let block = |first| ParameterBlock {
            first,
            size: 1,
            sigma: 0.1,
        };
        (measured, (0..count).map(block).collect())
    }

    #[test]
    fn one_of_three_that_disagrees_is_identified() {
        let (measured, blocks) = differences(3, &[(0, 1, -2.0), (0, 2, 0.05), (1, 2, 2.1)]);
        let decisions = measured.judge(&blocks, &DecisionConfig::default());
        let Decision::Inconsistent(found, close) = &decisions[1] else {
            panic!("{decisions:?}");
        };
        assert!((found.error[0] - 2.0).abs() < 0.2, "{found:?}");
        assert!(close.is_empty(), "{close:?}");
        assert!(
            matches!(decisions[0], Decision::Consistent(_)),
            "{decisions:?}"
        );
        assert!(
            matches!(decisions[2], Decision::Consistent(_)),
            "{decisions:?}"
        );
    }

    #[test]
    fn both_of_two_that_disagree_are_reported() {
        let (measured, blocks) = differences(2, &[(0, 1, 2.0)]);
        let decisions = measured.judge(&blocks, &DecisionConfig::default());
        let named: Vec<bool> = decisions
            .iter()
            .map(|j| matches!(j, Decision::Inconsistent(..)))
            .collect();
        assert_eq!(named.iter().filter(|n| **n).count(), 1, "{decisions:?}");
        let close = decisions.iter().find_map(|j| match j {
            Decision::Inconsistent(_, close) => Some(close.len()),
            _ => None,
        });
        assert_eq!(close, Some(1), "{decisions:?}");
    }

    #[test]
    fn deviation_within_tolerance_is_consistent_and_unmeasured_block_is_unmeasured() {
        let (measured, blocks) = differences(4, &[(0, 1, 0.3), (1, 2, 0.0)]);
        let decisions = measured.judge(&blocks, &DecisionConfig::default());
        assert!(
            matches!(decisions[0], Decision::Consistent(_)),
            "{decisions:?}"
        );
        assert!(
            matches!(decisions[3], Decision::Unmeasured),
            "{decisions:?}"
        );
        assert!(matches!(
            Measurements::default().judge(&blocks, &DecisionConfig::default())[0],
            Decision::Unmeasured
        ));
    }
}
