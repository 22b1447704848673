//! Covariance of a rigid transform.
//!
//! Contract: a [`Covariance`] that exists is finite, symmetric and has no negative variance in any
//! direction. It belongs to a transform `parent_from_child` and describes a small motion of the
//! child:
//!
//! ```text
//! true parent_from_child = parent_from_child * motion(v, w)
//! ```
//!
//! with `v` a translation in metres and `w` a rotation vector in radians, **both in the axes of the
//! child and about the child's origin**. The order is translation before rotation:
//! `[vx, vy, vz, wx, wy, wz]`. For an optical frame the third number is thus along the view, and
//! the sixth is the rotation of the image in its plane.
//!
//! To first order a motion seen from another frame is `Ad * [v, w]` with the adjoint of the
//! transform between the frames (Barfoot, State Estimation for Robotics, 2nd ed., section 8.1.4,
//! there with the same order).

use nalgebra::{Matrix6, SymmetricEigen};
use serde::{Deserialize, Serialize};

use crate::transform::RigidTransform;

/// Maximum difference of two mirrored entries, in units of the product of their sigmas; printed
/// digits are within it.
const SYMMETRY_TOLERANCE: f64 = 1e-6;

/// The lowest eigenvalue of the correlation matrix that still counts as zero.
const LOWEST_EIGENVALUE: f64 = -1e-9;

/// Covariance of a small motion of the child: rows of `[vx, vy, vz, wx, wy, wz]`, m and rad; see
/// the [module](self) for the frame.
///
/// ```
/// use cad_transforms::Covariance;
/// // Bolted within 0.2 mm and 0.1 degrees.
/// let joint = Covariance::from_sigmas([2e-4; 3], [0.1_f64.to_radians(); 3]).unwrap();
/// assert_eq!(joint.sigmas()[0], 2e-4);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "[[f64; 6]; 6]", into = "[[f64; 6]; 6]")]
pub struct Covariance(Matrix6<f64>);

/// Why numbers are not a covariance.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CovarianceError {
    /// A component is NaN or infinite.
    #[error("a component of the covariance is not a finite number")]
    NotFinite,
    /// A sigma or a variance is below zero.
    #[error("entry {index} of the diagonal is {found}, expected 0 or more")]
    Negative {
        /// Index on the diagonal, from 0.
        index: usize,
        /// Value as found.
        found: f64,
    },
    /// Two mirrored entries differ.
    #[error(
        "the covariance is not symmetric: row {row}, column {column} is {found}, the mirrored entry {mirrored}"
    )]
    NotSymmetric {
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// Value as found.
        found: f64,
        /// Value of the mirrored entry.
        mirrored: f64,
    },
    /// Some direction would have a negative variance.
    #[error(
        "the covariance is not one: its correlation matrix has the eigenvalue {eigenvalue}, expected none below 0"
    )]
    NotPositive {
        /// The lowest eigenvalue of the correlation matrix.
        eigenvalue: f64,
    },
}

impl Covariance {
    /// Zero: the two frames are identical by definition.
    pub fn zero() -> Self {
        Self(Matrix6::zeros())
    }

    /// Independent errors: standard deviations of the translation, m, and of the rotation vector,
    /// rad, along the child's axes.
    ///
    /// # Errors
    /// [`CovarianceError::NotFinite`], [`CovarianceError::Negative`].
    pub fn from_sigmas(shift_m: [f64; 3], turn_rad: [f64; 3]) -> Result<Self, CovarianceError> {
        let sigmas = [shift_m, turn_rad].concat();
        if let Some((index, &found)) = sigmas.iter().enumerate().find(|(_, s)| **s < 0.0) {
            return Err(CovarianceError::Negative { index, found });
        }
        let mut rows = [[0.0; 6]; 6];
        for (i, sigma) in sigmas.iter().enumerate() {
            rows[i][i] = sigma * sigma;
        }
        Self::from_rows(rows)
    }

