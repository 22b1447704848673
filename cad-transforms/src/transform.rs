//! Rigid transforms between frames.
//!
//! Contract: a [`RigidTransform`] that exists is finite and a proper rotation with a translation.
//! Whatever comes in is checked against a stated tolerance and refused beyond it, never silently
//! repaired: a calibration that deviates by more than its printed digits is a wrong calibration.
//! Within the tolerance it is brought to the nearest rotation. A quaternion that already is of unit
//! length to the last bits is kept as it is, so writing and reading again changes nothing.

use std::ops::Mul;

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::so3;

/// Maximum deviation of a quaternion's norm from 1. Six printed digits per component are within it.
pub const UNIT_TOLERANCE: f64 = 2e-6;

/// Maximum deviation of an entry of `RᵀR` from the identity. Six printed digits per entry (as in
/// KITTI's pose files) are within it; a scale or shear of 10 ppm does not.
const ORTHONORMAL_TOLERANCE: f64 = 1e-5;

/// A rigid transform `b_from_a`: takes coordinates in frame `a` to coordinates in frame `b`,
/// `x_in_b = R x_in_a + t`, where `t` is the origin of `a` in `b`, in metres.
///
/// Name values after it: `let c_from_a = c_from_b * b_from_a;`.
///
/// ```
/// use cad_transforms::RigidTransform;
/// // The right optical frame sits 63 mm along the left one's x axis.
/// let left_from_right = RigidTransform::from_translation_m([0.063, 0.0, 0.0]).unwrap();
/// let right_from_left = left_from_right.inverse();
/// assert_eq!(right_from_left.apply([0.063, 0.0, 2.0]), [0.0, 0.0, 2.0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "TransformJson", into = "TransformJson")]
pub struct RigidTransform {
    rotation: UnitQuaternion<f64>,
    translation: Vector3<f64>,
}

/// Why numbers are not a rigid transform.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TransformError {
    /// A component is NaN or infinite.
    #[error("a component is not a finite number")]
    NotFinite,
    /// The quaternion is not of unit length: wrong order, wrong digits, or not a rotation at all.
    #[error("the quaternion's norm is {norm}, expected 1 within {UNIT_TOLERANCE}")]
    NotUnit {
        /// Norm as found.
        norm: f64,
    },
    /// The 3x3 block is not orthonormal: scaled, sheared, or printed with too few digits.
    #[error(
        "the rotation matrix is not orthonormal: RᵀR is off the identity by {deviation}, \
         expected at most {ORTHONORMAL_TOLERANCE}"
    )]
    NotOrthonormal {
        /// Largest deviation of an entry of `RᵀR` from the identity.
        deviation: f64,
    },
    /// The 3x3 block mirrors: one axis points the other way, or two are swapped.
    #[error("the rotation matrix is left-handed (determinant {determinant}), expected +1")]
    LeftHanded {
        /// Determinant as found.
        determinant: f64,
    },
    /// The last row of a 4x4 matrix is not `0 0 0 1`: stored column by column, or not rigid.
    #[error("the last row of the 4x4 matrix is {found:?}, expected [0, 0, 0, 1] (rows first)")]
    LastRow {
        /// Row as found.
        found: [f64; 4],
    },
}

impl RigidTransform {
    /// The transform that changes nothing.
    pub fn identity() -> Self {
        Self {
            rotation: UnitQuaternion::identity(),
            translation: Vector3::zeros(),
        }
    }

    /// The axes of an optical frame (x right, y down, z forward) as those of a body (x forward, y
    /// left, z up): forward is optical z, left is -x, up is -y. Exact, and without translation.
    ///
    /// ```
    /// use cad_transforms::RigidTransform;
    /// let body_from_optical = RigidTransform::body_from_optical();
    /// assert_eq!(body_from_optical.apply([1.0, 2.0, 3.0]), [3.0, -1.0, -2.0]);
    /// ```
    pub fn body_from_optical() -> Self {
        Self {
            rotation: UnitQuaternion::new_unchecked(Quaternion::new(0.5, -0.5, 0.5, -0.5)),
            translation: Vector3::zeros(),
        }
    }

