//! The loss of a rendered image and its gradient.
//!
//! Photometric: `(1 - w) L1 + w (1 - SSIM)`, a mean over usable pixels and channels (Kerbl et al.
//! 2023). Pixels that may not be used take the rendered color as their target and get no gradient,
//! so that a mask has no visible border; likewise saturated values that the rendered color exceeds,
//! which bound it from below only. Depth: with `e = (1/z - 1/d) d² / σ`, which is the error
//! in sigmas, `δ² (√(1 + e²/δ²) - 1)` where accumulated alpha is above a half, as a mean over the
//! same pixels.

mod ssim;
#[cfg(test)]
mod tests;

use super::config::LossConfig;
use super::view::TrainingView;
use crate::lanes::Level;
use crate::render::{Image, ImageGradient};

/// Smallest value of 8 bits at which a sensor saturates.
const SATURATED: u8 = 254;

/// A loss with its gradient.
#[derive(Clone, Debug, Default)]
pub(super) struct Loss {
    pub(super) l1: f64,
    pub(super) ssim: f64,
    /// Mean of the robust squared errors of depth, without weight.
    pub(super) depth: f64,
    pub(super) total: f64,
    pub(super) gradient: ImageGradient,
}

/// Loss of an image. `depth_weight` is that at the present step.
pub(super) fn loss(
    image: &Image,
    view: &TrainingView,
    config: &LossConfig,
    depth_weight: f32,
    level: Level,
) -> Loss {
    let pixels = image.alpha.len();
    let valid = |pixel: usize| view.mask.get(pixel).copied().unwrap_or(true);
    let count = view.valid_pixels().max(1) as f64;
    let mut out = Loss::default();
    let mut targets: [Vec<f32>; 3] = Default::default();
    let mut error = vec![0.0; pixels];
    let step = ((1.0 - f64::from(config.ssim_weight)) / (3.0 * count)) as f32;
    let noise = config.noise * config.noise;
    let mut l1 = 0.0;
    for (c, rendered) in image.rgb.iter().enumerate() {
        let mut target = Vec::with_capacity(pixels);
        let mut gradient = Vec::with_capacity(pixels);
        for (pixel, x) in rendered.iter().enumerate() {
            let y = match valid(pixel) && !exceeds(*x, view.rgb[3 * pixel + c]) {
                true => color(view.rgb[3 * pixel + c]),
                false => *x,
            };
            let r = x - y;
            target.push(y);
            // The sign, and 0 at 0.
            gradient.push(if r == 0.0 { 0.0 } else { step.copysign(r) });
            l1 += f64::from(r.abs());
            error[pixel] += r * r / (r * r + noise).sqrt() / 3.0;
        }
        targets[c] = target;
        out.gradient.rgb[c] = gradient;
    }
    out.l1 = l1 / (3.0 * count);
    out.gradient.error = error;
    if config.ssim_weight > 0.0 {
        let size = (image.width, image.height);
        let weight = f64::from(config.ssim_weight) / (3.0 * count);
        let mask = (!view.mask.is_empty()).then_some(&view.mask[..]);
        let sum = ssim::add(
            &image.rgb,
            &targets,
            size,
            mask,
            weight as f32,
            level,
            &mut out.gradient.rgb,
        );
        out.ssim = sum / (3.0 * count);
        for (c, gradient) in out.gradient.rgb.iter_mut().enumerate() {
            for (pixel, gradient) in gradient.iter_mut().enumerate() {
                if exceeds(image.rgb[c][pixel], view.rgb[3 * pixel + c]) {
                    *gradient = 0.0;
                }
            }
        }
    }
    if depth_weight > 0.0 && !view.depth_m.is_empty() {
        out.depth = depth(image, view, config, depth_weight, count, &mut out.gradient);
    }
    let ssim_weight = f64::from(config.ssim_weight);
    out.total = (1.0 - ssim_weight) * out.l1
        + ssim_weight * (1.0 - out.ssim)
        + f64::from(depth_weight) * out.depth;
    out
}

fn color(recorded: u8) -> f32 {
    f32::from(recorded) / 255.0
}

/// Whether a rendered color is above a saturated one.
fn exceeds(rendered: f32, recorded: u8) -> bool {
    recorded >= SATURATED && rendered > color(recorded)
}

fn depth(
    image: &Image,
    view: &TrainingView,
    config: &LossConfig,
    weight: f32,
    count: f64,
    gradient: &mut ImageGradient,
) -> f64 {
    let scale = config.depth_scale;
    let weight = (f64::from(weight) / count) as f32;
    let mut sum = 0.0;
    let one = |pixel: usize| {
        let (z, d) = (image.expected_depth_m[pixel], view.depth_m[pixel]);
        let sigma = view.depth_sigma_m[pixel].max(config.min_depth_sigma_m);
        let usable = view.mask.get(pixel).copied().unwrap_or(true)
            && image.alpha[pixel] > 0.5
            && z.is_finite()
            && d > 0.0
            && d.is_finite()
            && sigma.is_finite();
        if !usable {
            return (0.0, 0.0);
        }
        let factor = d * d / sigma;
        let e = (1.0 / z - 1.0 / d) * factor;
        let root = (1.0 + e * e / (scale * scale)).sqrt();
        (
            scale * scale * (root - 1.0),
            -weight * e / root * factor / (z * z),
        )
    };
    for pixel in 0..image.alpha.len() {
        let (loss, slope) = one(pixel);
        sum += f64::from(loss);
        gradient.expected_depth.push(slope);
    }
    sum / count
}
