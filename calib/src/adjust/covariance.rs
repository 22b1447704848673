//! How sure the found numbers are.
//!
//! Contract: two estimates are made, and of what is asked for the larger variance is told. The first is the
//! inverse of the information, which is right when all corners err independently. The second leaves out each stay in turn and
//! sees how far the result moves (the jackknife of Quenouille and Tukey, one linear step for each stay), which is right when
//! the corners of one picture err together, as they do under blur, and pictures of one view alike, as they do by
//! pixels and compression. Few stays carry much of what joins cameras: summing their pulls without leaving them out
//! (Huber's sandwich) takes errors for small that they have fitted away.
//!
//! The larger one is taken of what is asked for, such as the place of one camera in another, not of the numbers that it
//! follows from: where the rig's frame is, is known from the rig file alone and hides what the places say of each other.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, SVector, Vector6};

use super::normal::{Layout, Loss, Normal, build};
use super::solve::unit_diagonal;
use super::{AdjustError, Parameter, PosePrior, Prior, Problem};

/// Smallest eigenvalue of the information, scaled to ones on its diagonal, of what is determined.
const MIN_EIGENVALUE: f64 = 1e-13;

/// A number with a larger sigma than this is not determined: places in m and rad, coefficients of a
/// lens; of focal lengths and principal points it is the width of the picture.
const UNDETERMINED_SIGMA: (f64, f64, f64) = (10.0, 1.0, 100.0);

/// How sure the free numbers of a problem are.
#[derive(Clone, Debug)]
pub struct Covariance {
    /// Which numbers, in the order of rows and columns.
    pub parameters: Vec<Parameter>,
    /// Where all corners err independently.
    independent: DMatrix<f64>,
    /// Where those of a stay err together.
    by_cluster: DMatrix<f64>,
}

impl Covariance {
    /// Standard deviation of a number; 0 for one that is fixed.
    pub fn sigma(&self, parameter: Parameter) -> f64 {
        let variance = |i| self.independent[(i, i)].max(self.by_cluster[(i, i)]);
        self.column(parameter).map_or(0.0, |i| variance(i).sqrt())
    }

    /// Covariance of `N` numbers, each parameter with how they change with it. What is fixed does not change.
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

    /// Covariance `[v, ω]` of a place, by its number; 0 for one that is held.
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

/// What [`Covariance::of`] takes of numbers that change by `by` times the `[v, ω]` of a place.
pub(crate) fn pose_jacobian(place: usize, by: &Matrix6<f64>) -> [(Parameter, Vector6<f64>); 6] {
    std::array::from_fn(|k| (Parameter::Pose(place, k), by.column(k).into_owned()))
}

/// How far the numbers spread that would be found without one stay, for each stay; with what priors leave open.
fn jackknife(
    problem: &Problem,
    layout: &Layout,
    normal: &Normal,
    independent: &DMatrix<f64>,
) -> DMatrix<f64> {
    let n = layout.count;
    let mut clusters: BTreeMap<usize, (DVector<f64>, DMatrix<f64>)> = BTreeMap::new();
    for (instant, share) in normal.shares.iter().enumerate() {
        if share.columns.is_empty() {
            continue;
        }
        let stay = problem.clusters.get(instant).copied().unwrap_or(instant);
        let (score, information) = clusters
            .entry(stay)
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
            // Without this stay there would be no result.
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

/// A prior pulls as far as it says that it may be off.
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