    /// From a unit quaternion `w x y z` (Hamilton) and a translation in metres.
    ///
    /// # Errors
    /// [`TransformError::NotFinite`], [`TransformError::NotUnit`].
    pub fn from_wxyz(
        rotation_wxyz: [f64; 4],
        translation_m: [f64; 3],
    ) -> Result<Self, TransformError> {
        let [w, x, y, z] = rotation_wxyz;
        let quaternion = Quaternion::new(w, x, y, z);
        let norm_squared = quaternion.norm_squared();
        let norm = norm_squared.sqrt();
        if !norm.is_finite() {
            return Err(TransformError::NotFinite);
        }
        if (norm - 1.0).abs() > UNIT_TOLERANCE {
            return Err(TransformError::NotUnit { norm });
        }
        // Rounding of the four components alone moves the squared norm by a few ulps.
        let rotation = if (norm_squared - 1.0).abs() <= 8.0 * f64::EPSILON {
            UnitQuaternion::new_unchecked(quaternion)
        } else {
            UnitQuaternion::new_normalize(quaternion)
        };
        Self::new(rotation, translation_m)
    }

    /// A pure translation in metres.
    ///
    /// # Errors
    /// [`TransformError::NotFinite`].
    pub fn from_translation_m(translation_m: [f64; 3]) -> Result<Self, TransformError> {
        Self::new(UnitQuaternion::identity(), translation_m)
    }

    /// From a rotation vector (axis times angle, radians; OpenCV's `Rodrigues`) and a translation
    /// in metres.
    ///
    /// # Errors
    /// [`TransformError::NotFinite`].
    pub fn from_rotation_vector(
        rotation_rad: [f64; 3],
        translation_m: [f64; 3],
    ) -> Result<Self, TransformError> {
        let axis_angle = Vector3::from(rotation_rad);
        // The norm also catches finite components too large to square.
        if !axis_angle.norm().is_finite() {
            return Err(TransformError::NotFinite);
        }
        Self::new(so3::exp(axis_angle), translation_m)
    }

