//! A camera and the region of its image that is rendered.

use super::config::DetailConfig;
use super::pixels::{BLOCK, Blocks};
use crate::config::RenderConfig;
use crate::render::view::View;

/// Border of an image within which Gaussians of any size may have pixels because of dilation, px.
pub(super) const BORDER_PX: f32 = 2.0;

/// A rectangle of an image, px.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rectangle {
    pub(super) origin: [usize; 2],
    pub(super) size: [usize; 2],
}

/// A camera and what it sees of the region.
pub(super) struct RegionCamera<'a> {
    pub(super) view: &'a View,
    pub(super) rectangle: Rectangle,
    pub(super) config: &'a RenderConfig,
    /// Twice the logarithm of the alpha below which a Gaussian has no pixels.
    pub(super) log_min_alpha: f32,
}

impl<'a> RegionCamera<'a> {
    pub(super) fn new(
        view: &'a View,
        rectangle: Rectangle,
        config: &'a RenderConfig,
        detail: &DetailConfig,
    ) -> Self {
        Self {
            view,
            rectangle,
            config,
            log_min_alpha: 2.0 * libm::logf(detail.min_alpha),
        }
    }

    /// Blocks of pixels that a sphere can reach; center in the camera, m.
    #[inline(always)]
    pub(super) fn blocks_of(&self, center: [f32; 3], radius: f32) -> Blocks {
        let [x, y, z] = center;
        let (near, far) = (z - radius, z + radius);
        let size = self.rectangle.size;
        let last = [(size[0] - 1) / BLOCK, (size[1] - 1) / BLOCK];
        let mut bounds = [0, last[0], 0, last[1]];
        if near <= self.config.near_m {
            return Blocks::new(0, last[0] as u32, 0, last[1] as u32);
        }
        for (k, at) in [x, y].into_iter().enumerate() {
            let (low, high) = (at - radius, at + radius);
            let low = low / if low > 0.0 { far } else { near };
            let high = high / if high > 0.0 { near } else { far };
            let center = self.view.principal[k] - self.rectangle.origin[k] as f32;
            let low = self.view.focal[k] * low + center - BORDER_PX;
            let high = self.view.focal[k] * high + center + BORDER_PX;
            // Negative ones become 0.
            bounds[2 * k] = (low as usize / BLOCK).min(last[k]);
            bounds[2 * k + 1] = (high as usize / BLOCK).min(last[k]);
        }
        let [left, right, top, bottom] = bounds.map(|v| v as u32);
        Blocks::new(left, right, top, bottom)
    }
}