    /// From all entries. Mirrored entries that differ in the last printed digits are averaged.
    ///
    /// # Errors
    /// [`CovarianceError`], each variant.
    pub fn from_rows(rows: [[f64; 6]; 6]) -> Result<Self, CovarianceError> {
        if rows.iter().flatten().any(|v| !v.is_finite()) {
            return Err(CovarianceError::NotFinite);
        }
        let mut matrix = Matrix6::from_fn(|i, j| rows[i][j]);
        if let Some(index) = (0..6).find(|&i| matrix[(i, i)] < 0.0) {
            let found = matrix[(index, index)];
            return Err(CovarianceError::Negative { index, found });
        }
        let sigma: [f64; 6] = std::array::from_fn(|i| matrix[(i, i)].sqrt());
        for row in 0..6 {
            for column in 0..row {
                let (found, mirrored) = (matrix[(row, column)], matrix[(column, row)]);
                let scale = sigma[row] * sigma[column];
                if (found - mirrored).abs() > SYMMETRY_TOLERANCE * scale {
                    return Err(CovarianceError::NotSymmetric {
                        row,
                        column,
                        found,
                        mirrored,
                    });
                }
                if found != mirrored {
                    let mean = 0.5 * (found + mirrored);
                    (matrix[(row, column)], matrix[(column, row)]) = (mean, mean);
                }
            }
        }
        // Metres and radians have no common size, correlations do. A direction without variance has
        // none with any other either.
        let correlation = Matrix6::from_fn(|i, j| {
            let scale = sigma[i] * sigma[j];
            match (i == j, scale > 0.0) {
                (true, _) => 1.0,
                (false, true) => matrix[(i, j)] / scale,
                (false, false) => matrix[(i, j)] * f64::INFINITY,
            }
        })
        .map(|v| if v.is_nan() { 0.0 } else { v });
        if correlation.iter().any(|v| v.is_infinite()) {
            let eigenvalue = f64::NEG_INFINITY;
            return Err(CovarianceError::NotPositive { eigenvalue });
        }
        let eigenvalue = SymmetricEigen::new(correlation).eigenvalues.min();
        if eigenvalue < LOWEST_EIGENVALUE {
            return Err(CovarianceError::NotPositive { eigenvalue });
        }
        Ok(Self(matrix))
    }

    /// All entries, rows first.
    pub fn rows(&self) -> [[f64; 6]; 6] {
        std::array::from_fn(|i| std::array::from_fn(|j| self.0[(i, j)]))
    }

    /// Standard deviations: three of the translation, m, three of the rotation, rad.
    pub fn sigmas(&self) -> [f64; 6] {
        std::array::from_fn(|i| self.0[(i, i)].sqrt())
    }

    /// For computing with nalgebra.
    pub fn matrix(&self) -> &Matrix6<f64> {
        &self.0
    }

    /// The same covariance in another frame: of a motion written in frame `a`, that motion in frame
    /// `b`.
    #[must_use]
    pub fn moved(&self, b_from_a: &RigidTransform) -> Self {
        let adjoint = adjoint(b_from_a);
        Self(symmetric(adjoint * self.0 * adjoint.transpose()))
    }

    /// Of two independent motions one after the other, both written in this frame.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        Self(self.0 + other.0)
    }

    /// The length of a motion in sigmas (Mahalanobis). Directions without variance count as
    /// infinitely improbable when the motion goes more than 1 nm or 1 nrad along them.
    pub fn distance(&self, motion: [f64; 6]) -> f64 {
        let sigma = self.sigmas();
        // As correlations, for the same reason as above.
        let (mut free, mut fixed) = (Vec::new(), 0.0_f64);
        for i in 0..6 {
            if sigma[i] > 0.0 {
                free.push(i);
            } else {
                fixed = fixed.max(motion[i].abs());
            }
        }
        if fixed > 1e-9 {
            return f64::INFINITY;
        }
        let n = free.len();
        let correlation = nalgebra::DMatrix::from_fn(n, n, |i, j| {
            self.0[(free[i], free[j])] / (sigma[free[i]] * sigma[free[j]])
        });
        let motion = nalgebra::DVector::from_fn(n, |i, _| motion[free[i]] / sigma[free[i]]);
        let eigen = SymmetricEigen::new(correlation);
        let along = eigen.eigenvectors.transpose() * motion;
        let squared = along.iter().zip(eigen.eigenvalues.iter()).map(|(v, e)| {
            if *e > -LOWEST_EIGENVALUE {
                v * v / e
            } else if v.abs() > 1e-6 {
                f64::INFINITY
            } else {
                0.0
            }
        });
        squared.sum::<f64>().sqrt()
    }
}

impl TryFrom<[[f64; 6]; 6]> for Covariance {
    type Error = CovarianceError;

    fn try_from(rows: [[f64; 6]; 6]) -> Result<Self, CovarianceError> {
        Self::from_rows(rows)
    }
}

impl From<Covariance> for [[f64; 6]; 6] {
    fn from(covariance: Covariance) -> Self {
        covariance.rows()
    }
}

