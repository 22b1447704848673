//! A camera in f32, as the kernels use it.

use std::sync::Arc;

use camera_models::{Distortion, Lens};

use super::rays::Rays;
use crate::camera::Camera;
use crate::config::RenderConfig;

/// Edge of a tile, px.
pub(crate) const TILE: usize = 16;

pub(super) struct View {
    pub(super) width: usize,
    pub(super) height: usize,
    /// `camera_from_world`, rows.
    pub(super) rotation: [[f32; 3]; 3],
    /// The camera in the world, m.
    pub(super) center: [f32; 3],
    pub(super) focal: [f32; 2],
    pub(super) principal: [f32; 2],
    /// Slopes x/z and y/z beyond which a pinhole camera is linearized at the bound.
    pub(super) slope_min: [f32; 2],
    pub(super) slope_max: [f32; 2],
    /// Largest standard deviation of a Gaussian's depth over its pixels, as a share of the distance
    /// of its mean from the nearest depth.
    pub(super) slope_limit: f32,
    pub(super) rolling: Option<Rolling>,
    /// Directions of the pixels of a lens with distortion before a sky.
    pub(super) rays: Option<Arc<Rays>>,
    /// A lens with distortion.
    pub(super) lens: Option<Lens>,
    /// Pixels beyond which it is not linearized: Gaussians there are not rendered.
    pub(super) pixel_min: [f64; 2],
    pub(super) pixel_max: [f64; 2],
}

/// A rolling shutter in f32.
#[derive(Clone, Copy)]
pub(super) struct Rolling {
    pub(super) gradient: [f32; 2],
    pub(super) reference: [f32; 2],
    pub(super) velocity: [f32; 3],
    pub(super) rate: [f32; 3],
}

impl View {
    pub(super) fn new(camera: &Camera, config: &RenderConfig) -> Self {
        let model = camera.model();
        let rows = camera.camera_from_world().rotation_rows().map(|v| v as f32);
        let center = camera.camera_from_world().inverse().translation_m();
        let [w, h] = [model.width, model.height].map(f64::from);
        let margin = f64::from(config.margin);
        let slope = |center: f64, focal: f64, size: f64| {
            let beyond = margin * size + 0.5;
            let low = (-beyond - center) / focal;
            let high = (size - 1.0 + beyond - center) / focal;
            (low as f32, high as f32)
        };
        let (x, y) = (slope(model.cx, model.fx, w), slope(model.cy, model.fy, h));
        Self {
            width: model.width as usize,
            height: model.height as usize,
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| rows[3 * i + j])),
            center: center.map(|v| v as f32),
            focal: [model.fx, model.fy].map(|v| v as f32),
            principal: [model.cx, model.cy].map(|v| v as f32),
            slope_min: [x.0, y.0],
            slope_max: [x.1, y.1],
            // The ellipse of an opaque Gaussian, in standard deviations.
            slope_limit: config.max_slope_share / (-2.0 * libm::logf(config.min_alpha)).sqrt(),
            rolling: camera.shutter().map(|s| Rolling {
                gradient: s.time_gradient_s_per_px.map(|v| v as f32),
                reference: s.reference_px.map(|v| v as f32),
                velocity: s.velocity_m_s.map(|v| v as f32),
                rate: s.rate_rad_s.map(|v| v as f32),
            }),
            pixel_min: [w, h].map(|size| -margin * size - 0.5),
            pixel_max: [w, h].map(|size| size - 1.0 + margin * size + 0.5),
            rays: None,
            lens: (model.distortion != Distortion::None).then_some(*camera.lens()),
        }
    }

    /// Columns of tiles.
    pub(super) fn tile_columns(&self) -> usize {
        self.width.div_ceil(TILE)
    }

    /// Rows of tiles.
    pub(super) fn tile_rows(&self) -> usize {
        self.height.div_ceil(TILE)
    }
}
