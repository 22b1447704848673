//! Poses as homogeneous matrices.

use cad_transforms::RigidTransform;
use numpy::{PyArray1, PyArray3, PyArrayMethods};
use pyo3::prelude::*;

/// A pose as the rows of a matrix.
pub(crate) fn rows(pose: &RigidTransform) -> [[f64; 4]; 4] {
    let translation = pose.translation_m();
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|a| pose.rotate(a));
    let row = |k: usize| [axes[0][k], axes[1][k], axes[2][k], translation[k]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

/// Poses as an array of matrices, shape (N, 4, 4).
pub(crate) fn matrices<'a, 'py>(
    py: Python<'py>,
    poses: impl Iterator<Item = &'a RigidTransform>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let values: Vec<f64> = poses.flat_map(rows).flatten().collect();
    let count = values.len() / 16;
    PyArray1::from_vec(py, values).reshape([count, 4, 4])
}
