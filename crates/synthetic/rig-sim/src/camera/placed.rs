//! Bodies to draw, with their motion.
//!
//! Contract: bodies that are drawn together number their triangles consecutively without gaps or
//! overlaps, so the triangle of a pixel identifies the body.

use nalgebra::{UnitQuaternion, Vector3};

use crate::scene::Scene;
use crate::scene::body::Body;
use crate::scene::people::Moving;

/// Pose as a function of time.
pub trait Motion: Sync {
    /// Position and rotation that map its own frame to the world, at a time, s.
    fn at(&self, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>);
}

impl<F: Fn(f64) -> (Vector3<f64>, UnitQuaternion<f64>) + Sync> Motion for F {
    fn at(&self, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        self(time_s)
    }
}

impl Motion for Moving {
    fn at(&self, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        self.pose(time_s)
    }
}

/// Pose of static bodies: their frame is the world.
#[derive(Clone, Copy, Debug)]
pub struct Still;

impl Motion for Still {
    fn at(&self, _time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        (Vector3::zeros(), UnitQuaternion::identity())
    }
}

/// A body with its motion.
#[derive(Clone, Copy)]
pub struct SceneBody<'a> {
    /// Geometry and surfaces.
    pub body: &'a Body,
    /// Number of its first triangle among all drawn triangles.
    pub first: u32,
    /// Pose in the world.
    pub pose: &'a dyn Motion,
}

impl SceneBody<'_> {
    /// Number of the first triangle of the next body.
    pub fn next(&self) -> u32 {
        self.first + self.body.triangles.len() as u32
    }
}

/// All bodies of a scene: the static one, the fence if there is one, then the moving ones. More may
/// be appended, from [`SceneBody::next`] on.
pub fn placed(scene: &Scene) -> Vec<SceneBody<'_>> {
    let mut placed = vec![SceneBody {
        body: &scene.fixed,
        first: 0,
        pose: &Still,
    }];
    let mut first = placed[0].next();
    if !scene.fence.triangles.is_empty() {
        let body = SceneBody {
            body: &scene.fence,
            first,
            pose: &Still,
        };
        first = body.next();
        placed.push(body);
    }
    for moving in &scene.moving {
        let body = SceneBody {
            body: &moving.body,
            first,
            pose: moving,
        };
        first = body.next();
        placed.push(body);
    }
    placed
}
