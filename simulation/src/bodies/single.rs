//! Vectors and poses of the engine, in single precision.

use cad_transforms::RigidTransform;
use rapier3d::math::{Pose, Rotation, Vector};

use crate::error::SimulationError;

pub(super) fn vector([x, y, z]: [f64; 3]) -> Vector {
    Vector::new(x as f32, y as f32, z as f32)
}

pub(super) fn vector_f64(own: Vector) -> [f64; 3] {
    [own.x, own.y, own.z].map(f64::from)
}

pub(super) fn pose(own: &RigidTransform) -> Pose {
    let [w, x, y, z] = own.rotation_wxyz().map(|v| v as f32);
    let rotation = Rotation::from_xyzw(x, y, z, w).normalize();
    Pose::from_parts(vector(own.translation_m()), rotation)
}

/// # Errors
/// [`SimulationError::State`] for a pose that is not finite.
pub(super) fn transform(own: &Pose) -> Result<RigidTransform, SimulationError> {
    let [x, y, z, w] = own.rotation.to_array().map(f64::from);
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    let rotation_wxyz = [w, x, y, z].map(|v| v / norm);
    RigidTransform::from_wxyz(rotation_wxyz, vector_f64(own.translation))
        .map_err(|error| SimulationError::State(format!("pose of a body: {error}")))
}