/// Takes a small motion `[v, w]` in frame `a` to the same motion in frame `b`.
fn adjoint(b_from_a: &RigidTransform) -> Matrix6<f64> {
    let rotation = *b_from_a.rotation().to_rotation_matrix().matrix();
    let lever = b_from_a.translation().cross_matrix() * rotation;
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(0, 3).copy_from(&lever);
    adjoint
}

fn symmetric(matrix: Matrix6<f64>) -> Matrix6<f64> {
    (matrix + matrix.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigmas_come_back_to_the_bit() {
        let sigmas = [1e-4, 3.3e-4, 0.7e-3, 0.002, 0.1_f64.to_radians(), 0.0];
        let covariance = Covariance::from_sigmas(
            [sigmas[0], sigmas[1], sigmas[2]],
            [sigmas[3], sigmas[4], sigmas[5]],
        )
        .unwrap();
        assert_eq!(covariance.sigmas(), sigmas);
        assert_eq!(
            Covariance::from_rows(covariance.rows()).unwrap(),
            covariance
        );
    }

    #[test]
    fn refuses_what_is_no_covariance() {
        let base = Covariance::from_sigmas([1e-3; 3], [1e-2; 3])
            .unwrap()
            .rows();
        let with = |i: usize, j: usize, v: f64| {
            let mut rows = base;
            rows[i][j] = v;
            Covariance::from_rows(rows).unwrap_err()
        };
        assert_eq!(with(2, 2, f64::NAN), CovarianceError::NotFinite);
        assert!(matches!(
            with(4, 4, -1.0),
            CovarianceError::Negative { index: 4, .. }
        ));
        assert!(matches!(
            with(0, 1, 1e-7),
            CovarianceError::NotSymmetric { .. }
        ));
        let mut rows = base;
        (rows[0][4], rows[4][0]) = (1.1e-5, 1.1e-5);
        assert!(matches!(
            Covariance::from_rows(rows),
            Err(CovarianceError::NotPositive { .. })
        ));
        rows[0][0] = 0.0;
        assert!(matches!(
            Covariance::from_rows(rows),
            Err(CovarianceError::NotSymmetric { .. } | CovarianceError::NotPositive { .. })
        ));
        assert!(Covariance::from_sigmas([-1.0, 0.0, 0.0], [0.0; 3]).is_err());
    }

    /// A motion of the child, made with transforms, against the adjoint.
    #[test]
    fn a_motion_seen_from_another_frame() {
        let b_from_a =
            RigidTransform::from_rotation_vector([0.4, -0.9, 0.2], [0.3, -1.0, 0.5]).unwrap();
        let motion = [1e-6, -2e-6, 3e-6, 2e-6, 1e-6, -1e-6];
        let in_a = RigidTransform::from_rotation_vector(
            [motion[3], motion[4], motion[5]],
            [motion[0], motion[1], motion[2]],
        )
        .unwrap();
        let in_b = b_from_a * in_a * b_from_a.inverse();
        let expected = adjoint(&b_from_a) * nalgebra::Vector6::from(motion);
        let found = [in_b.translation_m(), in_b.rotation_vector()].concat();
        for (f, e) in found.iter().zip(expected.iter()) {
            assert!((f - e).abs() < 1e-11, "{found:?} {expected:?}");
        }
    }

    #[test]
    fn a_turn_becomes_a_shift_at_the_end_of_a_lever() {
        let joint = Covariance::from_sigmas([0.0; 3], [0.0, 0.0, 0.01]).unwrap();
        let tip_from_joint = RigidTransform::from_translation_m([-0.5, 0.0, 0.0]).unwrap();
        let sigmas = joint.moved(&tip_from_joint).sigmas();
        assert!(
            (sigmas[1] - 0.005).abs() < 1e-15 && sigmas[0] == 0.0,
            "{sigmas:?}"
        );
        assert!((sigmas[5] - 0.01).abs() < 1e-15);
    }

    #[test]
    fn distance_is_in_sigmas() {
        let covariance = Covariance::from_sigmas([1e-3, 2e-3, 1e-3], [0.01, 0.0, 0.01]).unwrap();
        let d = covariance.distance([3e-3, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!((d - 3.0).abs() < 1e-9, "{d}");
        let d = covariance.distance([0.0, 6e-3, 0.0, 0.04, 0.0, 0.0]);
        assert!((d - 5.0).abs() < 1e-9, "{d}");
        assert_eq!(
            covariance.distance([0.0, 0.0, 0.0, 0.0, 0.1, 0.0]),
            f64::INFINITY
        );
    }
}
