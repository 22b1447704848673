//! From channels to a confidence of pixels and a prediction for the whole image.

use super::channels::CoverageImage;
use super::config::MeasureConfig;

/// Share of the pixels with a lower confidence than the image.
const LOW_SHARE: f64 = 0.1;

/// How far an image is outside of what the training saw.
#[derive(Clone, Debug, PartialEq)]
pub struct Confidence {
    /// Of each pixel, row by row: 1 where all was seen as it is seen now, towards 0 otherwise.
    pub pixels: Vec<f32>,
    /// Of the image: the 10th percentile of its pixels.
    pub image: f32,
    /// Predicted PSNR, dB.
    pub psnr_db: f32,
    /// Predicted median relative error of depth, of the pixels with a median depth; 1 if less than
    /// half of the pixels have one and their other half is no seen sky.
    pub depth_error: f32,
    /// Whether a prediction is beyond its limit: the image must not be relied on.
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
        let psnr_db = -10.0 * libm::log10(mean.max(1e-6)) as f32;
        let depth_errors = (0..pixels.len()).filter_map(|pixel| {
            let unknown = (1.0 - pixels[pixel]) * config.unknown_depth_error;
            match self.median_depth_m[pixel].is_finite() {
                true => Some((self.depth_error[pixel] + unknown).min(1.0)),
                // No surface, and no seen sky either.
                false => (self.uncovered[pixel] > 0.5).then_some(1.0),
            }
        });
        let depth_error = quantile(depth_errors.collect(), 0.5).unwrap_or(0.0);
        Confidence {
            image: quantile(pixels.clone(), LOW_SHARE).unwrap_or(0.0),
            pixels,
            psnr_db,
            depth_error,
            is_outside: psnr_db < config.min_psnr_db || depth_error > config.max_depth_error,
        }
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

/// The value below which a share of the values are; `None` without values.
fn quantile(mut values: Vec<f32>, share: f64) -> Option<f32> {
    let place = ((values.len() as f64 * share) as usize).min(values.len().checked_sub(1)?);
    Some(*values.select_nth_unstable_by(place, f32::total_cmp).1)
}
