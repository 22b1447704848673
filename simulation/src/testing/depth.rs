//! Errors of depth images against exact rays.

use camera_models::{CameraModel, Lens};

use super::Surfaces;
use crate::camera::{FrameRequest, Frames};

/// Depth of the first frame of a batch against the truth.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthErrors {
    /// Absolute errors along the optical axis, m, of pixels whose surface is near enough.
    pub errors_m: Vec<f64>,
    /// Such pixels without a depth.
    pub missing: usize,
    /// Least true depth of all pixels, m; infinite without a surface.
    pub nearest_m: f64,
}

impl DepthErrors {
    /// Of a frame that was rendered with a lens, for surfaces nearer than a depth, m.
    pub fn new(
        frames: &Frames,
        request: &FrameRequest,
        model: &CameraModel,
        truth: &Surfaces,
        to_m: f64,
    ) -> Self {
        let lens = Lens::new(model);
        let pose = request.world_from_camera;
        let mut found = Self {
            nearest_m: f64::INFINITY,
            ..Self::default()
        };
        for row in 0..frames.height {
            for column in 0..frames.width {
                // What is beside or behind the camera has no depth.
                let ray = lens.unproject([column as f64, row as f64]);
                let Some(ray) = ray.filter(|ray| ray[2] > 0.0) else {
                    continue;
                };
                // Of depth 1, so that the multiple is the depth.
                let ray = ray.map(|v| v / ray[2]);
                let Some(depth_m) = truth.ray_m(pose.translation_m(), pose.rotate(ray)) else {
                    continue;
                };
                found.nearest_m = found.nearest_m.min(depth_m);
                let pixel = frames.width * row + column;
                match (depth_m <= to_m, frames.has_depth[pixel]) {
                    (false, _) => {}
                    (true, false) => found.missing += 1,
                    (true, true) => {
                        let error_m = f64::from(frames.depth_m[pixel]) - depth_m;
                        found.errors_m.push(error_m.abs());
                    }
                }
            }
        }
        found
    }
}
