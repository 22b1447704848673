//! Gradients as data.

use super::image::Image;
use crate::error::SplatError;

/// Gradient of a loss with respect to an image, row by row, a plane per channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImageGradient {
    /// With respect to red, green and blue after the exposure.
    pub rgb: [Vec<f32>; 3],
    /// With respect to the expected depth, 1/m; ignored where there is none. Empty: none.
    pub expected_depth: Vec<f32>,
    /// With respect to the accumulated alpha. Empty: none.
    pub alpha: Vec<f32>,
    /// Error of each pixel, from which [`Gradients::error`] is gathered. Empty: none.
    pub error: Vec<f32>,
}

/// Gradients of a loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// Indices of the visible Gaussians, ascending. All others have gradients of 0.
    pub indices: Vec<u32>,
    /// With respect to the parameters of the visible Gaussians, in the order of
    /// [`Plane`](crate::Plane).
    pub planes: Vec<Vec<f32>>,
    /// Absolute values of each pixel's gradient with respect to the mean in the image through
    /// alpha, x and y, summed, 1/px (Ye et al., AbsGS, 2024).
    pub absolute: Vec<[f32; 2]>,
    /// Errors of the pixels times the weight of the Gaussian there, summed.
    pub error: Vec<f32>,
    /// The weights, summed: pixels that the Gaussian fills.
    pub weight: Vec<f32>,
    /// With respect to a small motion of the camera in its own axes: translation, 1/m, and
    /// rotation, 1/rad; `world_from_camera · exp(motion)`. Without the part of a sky.
    pub motion: [f64; 6],
    /// With respect to the exposure's matrix.
    pub exposure: [[f64; 4]; 3],
    /// With respect to the texels of a sky, or one color.
    pub background: Vec<[f32; 3]>,
}

impl ImageGradient {
    pub(super) fn check(&self, image: &Image) -> Result<(), SplatError> {
        let expected = image.alpha.len();
        let [red, green, blue] = &self.rgb;
        let all = [
            ("gradient of red", red, false),
            ("gradient of green", green, false),
            ("gradient of blue", blue, false),
            ("gradient of the expected depth", &self.expected_depth, true),
            ("gradient of the accumulated alpha", &self.alpha, true),
            ("error", &self.error, true),
        ];
        for (what, plane, may_be_empty) in all {
            let found = plane.len();
            if found != expected && !(may_be_empty && found == 0) {
                return Err(SplatError::Size {
                    what,
                    found,
                    expected,
                });
            }
        }
        Ok(())
    }
}
