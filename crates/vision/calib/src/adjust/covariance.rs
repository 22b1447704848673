//! Covariance of the estimates.
//!
//! Contract: there are two estimates, and for each requested quantity the larger variance is
//! returned. The first is the inverse of the information matrix, which is right if all corner
//! errors are independent. The second is a leave-one-cluster-out jackknife (Quenouille and Tukey,
//! one linear step for each cluster), which is right if the corners of one image have common
//! errors, as with blur, and if near-identical views have common errors, as from pixels and
//! compression. Few clusters contribute much of the constraints between cameras: summing their
//! scores without leaving them out (Huber's sandwich) underestimates errors that the fit has
//! absorbed.
//!
//! The larger one is taken for the requested quantity, such as the pose of one camera in another,
//! not for the parameters it is computed from: the pose of the rig frame is known from the rig file
//! alone and would hide the relative poses.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, SVector, Vector6};

use super::normal::{Layout, Loss, Normal, build};
use super::problem::{AdjustError, Parameter, PosePrior, Prior, Problem};
use super::scaling::unit_diagonal;

/// Minimum eigenvalue of the information matrix, scaled to a unit diagonal, of a determined
/// parameter.
const MIN_EIGENVALUE: f64 = 1e-13;

/// Maximum sigma of a determined parameter: poses in m and rad, coefficients of a lens; for focal
/// lengths and principal points it is the image width.
const UNDETERMINED_SIGMA: (f64, f64, f64) = (10.0, 1.0, 100.0);

/// Covariance of the free parameters of a problem.
#[derive(Clone, Debug)]
pub struct Covariance {
    /// The parameters, in the order of rows and columns.
    pub parameters: Vec<Parameter>,
    /// With independent corner errors.
    independent: DMatrix<f64>,
    /// With common errors within view clusters.
    by_cluster: DMatrix<f64>,
}

impl Covariance {
    /// Standard deviation of a parameter; 0 for a fixed one.
    pub fn sigma(&self, parameter: Parameter) -> f64 {
        let variance = |i| self.independent[(i, i)].max(self.by_cluster[(i, i)]);
        self.column(parameter).map_or(0.0, |i| variance(i).sqrt())
    }

    /// Covariance of `N` quantities, given their derivatives with respect to each parameter. Fixed
    /// parameters do not contribute.
    pub fn of<const N: usize>(&self, by: &[(Parameter, SVector<f64, N>)]) -> SMatrix<f64, N, N> {
        let columns: Vec<(usize, &SVector<f64, N>)> = by
            .iter()
            .filter_map(|(parameter, by)| Some((self.column(*parameter)?, by)))
            .collect();
        let carried = |matrix: &DMatrix<f64>| {
            let mut sum = SMatrix::<f64, N, N>::zeros();
            for (i, by_i) in &columns {
                for (j, by_j) in &columns {
                    sum += *by_i * by_j.transpose() * matrix[(*i, *j)];
                }
            }
            sum
        };
        let (independent, by_cluster) = (carried(&self.independent), carried(&self.by_cluster));
        // Correlations are those of the first estimate, which is never singular.
        let inflation = SVector::<f64, N>::from_fn(|i, _| {
            let ratio = by_cluster[(i, i)] / independent[(i, i)];
            if ratio > 1.0 { ratio.sqrt() } else { 1.0 }
        });
        SMatrix::from_fn(|i, j| independent[(i, j)] * inflation[i] * inflation[j])
    }

    /// Covariance of `[v, ω]` of a pose, by its index; 0 for a fixed one.
    pub fn of_pose(&self, place: usize) -> Matrix6<f64> {
        self.of(&pose_jacobian(place, &Matrix6::identity()))
    }

    fn column(&self, parameter: Parameter) -> Option<usize> {
        self.parameters.iter().position(|p| *p == parameter)
    }

    pub(super) fn estimated(
        problem: &Problem,
        layout: &Layout,
        loss: &Loss,
    ) -> Result<Self, AdjustError> {
        let normal = build(problem, layout, loss, 0.0);
        let parameters = problem.parameters();
        let independent = invert(problem, &parameters, &normal)?;
        let by_cluster = jackknife(problem, layout, &normal, &independent);
        Ok(Self {
            parameters,
            independent,
            by_cluster,
        })
    }
}

