//! Alignment of an estimate with the ground truth.

use cad_transforms::RigidTransform;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::Serialize;

use super::associate::Pair;

/// Alignment of an estimate with the ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// None: both are in the same world.
    None,
    /// By the rigid transform with the least sum of squared distances.
    Se3,
    /// By rotation, translation and scale with the least sum: for estimates of unknown scale.
    Sim3,
    /// By the first pair of poses, which become equal. All later error is drift.
    First,
}

impl Alignment {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::None, Self::Se3, Self::Sim3, Self::First];

    /// Its name on command lines.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Se3 => "se3",
            Self::Sim3 => "sim3",
            Self::First => "first",
        }
    }
}

/// A similarity transform: `x_in_truth = scale * rotation * x_in_estimate + translation`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Similarity {
    /// Rotation and translation, m.
    pub rigid: RigidTransform,
    /// Scale from estimate to ground truth; 1 unless the scale is estimated.
    pub scale: f64,
    /// Whether the poses determine the rotation: not if they are on one line or at one position.
    #[serde(rename = "turn_is_known")]
    pub rotation_is_known: bool,
}

impl Similarity {
    /// An estimated pose in the world of the ground truth.
    pub fn apply(&self, world_from_rig: &RigidTransform) -> RigidTransform {
        let place = self.scale * (self.rigid.rotation() * world_from_rig.translation())
            + self.rigid.translation();
        transform(self.rigid.rotation() * world_from_rig.rotation(), place)
    }
}

/// `None` without pairs, and for a fit of fewer than three.
pub(crate) fn align(pairs: &[Pair], alignment: Alignment) -> Option<Similarity> {
    let rigid = |rigid: RigidTransform| Similarity {
        rigid,
        scale: 1.0,
        rotation_is_known: true,
    };
    let first = pairs.first()?;
    match alignment {
        Alignment::None => Some(rigid(RigidTransform::identity())),
        Alignment::First => Some(rigid(first.truth * first.estimated.inverse())),
        Alignment::Se3 => umeyama(pairs, false),
        Alignment::Sim3 => umeyama(pairs, true),
    }
}

/// Least squares over the positions (Umeyama, Least-squares estimation of transformation parameters
/// between two point patterns, PAMI 1991; equation numbers are his).
fn umeyama(pairs: &[Pair], with_scale: bool) -> Option<Similarity> {
    if pairs.len() < 3 {
        return None;
    }
    let share = 1.0 / pairs.len() as f64;
    let mean =
        |of: &dyn Fn(&Pair) -> Vector3<f64>| pairs.iter().map(of).sum::<Vector3<f64>>() * share;
    let x = |pair: &Pair| *pair.estimated.translation();
    let y = |pair: &Pair| *pair.truth.translation();
    let (mean_x, mean_y) = (mean(&x), mean(&y));
    let mut covariance = Matrix3::zeros(); // (38)
    let mut variance_x = 0.0; // (36)
    for pair in pairs {
        let (dx, dy) = (x(pair) - mean_x, y(pair) - mean_y);
        covariance += dy * dx.transpose() * share;
        variance_x += dx.norm_squared() * share;
    }
    let svd = covariance.svd(true, true);
    let (u, v_t, d) = (svd.u?, svd.v_t?, svd.singular_values);
    // Two directions determine the third.
    let rotation_is_known = d[1] > 1e-12 * d[0] && d[0] > 0.0;
    let mut sign = Vector3::new(1.0, 1.0, 1.0); // (43)
    if u.determinant() * v_t.determinant() < 0.0 {
        sign.z = -1.0;
    }
    let rotation = u * Matrix3::from_diagonal(&sign) * v_t; // (40)
    let scale = match with_scale {
        true if variance_x > 0.0 => d.dot(&sign) / variance_x, // (42)
        _ => 1.0,
    };
    let turn = Rotation3::from_matrix_unchecked(rotation);
    let translation = mean_y - scale * (turn * mean_x); // (41)
    Some(Similarity {
        rigid: transform(UnitQuaternion::from_rotation_matrix(&turn), translation),
        scale,
        rotation_is_known,
    })
}

pub(super) fn transform(rotation: UnitQuaternion<f64>, place: Vector3<f64>) -> RigidTransform {
    let q = UnitQuaternion::new_normalize(rotation.into_inner());
    RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], place.into())
        .expect("finite poses make a finite transform")
}
