//! An image as data.

/// An image, row by row, a plane per channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green and blue, after the exposure.
    pub rgb: [Vec<f32>; 3],
    /// Expected depth along the optical axis, m; NaN where accumulated alpha is too small.
    pub expected_depth_m: Vec<f32>,
    /// Median depth along the optical axis, m; NaN where accumulated alpha is below a half.
    pub median_depth_m: Vec<f32>,
    /// Accumulated alpha, 0 to 1.
    pub alpha: Vec<f32>,
}

impl Image {
    /// With zeros, to be filled.
    pub(super) fn zeros(width: usize, height: usize) -> Self {
        let plane = || vec![0.0; width * height];
        Self {
            width,
            height,
            rgb: [plane(), plane(), plane()],
            expected_depth_m: plane(),
            median_depth_m: plane(),
            alpha: plane(),
        }
    }
}
