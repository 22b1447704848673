//! The brightness of a trained scene.
//!
//! Where the gain of the cameras is not known, a training does not determine how bright the scene
//! is as a whole. Images of a camera are compared with the truth up to one factor, which is
//! estimated from all of them, and at the brightness of the scene: twice as bright, the same image
//! has twice the errors.

use splats::{Image, TrainingView, psnr_db};

/// The factor between the means of all colors of an image and of the truth.
pub(crate) fn factor(found: &Image, truth: &TrainingView) -> f64 {
    let of_truth: f64 = truth.rgb.iter().map(|v| f64::from(*v) / 255.0).sum();
    let of_found: f64 = found.rgb.iter().flatten().map(|v| f64::from(*v)).sum();
    of_truth / of_found.max(1e-9)
}

/// The image with its colors multiplied by a factor.
pub(crate) fn scaled(mut image: Image, factor: f64) -> Image {
    let colors = image.rgb.iter_mut().flatten();
    colors.for_each(|value| *value *= factor as f32);
    image
}

/// PSNR of an image at its own brightness against the truth over a factor, dB. `scaled` is the
/// image at the brightness of the truth.
pub(crate) fn psnr_at_scene_db(scaled: &Image, truth: &TrainingView, factor: f64) -> f64 {
    psnr_db(scaled, truth) + 20.0 * libm::log10(factor)
}
