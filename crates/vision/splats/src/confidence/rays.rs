//! Rays of some pixels of a camera.

use rayon::prelude::*;

use crate::camera::Camera;

/// The ray of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    pub(super) pixel: usize,
    /// Unit vector in the world.
    pub(super) direction: [f32; 3],
    /// Length along the ray for each metre of depth along the optical axis.
    pub(super) length_per_depth: f32,
}

/// Rays of the middles of blocks of `step` x `step` pixels, row by row; none of pixels that look
/// backward or nowhere. The motion of a rolling shutter is not in them.
pub(super) fn rays(camera: &Camera, step: usize) -> Vec<Ray> {
    let (width, height) = (
        camera.model().width as usize,
        camera.model().height as usize,
    );
    let (columns, rows) = (width.div_ceil(step), height.div_ceil(step));
    let world_from_camera = camera.camera_from_world().inverse();
    let rays = (0..columns * rows).into_par_iter().filter_map(|block| {
        let middle = |block: usize, size: usize| (block * step + step / 2).min(size - 1);
        let column = middle(block % columns, width);
        let row = middle(block / columns, height);
        let ray = camera.lens().unproject([column as f64, row as f64])?;
        let length = ray.iter().map(|v| v * v).sum::<f64>().sqrt();
        let forward = ray[2] / length;
        // Depth says nothing of rays across the optical axis.
        (forward > 0.05).then(|| Ray {
            pixel: row * width + column,
            direction: world_from_camera.rotate(ray).map(|v| (v / length) as f32),
            length_per_depth: (1.0 / forward) as f32,
        })
    });
    rays.collect()
}
