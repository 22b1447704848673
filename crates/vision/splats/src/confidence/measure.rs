//! From channels to a confidence of pixels and a verdict on the whole image.

use super::channels::CoverageImage;
use super::config::{ImageMeasureConfig, MeasureConfig};

/// Share of the pixels with a lower confidence than the image.
const LOW_SHARE: f64 = 0.1;

/// Number of means of an image.
pub const IMAGE_CHANNELS: usize = 10;

/// How far an image is outside of what the training saw.
#[derive(Clone, Debug, PartialEq)]
pub struct Confidence {
    /// Of each pixel, row by row: 1 where all was seen as it is seen now, towards 0 otherwise.
    pub pixels: Vec<f32>,
    /// Of the image: the 10th percentile of its pixels.
    pub image: f32,
    /// Predicted PSNR, dB.
    pub psnr_db: f32,
    /// Logarithm of the odds that the image is bad, less a margin: below 18 dB, or with a median
    /// relative error of depth above 10 %.
    pub log_odds: f32,
    /// Whether the log odds are above 0: the image must not be relied on.
    pub is_outside: bool,
}

impl CoverageImage {
    /// The confidence.
    pub fn confidence(&self, config: &MeasureConfig) -> Confidence {
        let pixels: Vec<f32> = (0..self.alpha.len())
            .map(|pixel| self.pixel(pixel, config))
            .collect();
        let unknown = config.unknown_error * config.unknown_error;
        let gain = config.error_gain * config.error_gain;
        let errors = pixels.iter().zip(&self.squared_error);
        let squared = errors.map(|(confidence, seen)| {
            f64::from((confidence * gain * seen + (1.0 - confidence) * unknown).min(1.0))
        });
        let mean = squared.sum::<f64>() / pixels.len().max(1) as f64;
        let log_odds = config.image.log_odds(&self.means());
        Confidence {
            image: quantile(pixels.clone(), LOW_SHARE).unwrap_or(0.0),
            pixels,
            psnr_db: -10.0 * libm::log10(mean.max(1e-6)) as f32,
            log_odds,
            is_outside: log_odds > 0.0,
        }
    }

    /// Means over the pixels, in the order of the weights of [`ImageMeasureConfig`]; the root of
    /// the mean for the error of color.
    pub fn means(&self) -> [f32; IMAGE_CHANNELS] {
        let count = self.alpha.len().max(1) as f64;
        let mean = |of: &[f32]| (of.iter().map(|v| f64::from(*v)).sum::<f64>() / count) as f32;
        let holes = self.median_depth_m.iter().filter(|z| !z.is_finite());
        [
            (holes.count() as f64 / count) as f32,
            1.0 - mean(&self.alpha),
            mean(&self.uncovered),
            mean(&self.angle_rad),
            mean(&self.few),
            mean(&self.magnification),
            mean(&self.space),
            mean(&self.spread),
            mean(&self.squared_error).sqrt(),
            mean(&self.depth_error),
        ]
    }

    fn pixel(&self, pixel: usize, config: &MeasureConfig) -> f32 {
        let terms = [
            (config.uncovered, &self.uncovered),
            (config.angle, &self.angle_rad),
            (config.few, &self.few),
            (config.magnification, &self.magnification),
            (config.space, &self.space),
            (config.spread, &self.spread),
        ];
        let sum: f32 = terms.iter().map(|(weight, of)| weight * of[pixel]).sum();
        libm::expf(-sum)
    }
}

impl ImageMeasureConfig {
    /// A constant and the weights of the means of an image, in the order of
    /// [`CoverageImage::means`].
    pub fn from_weights(constant: f32, weights: [f32; IMAGE_CHANNELS]) -> Self {
        let [
            holes,
            transparency,
            uncovered,
            angle,
            few,
            magnification,
            space,
            spread,
            color_error,
            depth_error,
        ] = weights;
        Self {
            constant,
            holes,
            transparency,
            uncovered,
            angle,
            few,
            magnification,
            space,
            spread,
            color_error,
            depth_error,
        }
    }

    fn log_odds(&self, means: &[f32; IMAGE_CHANNELS]) -> f32 {
        let weights = [
            self.holes,
            self.transparency,
            self.uncovered,
            self.angle,
            self.few,
            self.magnification,
            self.space,
            self.spread,
            self.color_error,
            self.depth_error,
        ];
        let terms = weights
            .iter()
            .zip(means)
            .map(|(weight, mean)| weight * mean);
        self.constant + terms.sum::<f32>()
    }
}

/// The value below which a share of the values are; `None` without values.
fn quantile(mut values: Vec<f32>, share: f64) -> Option<f32> {
    let place = ((values.len() as f64 * share) as usize).min(values.len().checked_sub(1)?);
    Some(*values.select_nth_unstable_by(place, f32::total_cmp).1)
}
