//! Slope of a Gaussian's depth over the image, and its gradient.

use nalgebra::{Matrix2, Vector2};

use crate::config::RenderConfig;

/// Change of depth over the image.
pub(super) struct Slope {
    /// m/px
    pub(super) value: Vector2<f64>,
    /// Without the bound.
    free: Vector2<f64>,
    /// Factor of the bound; 1 where it does not hold.
    factor: f64,
    is_bounded: bool,
    /// Inverse covariance in the image with the slope's own dilation, px⁻².
    precision: Matrix2<f64>,
    /// Covariance in the image with dilation, px².
    covariance: Matrix2<f64>,
    /// Distance of the mean from the nearest depth, m.
    range: f64,
}

/// Gradients of what a slope depends on.
#[derive(Default)]
pub(super) struct SlopeGradient {
    /// With respect to all four entries of the covariance in the image.
    pub(super) covariance: Matrix2<f64>,
    /// With respect to the covariance of pixel and depth.
    pub(super) with_depth: Vector2<f64>,
    pub(super) z: f64,
}

impl Slope {
    /// From the covariance in the image without dilation, px², that of pixel and depth, m px, and
    /// the depth of the mean, m. `None` if there is no inverse.
    pub(super) fn new(
        undilated: &Matrix2<f64>,
        with_depth: &Vector2<f64>,
        z: f64,
        config: &RenderConfig,
    ) -> Option<Self> {
        let dilated = |by: f32| undilated + Matrix2::identity() * f64::from(by);
        let precision = dilated(config.slope_dilation_px2).try_inverse()?;
        let covariance = dilated(config.dilation_px2);
        let free = precision * with_depth;
        let deviation = free.dot(&(covariance * free)).max(0.0).sqrt();
        let range = z - f64::from(config.near_m);
        // The ellipse of an opaque Gaussian, in standard deviations.
        let reach = (-2.0 * libm::log(f64::from(config.min_alpha))).sqrt();
        let limit = f64::from(config.max_slope_share) * range / reach;
        let is_bounded = deviation > limit;
        let factor = if is_bounded { limit / deviation } else { 1.0 };
        Some(Self {
            value: free * factor,
            free,
            factor,
            is_bounded,
            precision,
            covariance,
            range,
        })
    }

    /// From the gradient with respect to the slope.
    pub(super) fn backward(&self, gradient: &Vector2<f64>) -> SlopeGradient {
        let mut out = SlopeGradient::default();
        let mut by_free = gradient * self.factor;
        if self.is_bounded {
            let spread = self.covariance * self.free;
            let through_bound = self.factor * gradient.dot(&self.free);
            let along = through_bound / self.free.dot(&spread);
            by_free -= spread * along;
            out.covariance -= self.free * self.free.transpose() * (0.5 * along);
            out.z = through_bound / self.range;
        }
        out.with_depth = self.precision * by_free;
        let product = out.with_depth * self.free.transpose();
        out.covariance -= (product + product.transpose()) * 0.5;
        out
    }
}
