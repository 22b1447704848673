//! Similarity transforms: rotation, translation and scale, Sim(3).

use cad_transforms::RigidTransform;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::error::SimulationError;

/// Norms of quaternions may deviate from 1 by this: numbers printed with six digits.
const UNIT_TOLERANCE: f64 = 1e-5;

/// `b_from_a` with a scale: `x_in_b = scale · rotation · x_in_a + translation`.
///
/// ```
/// use simulation::Similarity;
///
/// let b_from_a = Similarity::new(2.0, [1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0])?;
/// assert_eq!(b_from_a.apply([1.0, 1.0, 0.0]), [3.0, 2.0, 0.0]);
/// assert_eq!(b_from_a.inverse().apply([3.0, 2.0, 0.0]), [1.0, 1.0, 0.0]);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Numbers", into = "Numbers")]
pub struct Similarity {
    scale: f64,
    rotation: UnitQuaternion<f64>,
    translation: Vector3<f64>,
}

/// A similarity as JSON has it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Numbers {
    #[serde(default = "one")]
    scale: f64,
    rotation_wxyz: [f64; 4],
    translation_m: [f64; 3],
}

fn one() -> f64 {
    1.0
}

impl Similarity {
    /// The transform that changes nothing.
    pub fn identity() -> Self {
        RigidTransform::identity().into()
    }

    /// From a scale, a unit quaternion `w x y z` and a translation, m.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for numbers that are not finite, a scale that is not above 0
    /// and a quaternion that is not of length 1.
    pub fn new(
        scale: f64,
        rotation_wxyz: [f64; 4],
        translation_m: [f64; 3],
    ) -> Result<Self, SimulationError> {
        let refuse = |found: String, expected: &str| SimulationError::Setting {
            name: "similarity transform".to_owned(),
            found,
            expected: expected.to_owned(),
        };
        if !(scale.is_finite() && scale > 0.0) {
            return Err(refuse(format!("a scale of {scale}"), "a scale above 0"));
        }
        if !translation_m.iter().all(|v| v.is_finite()) {
            let found = format!("a translation of {translation_m:?} m");
            return Err(refuse(found, "finite numbers"));
        }
        let [w, x, y, z] = rotation_wxyz;
        let quaternion = Quaternion::new(w, x, y, z);
        let norm = quaternion.norm();
        if norm.is_nan() || (norm - 1.0).abs() > UNIT_TOLERANCE {
            let found = format!("a quaternion of length {norm}");
            return Err(refuse(found, "a quaternion w x y z of length 1"));
        }
        Ok(Self {
            scale,
            rotation: UnitQuaternion::new_unchecked(quaternion / norm),
            translation: translation_m.into(),
        })
    }

    /// From its parts, which are finite.
    pub(crate) fn from_parts(
        scale: f64,
        rotation: UnitQuaternion<f64>,
        translation: Vector3<f64>,
    ) -> Self {
        Self {
            scale,
            rotation,
            translation,
        }
    }

    /// Lengths in `b` of lengths in `a`.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Rotation of axes.
    pub fn rotation(&self) -> &UnitQuaternion<f64> {
        &self.rotation
    }

    /// Origin of `a` in `b`, m.
    pub fn translation_m(&self) -> [f64; 3] {
        self.translation.into()
    }

    /// A point in `b`.
    pub fn apply(&self, x_in_a: [f64; 3]) -> [f64; 3] {
        (self.rotation * Vector3::from(x_in_a) * self.scale + self.translation).into()
    }

    /// A direction or angular rate in `b`: rotated, not scaled.
    pub fn rotate(&self, v_in_a: [f64; 3]) -> [f64; 3] {
        (self.rotation * Vector3::from(v_in_a)).into()
    }

    /// A pose in `b`. Its position is scaled, its axes stay of length 1: what moves keeps its size.
    pub fn carry(&self, a_from_body: &RigidTransform) -> RigidTransform {
        let position = self.apply(a_from_body.translation_m());
        rigid(self.rotation * a_from_body.rotation(), position.into())
    }

    /// `a_from_b`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (scale, rotation) = (1.0 / self.scale, self.rotation.inverse());
        let translation = -(rotation * self.translation) * scale;
        Self::from_parts(scale, rotation, translation)
    }

    /// `c_from_a`, of `self` as `c_from_b` and `b_from_a`.
    #[must_use]
    pub fn compose(&self, b_from_a: &Self) -> Self {
        Self::from_parts(
            self.scale * b_from_a.scale,
            UnitQuaternion::new_normalize((self.rotation * b_from_a.rotation).into_inner()),
            self.rotation * b_from_a.translation * self.scale + self.translation,
        )
    }

    /// Without its scale.
    pub fn rigid(&self) -> RigidTransform {
        rigid(self.rotation, self.translation)
    }

    /// Whether it is a rigid transform.
    pub fn is_rigid(&self) -> bool {
        self.scale == 1.0
    }
}

/// A pose of a unit quaternion and a finite position.
pub(crate) fn rigid(rotation: UnitQuaternion<f64>, position: Vector3<f64>) -> RigidTransform {
    let q = rotation.quaternion();
    let norm = q.norm();
    let wxyz = [q.w, q.i, q.j, q.k].map(|v| v / norm);
    RigidTransform::from_wxyz(wxyz, position.into()).unwrap_or_else(|_| RigidTransform::identity())
}

impl From<RigidTransform> for Similarity {
    fn from(b_from_a: RigidTransform) -> Self {
        Self::from_parts(1.0, *b_from_a.rotation(), *b_from_a.translation())
    }
}

impl TryFrom<Numbers> for Similarity {
    type Error = SimulationError;

    fn try_from(numbers: Numbers) -> Result<Self, SimulationError> {
        Self::new(numbers.scale, numbers.rotation_wxyz, numbers.translation_m)
    }
}

impl From<Similarity> for Numbers {
    fn from(of: Similarity) -> Self {
        let q = of.rotation.quaternion();
        Self {
            scale: of.scale,
            rotation_wxyz: [q.w, q.i, q.j, q.k],
            translation_m: of.translation_m(),
        }
    }
}
