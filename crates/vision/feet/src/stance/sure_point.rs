//! The point of a foot whose place a frame tells best.

use cad_transforms::{Covariance, RigidTransform};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::poses::pose;

/// Uncertainty of a position, given its rotation, up to which a pose tells whether a foot rests, m.
pub(super) const MAX_SIGMA_M: f64 = 0.01;

/// Standard deviations, in three dimensions, by which displacements of a point at rest seem to
/// differ from none: fewer in 99.5 % of the cases.
const PLACE_SIGMAS: f64 = 3.6;

/// The point of a foot that a pose knows best: the middle of its tag. Fits that end in a wrong tilt
/// tell its place all the same, and a foot that rolls moves it.
pub(super) struct SurePoint {
    foot_from_point: RigidTransform,
}

impl SurePoint {
    pub(super) fn of(covariance: &Covariance) -> Self {
        let matrix = covariance.matrix();
        let rotation = matrix.fixed_view::<3, 3>(3, 3).into_owned();
        // By how much a rotation usually displaces the origin.
        let lever = rotation
            .try_inverse()
            .map_or_else(Matrix3::zeros, |inverse| {
                matrix.fixed_view::<3, 3>(0, 3).into_owned() * inverse
            });
        let point = pose(&UnitQuaternion::identity(), &(0.5 * skew_part(&lever)));
        Self {
            foot_from_point: point.unwrap_or_else(RigidTransform::identity),
        }
    }

    /// Displacement of the point from one pose of the foot to another one, in the axes of the
    /// first, m.
    pub(super) fn displacement(&self, a: &RigidTransform, b: &RigidTransform) -> Vector3<f64> {
        let moved = a.inverse() * *b * self.foot_from_point;
        moved.translation() - self.foot_from_point.translation()
    }

    /// Covariance of its place in the axes of the foot, m².
    pub(super) fn covariance(&self, of_foot: &Covariance) -> Matrix3<f64> {
        let of_point = of_foot.moved(&self.foot_from_point.inverse());
        of_point.matrix().fixed_view::<3, 3>(0, 0).into_owned()
    }
}

/// Whether a displacement is none, within a tolerance, m, and errors that are themselves small.
pub(super) fn is_small(
    displacement: &Vector3<f64>,
    covariance: &Matrix3<f64>,
    tolerance_m: f64,
) -> bool {
    let tolerance = Matrix3::identity() * (tolerance_m / PLACE_SIGMAS).powi(2);
    let square = (covariance + tolerance)
        .try_inverse()
        .map(|inverse| displacement.dot(&(inverse * displacement)));
    covariance.diagonal().max() < MAX_SIGMA_M * MAX_SIGMA_M
        && square.is_some_and(|square| square < PLACE_SIGMAS * PLACE_SIGMAS)
}

/// The vector whose cross product is twice the antisymmetric part of a matrix.
fn skew_part(matrix: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(
        matrix[(2, 1)] - matrix[(1, 2)],
        matrix[(0, 2)] - matrix[(2, 0)],
        matrix[(1, 0)] - matrix[(0, 1)],
    )
}
