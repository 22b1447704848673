//! Least squares of pairs: the closed form of Umeyama (1991), and the covariance of its result.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector3};

use super::association::{Pair, Pairs};
use super::{Alignment, AlignmentModel, mean, refuse};
use crate::error::SimulationError;
use crate::scene::Similarity;

/// A fit with its inliers.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) transform: Similarity,
    pub(super) inliers: Vec<bool>,
}

/// Residual of a pair.
pub(super) fn residual(transform: &Similarity, pair: &Pair) -> Vector3<f64> {
    pair.reference - Vector3::from(transform.apply(pair.estimate.into()))
}

/// The transform with the least sum of squares; `None` for positions that are all the same.
pub(super) fn closed_form<'a>(
    pairs: impl Iterator<Item = &'a Pair> + Clone,
    model: AlignmentModel,
) -> Option<Similarity> {
    let of_estimate = mean(pairs.clone().map(|pair| pair.estimate));
    let of_reference = mean(pairs.clone().map(|pair| pair.reference));
    let mut products = Matrix3::zeros();
    let mut square = 0.0;
    for pair in pairs {
        let centered = pair.estimate - of_estimate;
        products += (pair.reference - of_reference) * centered.transpose();
        square += centered.norm_squared();
    }
    if square.is_nan() || square <= f64::MIN_POSITIVE {
        return None;
    }
    let svd = products.try_svd(true, true, 1e-15, 200)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    // The smallest singular value is the last one: of a mirrored optimum it changes its sign.
    let mut signs = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
    let rotation = u * Matrix3::from_diagonal(&signs) * v_t;
    signs.component_mul_assign(&svd.singular_values);
    let scale = match model {
        AlignmentModel::Rigid => 1.0,
        AlignmentModel::Similarity => signs.sum() / square,
    };
    if !(scale.is_finite() && scale > 0.0) {
        return None;
    }
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let rotation = UnitQuaternion::new_normalize(rotation.into_inner());
    let translation = of_reference - rotation * of_estimate * scale;
    Some(Similarity::from_parts(scale, rotation, translation))
}

/// Normal equations of rotation, translation, scale and clock about the center of the inliers.
struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    squares: f64,
    count: usize,
    center: Vector3<f64>,
    /// For each unknown its index in the covariance.
    unknowns: Vec<usize>,
}

impl Normal {
    fn new(pairs: &Pairs, found: &Fit, model: AlignmentModel, with_clock: bool) -> Self {
        let inliers = || {
            let all = pairs.all.iter().zip(&found.inliers);
            all.filter(|(_, is_inlier)| **is_inlier)
                .map(|(pair, _)| pair)
        };
        let aligned = |pair: &Pair| Vector3::from(found.transform.apply(pair.estimate.into()));
        let center = mean(inliers().map(aligned));
        let mut unknowns: Vec<usize> = (0..6).collect();
        if model == AlignmentModel::Similarity {
            unknowns.push(6);
        }
        if with_clock {
            unknowns.push(7);
        }
        let size = unknowns.len();
        let (mut matrix, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let (mut squares, mut count) = (0.0, 0);
        for pair in inliers() {
            let from_center = aligned(pair) - center;
            let residual = residual(&found.transform, pair);
            // Columns of the change of the aligned position minus the reference.
            let rotation = -from_center.cross_matrix();
            let column = |unknown: &usize| match unknown {
                0..3 => rotation.column(*unknown).into_owned(),
                3..6 => Vector3::ith(unknown - 3, 1.0),
                6 => from_center,
                _ => -pair.velocity,
            };
            let columns: Vec<Vector3<f64>> = unknowns.iter().map(column).collect();
            for (i, a) in columns.iter().enumerate() {
                right[i] += a.dot(&residual);
                for (j, b) in columns.iter().enumerate() {
                    matrix[(i, j)] += a.dot(b);
                }
            }
            squares += residual.norm_squared();
            count += 1;
        }
        Self {
            matrix,
            right,
            squares,
            count,
            center,
            unknowns,
        }
    }

    fn inverse(&self) -> Result<DMatrix<f64>, SimulationError> {
        let inverse = self.matrix.clone().cholesky().map(|of| of.inverse());
        let is_finite = |matrix: &DMatrix<f64>| matrix.iter().all(|v| v.is_finite());
        inverse.filter(is_finite).ok_or_else(|| {
            let found = "positions that do not determine the transform and the clock offset";
            let expected = "a path that moves and turns";
            refuse(found.to_owned(), expected.to_owned())
        })
    }
}

/// The step of the clock offset in joint least squares, s.
pub(super) fn clock_step_s(
    pairs: &Pairs,
    found: &Fit,
    model: AlignmentModel,
) -> Result<f64, SimulationError> {
    let normal = Normal::new(pairs, found, model, true);
    let step = normal.inverse()? * &normal.right;
    Ok(step[normal.unknowns.len() - 1])
}

/// A fit with its residual and covariance.
pub(super) fn result(
    pairs: &Pairs,
    found: &Fit,
    model: AlignmentModel,
    with_clock: bool,
    offset_s: f64,
) -> Result<Alignment, SimulationError> {
    let normal = Normal::new(pairs, found, model, with_clock);
    let inverse = normal.inverse()?;
    let freedom = (3 * normal.count)
        .saturating_sub(normal.unknowns.len())
        .max(1);
    let variance = normal.squares / freedom as f64;
    let mut covariance = SMatrix::<f64, 8, 8>::zeros();
    for (i, row) in normal.unknowns.iter().enumerate() {
        for (j, column) in normal.unknowns.iter().enumerate() {
            covariance[(*row, *column)] = variance * inverse[(i, j)];
        }
    }
    let lengths = pairs
        .all
        .iter()
        .map(|pair| residual(&found.transform, pair).norm());
    let mut lengths: Vec<f64> = lengths.collect();
    lengths.sort_by(f64::total_cmp);
    // The nearest rank; there are inliers, so that it exists.
    let rank = (lengths.len() * 95).div_ceil(100).saturating_sub(1);
    Ok(Alignment {
        reference_from_estimate: found.transform,
        clock_offset_ns: (offset_s * 1e9).round() as i64,
        residual_m: (normal.squares / normal.count.max(1) as f64).sqrt(),
        p95_m: lengths.get(rank).copied().unwrap_or(0.0),
        inliers: found.inliers.clone(),
        center_m: normal.center.into(),
        covariance,
    })
}
