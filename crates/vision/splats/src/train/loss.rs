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

use rayon::prelude::*;

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
    let count = view.valid_pixels().max(1) as f64;
    let mut out = Loss::default();
    let planes = || [0, 1, 2].map(|_| vec![0.0; pixels]);
    let mut targets: [Vec<f32>; 3] = planes();
    out.gradient.rgb = planes();
    out.gradient.error = vec![0.0; pixels];
    let step = ((1.0 - f64::from(config.ssim_weight)) / (3.0 * count)) as f32;
    let bands = Band::of(&mut targets, &mut out.gradient);
    let sums = bands.map(|band| band.absolute(image, view, step, config.noise));
    out.l1 = in_order(sums) / (3.0 * count);
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
        // Windows of their neighbors gave them one.
        let bands = Band::of(&mut targets, &mut out.gradient);
        bands.for_each(|band| band.without_exceeded(image, view));
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

/// Pixels of a task. A constant, so that sums do not depend on the number of threads.
const BAND: usize = 1 << 14;

/// Pixels of the targets and of the gradient that one task writes.
struct Band<'a> {
    first: usize,
    targets: [&'a mut [f32]; 3],
    gradient: [&'a mut [f32]; 3],
    error: &'a mut [f32],
}

impl<'a> Band<'a> {
    fn of(
        targets: &'a mut [Vec<f32>; 3],
        gradient: &'a mut ImageGradient,
    ) -> impl IndexedParallelIterator<Item = Self> {
        let ([a, b, c], [d, e, f]) = (targets, &mut gradient.rgb);
        let targets = (a.par_chunks_mut(BAND), b.par_chunks_mut(BAND));
        let targets = targets.into_par_iter().zip(c.par_chunks_mut(BAND));
        let gradients = (d.par_chunks_mut(BAND), e.par_chunks_mut(BAND));
        let gradients = gradients.into_par_iter().zip(f.par_chunks_mut(BAND));
        let errors = gradient.error.par_chunks_mut(BAND).enumerate();
        let all = targets.zip(gradients).zip(errors);
        all.map(|((((a, b), c), ((d, e), f)), (band, error))| Self {
            first: band * BAND,
            targets: [a, b, c],
            gradient: [d, e, f],
            error,
        })
    }

    /// Targets, gradients of `step` times the sum of absolute differences, and errors of pixels;
    /// returns the sum.
    fn absolute(self, image: &Image, view: &TrainingView, step: f32, noise: f32) -> f64 {
        let mut sum = 0.0;
        for (c, (targets, gradient)) in self.targets.into_iter().zip(self.gradient).enumerate() {
            let rendered = &image.rgb[c][self.first..];
            for (k, x) in rendered.iter().enumerate().take(targets.len()) {
                let pixel = self.first + k;
                let recorded = view.rgb[3 * pixel + c];
                let valid = view.mask.get(pixel).copied().unwrap_or(true);
                let y = match valid && !exceeds(*x, recorded) {
                    true => color(recorded),
                    false => *x,
                };
                let r = x - y;
                targets[k] = y;
                // The sign, and 0 at 0.
                gradient[k] = if r == 0.0 { 0.0 } else { step.copysign(r) };
                sum += f64::from(r.abs());
                self.error[k] += r * r / (r * r + noise * noise).sqrt() / 3.0;
            }
        }
        sum
    }

    /// Sets the gradients of saturated values that the rendered color exceeds to 0.
    fn without_exceeded(self, image: &Image, view: &TrainingView) {
        for (c, gradient) in self.gradient.into_iter().enumerate() {
            let rendered = &image.rgb[c][self.first..];
            for (k, (x, gradient)) in rendered.iter().zip(gradient).enumerate() {
                if exceeds(*x, view.rgb[3 * (self.first + k) + c]) {
                    *gradient = 0.0;
                }
            }
        }
    }
}

/// The sum of parts that are computed in parallel, always in the same order.
fn in_order(parts: impl IndexedParallelIterator<Item = f64>) -> f64 {
    parts.collect::<Vec<f64>>().into_iter().sum()
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
    gradient.expected_depth = vec![0.0; image.alpha.len()];
    let bands = gradient.expected_depth.par_chunks_mut(BAND).enumerate();
    let sums = bands.map(|(band, slopes)| {
        let mut sum = 0.0;
        for (k, slope) in slopes.iter_mut().enumerate() {
            let (loss, by_depth) = one(band * BAND + k);
            sum += f64::from(loss);
            *slope = by_depth;
        }
        sum
    });
    in_order(sums) / count
}
