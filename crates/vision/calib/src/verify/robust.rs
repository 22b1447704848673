//! Robust statistics.

use nalgebra::{Matrix3, SMatrix, SVector};

/// The median; 0 if empty.
pub(super) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Standard deviations about the axes.
pub(super) fn sigmas_of(covariance: &Matrix3<f64>) -> [f64; 3] {
    [0, 1, 2].map(|k| covariance[(k, k)].sqrt())
}

/// Weight of an observation with a residual of `off` standard deviations (Tukey's biweight; 4.685
/// keeps 95 % of the efficiency for normal errors).
pub(super) fn tukey(off: f64) -> f64 {
    let ratio = off / 4.685;
    if ratio.abs() >= 1.0 {
        return 0.0;
    }
    (1.0 - ratio * ratio).powi(2)
}

/// Weighted least squares with cluster-robust errors (clusters are bursts).
///
/// Accumulates `JᵀWJ` and `JᵀWr` in total and per cluster. The covariance is the inverse of the
/// former times the scale, inflated by the ratio of the spread between clusters to that of
/// independent errors (the sandwich estimate with clusters, Liang and Zeger 1986, reduced to one
/// factor, which works with few clusters).
#[derive(Clone, Debug)]
pub(super) struct Grouped<const N: usize> {
    pub(super) information: SMatrix<f64, N, N>,
    pub(super) gradient: SVector<f64, N>,
    groups: Vec<SVector<f64, N>>,
}

impl<const N: usize> Grouped<N> {
    /// With prior standard deviations of the parameters about `expected - now`; infinite for no
    /// prior.
    pub(super) fn new(groups: usize, sigmas: &SVector<f64, N>, towards: &SVector<f64, N>) -> Self {
        let mut new = Self {
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
            groups: vec![SVector::zeros(); groups],
        };
        for k in 0..N {
            let weight = 1.0 / (sigmas[k] * sigmas[k]);
            new.information[(k, k)] = weight;
            new.gradient[k] = weight * towards[k];
        }
        new
    }

    /// Adds residuals, the Jacobian of their prediction, and their weight.
    pub(super) fn add<const M: usize>(
        &mut self,
        group: usize,
        residual: &SVector<f64, M>,
        by: &SMatrix<f64, M, N>,
        weight: &SMatrix<f64, M, M>,
    ) {
        let weighted = by.transpose() * weight;
        self.information += weighted * by;
        let gradient = weighted * residual;
        self.gradient += gradient;
        self.groups[group] += gradient;
    }

    /// The step to the minimum.
    pub(super) fn step(&self) -> Option<SVector<f64, N>> {
        Some(self.information.cholesky()?.solve(&self.gradient))
    }

    /// Covariance for observations of unit variance, and its inflation by clusters. `which` are the
    /// parameters of interest.
    pub(super) fn covariance(&self, which: &[usize]) -> Option<(SMatrix<f64, N, N>, f64)> {
        let inverse = self.information.cholesky()?.inverse();
        let used = self.groups.iter().filter(|g| g.norm_squared() > 0.0);
        let count = used.clone().count();
        if count < 3 {
            return Some((inverse, 4.0));
        }
        let meat = used.fold(SMatrix::<f64, N, N>::zeros(), |sum, g| {
            sum + g * g.transpose()
        });
        let share = count as f64 / (count - 1) as f64;
        let sandwich = inverse * meat * inverse * share;
        let ratio = which.iter().map(|k| sandwich[(*k, *k)] / inverse[(*k, *k)]);
        let ratio = ratio.sum::<f64>() / which.len() as f64;
        Some((inverse, ratio.max(1.0)))
    }
}
