//! Image pyramid whose finest level has a limited width.

use imaging::{ImageView, Pyramid};

use super::config::TrackingConfig;

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct ScaledPyramid {
    pub(super) pyramid: Pyramid,
    /// Pixels of the image per pixel of the finest level.
    pub(super) scale: f64,
}

impl ScaledPyramid {
    pub(super) fn new(image: &ImageView<'_>, config: &TrackingConfig) -> Self {
        let mut halvings = 0;
        while image.width().div_ceil(1 << halvings) > config.max_width_px {
            halvings += 1;
        }
        let mut levels = config.pyramid;
        levels.max_levels += halvings;
        let mut pyramid = Pyramid::new(&levels, image);
        // The finer levels of a small image may be all that there are.
        let halvings = halvings.min(pyramid.levels.len() - 1);
        pyramid.levels.drain(..halvings);
        Self {
            pyramid,
            scale: f64::from(1_u32 << halvings),
        }
    }
}
