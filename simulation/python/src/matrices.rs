//! Poses as NumPy matrices.

use cad_transforms::RigidTransform;
use numpy::{PyArray1, PyArray3, PyArrayMethods};
use pyo3::prelude::*;

/// Poses as homogeneous matrices.
pub(crate) fn matrices<'a, 'py>(
    py: Python<'py>,
    poses: impl Iterator<Item = &'a RigidTransform>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let mut values = Vec::new();
    for pose in poses {
        let translation = pose.translation_m();
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|a| pose.rotate(a));
        for row in 0..3 {
            values.extend([axes[0][row], axes[1][row], axes[2][row], translation[row]]);
        }
        values.extend([0.0, 0.0, 0.0, 1.0]);
    }
    let count = values.len() / 16;
    PyArray1::from_vec(py, values).reshape([count, 4, 4])
}
