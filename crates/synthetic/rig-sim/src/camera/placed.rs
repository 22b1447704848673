//! What is drawn, and where it is at any time.
//!
//! Contract: bodies that are drawn together number their triangles one after the other without gaps or
//! overlaps, so that a pixel's triangle tells the body.

use nalgebra::{UnitQuaternion, Vector3};

use crate::scene::Scene;
use crate::scene::body::Body;
use crate::scene::people::Moving;

/// Where something is at any time.
pub trait Motion: Sync {
    /// Position and rotation that take its own frame to the world, at a time, s.
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

/// Of what does not move: its frame is the world's.
#[derive(Clone, Copy, Debug)]
pub struct Still;

impl Motion for Still {
    fn at(&self, _time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        (Vector3::zeros(), UnitQuaternion::identity())
    }
}

/// A body and where it is at any time.
#[derive(Clone, Copy)]
pub struct Placed<'a> {
    /// What it looks like.
    pub body: &'a Body,
    /// Number of its first triangle among all that are drawn.
    pub first: u32,
    /// Pose in the world.
    pub pose: &'a dyn Motion,
}

impl Placed<'_> {
    /// Number of the first triangle of the body that follows.
    pub fn next(&self) -> u32 {
        self.first + self.body.triangles.len() as u32
    }
}

/// All of a scene: what is fixed, then what moves. More may be put after the last one, from
/// [`Placed::next`] on.
pub fn placed(scene: &Scene) -> Vec<Placed<'_>> {
    let mut placed = vec![Placed {
        body: &scene.fixed,
        first: 0,
        pose: &Still,
    }];
    let mut first = placed[0].next();
    for moving in &scene.moving {
        let body = Placed {
            body: &moving.body,
            first,
            pose: moving,
        };
        first = body.next();
        placed.push(body);
    }
    placed
}
