//! Scaling of symmetric matrices.

use nalgebra::{DMatrix, DVector};

/// The matrix scaled to a unit diagonal, and the scale factors.
pub(super) fn unit_diagonal(matrix: &DMatrix<f64>) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let diagonal = matrix.diagonal();
    if diagonal.iter().any(|d| !(*d > 0.0 && d.is_finite())) {
        return None;
    }
    let by = diagonal.map(|d| 1.0 / d.sqrt());
    let scaled = DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
        matrix[(i, j)] * by[i] * by[j]
    });
    Some((scaled, by))
}
