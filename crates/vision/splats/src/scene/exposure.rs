//! How a camera exposes: an affine map of the scene's colors to those of its images.
//!
//! The common part of all models of exposure and white balance in use (a 3x4 matrix per image:
//! Kerbl et al., A Hierarchical 3D Gaussian Representation, 2024). A gain alone is its diagonal.

/// Colors of an image from those of the scene: `image = matrix * (red, green, blue, 1)`.
///
/// ```
/// use splats::Exposure;
///
/// let twice = Exposure::from_log_gain([std::f32::consts::LN_2; 3]);
/// let [r, g, b] = twice.apply([0.1, 0.2, 0.3]);
/// assert!((r - 0.2).abs() < 1e-6 && (g - 0.4).abs() < 1e-6 && (b - 0.6).abs() < 1e-6);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Rows of the map: red, green, blue.
    pub matrix: [[f32; 4]; 3],
}

impl Exposure {
    /// The map that changes nothing.
    pub const NONE: Self = Self {
        matrix: [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ],
    };

    /// Gains per channel, as natural logarithms.
    pub fn from_log_gain(log_gain: [f32; 3]) -> Self {
        let mut exposure = Self::NONE;
        for (channel, log) in log_gain.into_iter().enumerate() {
            exposure.matrix[channel][channel] = libm::expf(log);
        }
        exposure
    }

    /// The image's color of a color of the scene.
    pub fn apply(&self, [r, g, b]: [f32; 3]) -> [f32; 3] {
        self.matrix
            .map(|[mr, mg, mb, m1]| mr * r + mg * g + mb * b + m1)
    }

    /// Gradient with respect to the scene's color, of a gradient with respect to the image's.
    pub(crate) fn transposed(&self, gradient: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|c| (0..3).map(|row| self.matrix[row][c] * gradient[row]).sum())
    }
}

impl Default for Exposure {
    fn default() -> Self {
        Self::NONE
    }
}
