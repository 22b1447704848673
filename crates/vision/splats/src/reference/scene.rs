//! The scene in f64, so that finite differences have digits to spare.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3, Vector4};

use crate::camera::Camera;
use crate::scene::{Plane, Sky, coefficients};

/// A scene in f64. Its values are not checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Degree of the spherical harmonics.
    pub degree: usize,
    /// Parameters, in the order of [`Plane`].
    pub planes: Vec<Vec<f64>>,
    /// What is behind all Gaussians.
    pub background: Background,
}

/// What is behind all Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub enum Background {
    /// One color.
    Constant([f64; 3]),
    /// A map, whose colors f32 has to represent.
    Sky(Sky),
}

impl From<&crate::Scene> for Scene {
    fn from(scene: &crate::Scene) -> Self {
        let wide = |plane: &Vec<f32>| plane.iter().map(|v| f64::from(*v)).collect();
        Self {
            degree: scene.splats.degree(),
            planes: scene.splats.planes().iter().map(wide).collect(),
            background: match &scene.background {
                crate::Background::Constant(color) => Background::Constant(color.map(f64::from)),
                crate::Background::Sky(sky) => Background::Sky(sky.clone()),
            },
        }
    }
}

impl Scene {
    pub(super) fn len(&self) -> usize {
        self.planes[0].len()
    }

    pub(super) fn position(&self, index: usize) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.planes[Plane::POSITION + i][index])
    }

    pub(super) fn scale(&self, index: usize) -> Vector3<f64> {
        Vector3::from_fn(|i, _| libm::exp(self.planes[Plane::SCALE + i][index]))
    }

    /// The rotation as stored, `w x y z`.
    pub(super) fn quaternion(&self, index: usize) -> Vector4<f64> {
        Vector4::from_fn(|i, _| self.planes[Plane::ROTATION + i][index])
    }

    pub(super) fn rotation(&self, index: usize) -> Matrix3<f64> {
        let q = self.quaternion(index);
        let q = UnitQuaternion::new_normalize(Quaternion::new(q[0], q[1], q[2], q[3]));
        q.to_rotation_matrix().into_inner()
    }

    pub(super) fn opacity(&self, index: usize) -> f64 {
        1.0 / (1.0 + libm::exp(-self.planes[Plane::OPACITY][index]))
    }

    pub(super) fn harmonics(&self, index: usize) -> Vec<Vector3<f64>> {
        let at = |k: usize, c: usize| self.planes[Plane::HARMONICS + 3 * k + c][index];
        let all = 0..coefficients(self.degree);
        all.map(|k| Vector3::from_fn(|c, _| at(k, c))).collect()
    }

    /// Color of the background at a pixel; black where the lens has no direction.
    pub(super) fn background_color(&self, camera: &Camera, pixel: [f64; 2]) -> Vector3<f64> {
        match &self.background {
            Background::Constant(color) => Vector3::from(*color),
            Background::Sky(sky) => {
                let Some(direction) = sky_direction(camera, pixel) else {
                    return Vector3::zeros();
                };
                Vector3::from(sky.color(direction)).map(f64::from)
            }
        }
    }
}

/// Direction of a pixel in the world.
pub(super) fn sky_direction(camera: &Camera, pixel: [f64; 2]) -> Option<[f32; 3]> {
    let in_camera = camera.lens().unproject(pixel)?;
    let world_from_camera = camera.camera_from_world().inverse();
    Some(world_from_camera.rotate(in_camera).map(|v| v as f32))
}
