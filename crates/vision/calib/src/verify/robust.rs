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

/// Combines estimates of one parameter, each a value and its variance that contain the same prior;
/// the prior is its mean and sigma. Returns the value and its standard deviation.
pub(super) fn combine(estimates: &[[f64; 2]], [expected, sigma]: [f64; 2]) -> [f64; 2] {
    let mut values: Vec<f64> = estimates.iter().map(|e| e[0]).collect();
    let middle = median(&mut values);
    let prior = 1.0 / (sigma * sigma);
    let (mut weights, mut sum) = (prior, prior * expected);
    for [value, variance] in estimates {
        // Every estimate contains the prior; it is removed.
        let own = (1.0 / variance - prior).max(0.0);
        let weight = own * tukey(0.5 * (value - middle) / variance.sqrt());
        let free = (value / variance - prior * expected) / own.max(1e-9 * prior);
        weights += weight;
        sum += weight * free;
    }
    // Inflated: segments are correlated.
    [sum / weights, 2.0 / weights.sqrt()]
}

/// Weighted least squares with errors that are correlated within clusters: bursts, image regions.
///
/// Accumulates `JᵀWJ` and `JᵀWr` in total and per cluster, for one or more partitions of the
/// observations into clusters.
#[derive(Clone, Debug)]
pub(super) struct ClusterSums<const N: usize> {
    pub(super) information: SMatrix<f64, N, N>,
    pub(super) gradient: SVector<f64, N>,
    partitions: Vec<Vec<Cluster<N>>>,
}

#[derive(Clone, Debug)]
struct Cluster<const N: usize> {
    information: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
}

impl<const N: usize> ClusterSums<N> {
    /// With prior standard deviations of the parameters about `expected - now`; infinite for no
    /// prior. `groups` are the numbers of clusters of each partition.
    pub(super) fn new(
        groups: &[usize],
        sigmas: &SVector<f64, N>,
        towards: &SVector<f64, N>,
    ) -> Self {
        let empty = Cluster {
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
        };
        let mut new = Self {
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
            partitions: groups.iter().map(|n| vec![empty.clone(); *n]).collect(),
        };
        for k in 0..N {
            let weight = 1.0 / (sigmas[k] * sigmas[k]);
            new.information[(k, k)] = weight;
            new.gradient[k] = weight * towards[k];
        }
        new
    }

    /// Adds residuals, the Jacobian of their prediction, and their weight. `groups` are their
    /// clusters, one per partition.
    pub(super) fn add<const M: usize>(
        &mut self,
        groups: &[usize],
        residual: &SVector<f64, M>,
        by: &SMatrix<f64, M, N>,
        weight: &SMatrix<f64, M, M>,
    ) {
        let weighted = by.transpose() * weight;
        let information = weighted * by;
        let gradient = weighted * residual;
        self.information += information;
        self.gradient += gradient;
        for (clusters, group) in self.partitions.iter_mut().zip(groups) {
            clusters[*group].information += information;
            clusters[*group].gradient += gradient;
        }
    }

    /// The step to the minimum.
    pub(super) fn step(&self) -> Option<SVector<f64, N>> {
        Some(self.information.cholesky()?.solve(&self.gradient))
    }

    /// Covariance for observations of unit variance, and its inflation by the clusters of the first
    /// partition: the sandwich estimate (Liang and Zeger 1986), reduced to one factor, which works
    /// with few clusters. `which` are the parameters of interest.
    pub(super) fn covariance(&self, which: &[usize]) -> Option<(SMatrix<f64, N, N>, f64)> {
        let inverse = self.information.cholesky()?.inverse();
        let used = self.partitions[0].iter().map(|c| c.gradient);
        let used = used.filter(|g| g.norm_squared() > 0.0);
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

    /// Covariance by the jackknife: the variance of each parameter is the largest of that of
    /// independent observations and those by leaving out one cluster at a time, of any partition
    /// with at least three clusters (Efron and Stein 1981; linearized). Correlations are those of
    /// independent observations.
    pub(super) fn jackknife(&self) -> Option<SMatrix<f64, N, N>> {
        let inverse = self.information.cholesky()?.inverse();
        let mut inflation = SVector::<f64, N>::repeat(1.0);
        for clusters in &self.partitions {
            let used = clusters.iter().filter(|c| c.gradient.norm_squared() > 0.0);
            let count = used.clone().count();
            if count < 3 {
                continue;
            }
            let mut squares = SVector::<f64, N>::zeros();
            for cluster in used {
                let rest = self.information - cluster.information;
                let change = rest.cholesky()?.solve(&cluster.gradient);
                squares += change.component_mul(&change);
            }
            let share = (count - 1) as f64 / count as f64;
            for k in 0..N {
                inflation[k] = inflation[k].max(share * squares[k] / inverse[(k, k)]);
            }
        }
        let inflation = SMatrix::from_diagonal(&inflation.map(f64::sqrt));
        Some(inflation * inverse * inflation)
    }
}
