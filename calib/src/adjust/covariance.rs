//! How sure the found numbers are.
//!
//! Contract: two estimates are made and of each number the larger variance is told. The first is the
//! inverse of the information, which is right when all corners err independently. The second sums what
//! each stay really pulled ("sandwich", Huber 1967; clusters after Liang and Zeger 1986), which is right
//! when the corners of one picture err together, as they do under blur, and pictures of one view alike, as they do by pixels and
//! compression.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix6};

use super::normal::{Layout, Loss, Normal, build};
use super::solve::unit_diagonal;
use super::{AdjustError, Parameter, PlacePrior, Prior, Problem};

/// Smallest eigenvalue of the information, scaled to ones on its diagonal, of what is determined.
const LEAST_EIGENVALUE: f64 = 1e-13;

/// A number with a larger sigma than this is not determined: places in m and rad, coefficients of a
/// lens; of focal lengths and principal points it is the width of the picture.
const UNDETERMINED: (f64, f64, f64) = (10.0, 1.0, 100.0);

/// Covariance of the free numbers of a problem.
#[derive(Clone, Debug)]
pub struct Covariance {
    /// Which numbers, in the order of rows and columns.
    pub parameters: Vec<Parameter>,
    /// Their covariance; of places `[v, ω]`, m and rad.
    pub matrix: DMatrix<f64>,
    /// By how much the second estimate of each sigma exceeds the first; 1 where it does not.
    pub inflation: Vec<f64>,
}

impl Covariance {
    /// Standard deviation of a number; 0 for one that is fixed.
    pub fn sigma(&self, parameter: Parameter) -> f64 {
        let found = self.parameters.iter().position(|p| *p == parameter);
        found.map_or(0.0, |i| self.matrix[(i, i)].sqrt())
    }

    /// The block between two places, by their numbers; 0 where one of them is held.
    pub fn between(&self, a: usize, b: usize) -> Matrix6<f64> {
        let begin = |place| {
            self.parameters
                .iter()
                .position(|p| *p == Parameter::Place(place, 0))
        };
        match (begin(a), begin(b)) {
            (Some(a), Some(b)) => self.matrix.fixed_view::<6, 6>(a, b).into_owned(),
            _ => Matrix6::zeros(),
        }
    }

    pub(super) fn of(problem: &Problem, layout: &Layout, loss: &Loss) -> Result<Self, AdjustError> {
        let normal = build(problem, layout, loss, 0.0);
        let parameters = problem.parameters();
        let inverse = invert(problem, &parameters, &normal)?;
        let n = layout.count;
        let mut pulls = DMatrix::zeros(n, n);
        let mut by_stay: BTreeMap<usize, DVector<f64>> = BTreeMap::new();
        for (instant, share) in normal.shares.iter().enumerate() {
            if share.columns.is_empty() {
                continue;
            }
            let stay = problem.stays.get(instant).copied().unwrap_or(instant);
            let sum = by_stay.entry(stay).or_insert_with(|| DVector::zeros(n));
            for (i, &column) in share.columns.iter().enumerate() {
                sum[column] += share.score[i];
            }
        }
        for score in by_stay.values() {
            pulls.ger(1.0, score, score, 1.0);
        }
        let k = by_stay.len() as f64;
        if by_stay.len() > 1 {
            pulls *= k / (k - 1.0);
        }
        add_prior_information(problem, layout, &mut pulls);
        let clustered = &inverse * pulls * &inverse;
        let inflation: Vec<f64> = (0..n)
            .map(|i| (clustered[(i, i)] / inverse[(i, i)]).max(1.0).sqrt())
            .collect();
        let by = DVector::from_vec(inflation.clone());
        let matrix = DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * by[i] * by[j]);
        Ok(Self {
            parameters,
            matrix,
            inflation,
        })
    }
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
    if eigen.eigenvalues[least] < LEAST_EIGENVALUE {
        return Err(undetermined(eigen.eigenvectors.column(least).icamax()));
    }
    let inverse = scaled
        .cholesky()
        .ok_or_else(|| undetermined(eigen.eigenvectors.column(least).icamax()))?
        .inverse();
    let inverse = DMatrix::from_fn(by.len(), by.len(), |i, j| inverse[(i, j)] * by[i] * by[j]);
    let (metres, radians, coefficient) = UNDETERMINED;
    let too_wide = |i: &usize| {
        let most = match parameters[*i] {
            Parameter::Lens(lens, 0..4) => f64::from(problem.lenses[lens].model.width),
            Parameter::Lens(..) => coefficient,
            Parameter::Place(_, 0..3) => metres,
            Parameter::Place(..) => radians,
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
    for (place, column) in problem.places.iter().zip(&layout.places) {
        if let (PlacePrior::Near { covariance, .. }, Some(c)) = (&place.prior, column) {
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