    /// From the nine entries of a rotation matrix, rows first, and a translation in metres.
    ///
    /// # Errors
    /// [`TransformError::NotFinite`], [`TransformError::NotOrthonormal`],
    /// [`TransformError::LeftHanded`].
    pub fn from_rotation_rows(
        rows: [f64; 9],
        translation_m: [f64; 3],
    ) -> Result<Self, TransformError> {
        if rows.iter().any(|v| !v.is_finite()) {
            return Err(TransformError::NotFinite);
        }
        let matrix = Matrix3::from_row_slice(&rows);
        let deviation = (matrix.transpose() * matrix - Matrix3::identity()).amax();
        if deviation > ORTHONORMAL_TOLERANCE {
            return Err(TransformError::NotOrthonormal { deviation });
        }
        let determinant = matrix.determinant();
        if determinant < 0.0 {
            return Err(TransformError::LeftHanded { determinant });
        }
        // One Newton step towards the polar factor, R (3I - RᵀR) / 2, takes the allowed deviation
        // of 1e-5 to 1e-10 and the quaternion's normalisation removes the rest. No iteration, so
        // the same bytes come out everywhere.
        let nearest = matrix * (Matrix3::identity() * 3.0 - matrix.transpose() * matrix) * 0.5;
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest));
        Self::new(
            UnitQuaternion::new_normalize(rotation.into_inner()),
            translation_m,
        )
    }

    /// From a 3x4 matrix `[R | t]`, rows first, translation in metres.
    ///
    /// # Errors
    /// As [`Self::from_rotation_rows`].
    pub fn from_rows_3x4(rows: [f64; 12]) -> Result<Self, TransformError> {
        let r = &rows;
        Self::from_rotation_rows(
            [r[0], r[1], r[2], r[4], r[5], r[6], r[8], r[9], r[10]],
            [r[3], r[7], r[11]],
        )
    }

    /// From a 4x4 matrix, rows first, translation in metres. The last row must be `0 0 0 1`.
    ///
    /// # Errors
    /// [`TransformError::LastRow`], and as [`Self::from_rotation_rows`].
    pub fn from_rows_4x4(rows: [f64; 16]) -> Result<Self, TransformError> {
        let (top, last) = rows.split_at(12);
        if last != [0.0, 0.0, 0.0, 1.0] {
            return Err(TransformError::LastRow {
                found: [last[0], last[1], last[2], last[3]],
            });
        }
        let mut rows_3x4 = [0.0; 12];
        rows_3x4.copy_from_slice(top);
        Self::from_rows_3x4(rows_3x4)
    }

    /// `a_from_b` of this `b_from_a`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self {
            rotation,
            translation: rotation * -self.translation,
        }
    }

    /// Takes a point in frame `a` to the same point in frame `b`, metres.
    pub fn apply(&self, x_in_a: [f64; 3]) -> [f64; 3] {
        (self.rotation * Vector3::from(x_in_a) + self.translation).into()
    }

    /// Takes a direction or a rate in frame `a` to frame `b`: rotates, does not translate.
    pub fn rotate(&self, v_in_a: [f64; 3]) -> [f64; 3] {
        (self.rotation * Vector3::from(v_in_a)).into()
    }

    /// Unit quaternion `w x y z`. Of the two that name one rotation, the one whose first non-zero
    /// component is positive, so that equal rotations are written equally.
    pub fn rotation_wxyz(&self) -> [f64; 4] {
        let q = self.rotation.quaternion();
        let wxyz = [q.w, q.i, q.j, q.k];
        match wxyz.iter().find(|v| **v != 0.0) {
            Some(first) if *first < 0.0 => wxyz.map(|v| -v),
            _ => wxyz,
        }
    }

    /// Origin of `a` in `b`, metres.
    pub fn translation_m(&self) -> [f64; 3] {
        self.translation.into()
    }

    /// The nine entries of the rotation matrix, rows first.
    pub fn rotation_rows(&self) -> [f64; 9] {
        let m = self.rotation.to_rotation_matrix();
        std::array::from_fn(|i| m[(i / 3, i % 3)])
    }

    /// Rotation vector (axis times angle), radians, length in `0..=π`.
    pub fn rotation_vector(&self) -> [f64; 3] {
        so3::log(&self.rotation).into()
    }

    /// Rotation angle in radians, in `0..=π`.
    pub fn angle_rad(&self) -> f64 {
        self.rotation.angle()
    }

    /// Distance between the two origins, metres. Of a `right_from_left` it is the baseline.
    pub fn distance_m(&self) -> f64 {
        self.translation.norm()
    }

    /// Rotation for computing with nalgebra.
    pub fn rotation(&self) -> &UnitQuaternion<f64> {
        &self.rotation
    }

    /// Translation for computing with nalgebra, metres.
    pub fn translation(&self) -> &Vector3<f64> {
        &self.translation
    }

    fn new(rotation: UnitQuaternion<f64>, translation_m: [f64; 3]) -> Result<Self, TransformError> {
        if translation_m.iter().any(|v| !v.is_finite()) {
            return Err(TransformError::NotFinite);
        }
        Ok(Self {
            rotation,
            translation: Vector3::from(translation_m),
        })
    }
}

/// `c_from_b * b_from_a = c_from_a`.
impl Mul for RigidTransform {
    type Output = Self;

    fn mul(self, b_from_a: Self) -> Self {
        let c_from_b = self;
        // Renormalised: a long chain of products would otherwise drift off unit length.
        let product = c_from_b.rotation * b_from_a.rotation;
        Self {
            rotation: UnitQuaternion::new_normalize(product.into_inner()),
            translation: c_from_b.rotation * b_from_a.translation + c_from_b.translation,
        }
    }
}

/// How a transform is written in JSON.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TransformJson {
    rotation_wxyz: [f64; 4],
    translation_m: [f64; 3],
}

impl TryFrom<TransformJson> for RigidTransform {
    type Error = TransformError;

    fn try_from(stored: TransformJson) -> Result<Self, TransformError> {
        Self::from_wxyz(stored.rotation_wxyz, stored.translation_m)
    }
}

impl From<RigidTransform> for TransformJson {
    fn from(b_from_a: RigidTransform) -> Self {
        Self {
            rotation_wxyz: b_from_a.rotation_wxyz(),
            translation_m: b_from_a.translation_m(),
        }
    }
}

#[cfg(test)]
mod tests;
