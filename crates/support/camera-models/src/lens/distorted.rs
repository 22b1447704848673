//! A point through the distortion, with its Jacobians.

use nalgebra::{Matrix2x3, SMatrix};

use crate::camera::Distortion;

/// Jacobian of a point on the normalized image plane with respect to the coefficients.
pub(super) type ByCoefficients = SMatrix<f64, 2, { Distortion::MAX_COEFFICIENTS }>;

/// A distorted point on the normalized image plane, before focal lengths and principal point.
pub(super) struct DistortedPoint {
    pub(super) at: [f64; 2],
    pub(super) by_point: Matrix2x3<f64>,
    pub(super) by_coefficients: ByCoefficients,
}