/// Input of [`Covariance::of`] for quantities with the Jacobian `by` with respect to `[v, ω]` of a
/// pose.
pub(crate) fn pose_jacobian(place: usize, by: &Matrix6<f64>) -> [(Parameter, Vector6<f64>); 6] {
    std::array::from_fn(|k| (Parameter::Pose(place, k), by.column(k).into_owned()))
}

/// Spread of the parameters over the leave-one-cluster-out solutions, plus the prior uncertainty.
fn jackknife(
    problem: &Problem,
    layout: &Layout,
    normal: &Normal,
    independent: &DMatrix<f64>,
) -> DMatrix<f64> {
    let n = layout.count;
    let mut clusters: BTreeMap<usize, (DVector<f64>, DMatrix<f64>)> = BTreeMap::new();
    for (instant, share) in normal.instant_blocks.iter().enumerate() {
        if share.columns.is_empty() {
            continue;
        }
        let cluster = problem.clusters.get(instant).copied().unwrap_or(instant);
        let (score, information) = clusters
            .entry(cluster)
            .or_insert_with(|| (DVector::zeros(n), DMatrix::zeros(n, n)));
        for (i, &row) in share.columns.iter().enumerate() {
            score[row] += share.score[i];
            for (j, &column) in share.columns.iter().enumerate() {
                information[(row, column)] += share.information[(i, j)];
            }
        }
    }
    let mut prior = DMatrix::zeros(n, n);
    add_prior_information(problem, layout, &mut prior);
    let mut spread = independent * prior * independent;
    let k = clusters.len() as f64;
    for (score, information) in clusters.values() {
        let rest = unit_diagonal(&(&normal.matrix - information));
        let step = match rest.and_then(|(rest, by)| Some((rest.cholesky()?, by))) {
            Some((rest, by)) => rest.solve(&score.component_mul(&by)).component_mul(&by),
            // Without this cluster there would be no solution.
            _ => independent * score,
        };
        spread.ger((k - 1.0) / k, &step, &step, 1.0);
    }
    spread
}

fn invert(
    problem: &Problem,
    parameters: &[Parameter],
    normal: &Normal,
) -> Result<DMatrix<f64>, AdjustError> {
    let undetermined = |i: usize| AdjustError::Undetermined {
        name: problem.name(parameters[i]),
        views: problem.views.len(),
    };
    let Some((scaled, by)) = unit_diagonal(&normal.matrix) else {
        let diagonal = normal.matrix.diagonal();
        return Err(undetermined(diagonal.imin()));
    };
    let eigen = scaled.clone().symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    if eigen.eigenvalues[least] < MIN_EIGENVALUE {
        return Err(undetermined(eigen.eigenvectors.column(least).icamax()));
    }
    let inverse = scaled
        .cholesky()
        .ok_or_else(|| undetermined(eigen.eigenvectors.column(least).icamax()))?
        .inverse();
    let inverse = DMatrix::from_fn(by.len(), by.len(), |i, j| inverse[(i, j)] * by[i] * by[j]);
    let (metres, radians, coefficient) = UNDETERMINED_SIGMA;
    let too_wide = |i: &usize| {
        let most = match parameters[*i] {
            Parameter::Lens(lens, 0..4) => f64::from(problem.lenses[lens].model.width),
            Parameter::Lens(..) => coefficient,
            Parameter::Pose(_, 0..3) => metres,
            Parameter::Pose(..) => radians,
        };
        inverse[(*i, *i)] > most * most
    };
    match (0..parameters.len()).find(too_wide) {
        Some(i) => Err(undetermined(i)),
        None => Ok(inverse),
    }
}

/// Contribution of the priors, with their stated uncertainty.
fn add_prior_information(problem: &Problem, layout: &Layout, pulls: &mut DMatrix<f64>) {
    for (lens, columns) in problem.lenses.iter().zip(&layout.lenses) {
        for (prior, column) in lens.priors.iter().zip(columns) {
            if let (Prior::Near { sigma, .. }, Some(c)) = (prior, column) {
                pulls[(*c, *c)] += 1.0 / (sigma * sigma);
            }
        }
    }
    for (place, column) in problem.poses.iter().zip(&layout.poses) {
        if let (PosePrior::Near { covariance, .. }, Some(c)) = (&place.prior, column) {
            let Some(inverse) = covariance.try_inverse() else {
                continue;
            };
            for i in 0..6 {
                for j in 0..6 {
                    pulls[(c + i, c + j)] += inverse[(i, j)];
                }
            }
        }
    }
}
