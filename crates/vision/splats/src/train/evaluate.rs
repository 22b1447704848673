//! Comparison of a scene with held-out views.

use super::config::LossConfig;
use super::loss::loss;
use super::view::TrainingView;
use crate::render::{Image, Renderer};
use crate::scene::Scene;

/// Quality of a scene in views.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Evaluation {
    /// PSNR of each view, dB; [`psnr_db`].
    pub psnr_db: Vec<f64>,
    /// Mean structural similarity of each view over usable pixels, as in the loss: a window of
    /// 11x11 pixels with a standard deviation of 1.5, zero beyond the image.
    pub ssim: Vec<f64>,
    /// Median over the pixels of all views with a depth of the relative error of the median depth,
    /// at most 1, and 1 where the image has none; NaN without depths.
    pub depth_error: f64,
    /// The same over those of these pixels at which the image has a depth: holes apart.
    pub known_depth_error: f64,
}

impl Evaluation {
    /// Mean of the views' PSNR, dB; NaN without views.
    pub fn mean_psnr_db(&self) -> f64 {
        self.psnr_db.iter().sum::<f64>() / self.psnr_db.len() as f64
    }

    /// Mean of the views' structural similarity; NaN without views.
    pub fn mean_ssim(&self) -> f64 {
        self.ssim.iter().sum::<f64>() / self.ssim.len() as f64
    }

    /// Lowest PSNR, dB; infinite without views.
    pub fn worst_psnr_db(&self) -> f64 {
        self.psnr_db.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Renders all views with their given poses and exposures.
    ///
    /// # Panics
    /// If the buffers of a view do not fit its image.
    pub fn new(renderer: &Renderer, scene: &Scene, views: &[TrainingView]) -> Self {
        let config = LossConfig::default();
        let (mut psnr, mut ssim) = (Vec::new(), Vec::new());
        let (mut known, mut holes) = (Vec::new(), 0);
        // One after the other: the renderer uses all threads, and memory holds one image.
        for view in views {
            let image = renderer.render(scene, &view.camera, &view.exposure);
            ssim.push(loss(&image, view, &config, 0.0, renderer.level()).ssim);
            psnr.push(psnr_db(&image, view));
            for error in depth_errors(&image, view) {
                match error {
                    Some(error) => known.push(error),
                    None => holes += 1,
                }
            }
        }
        let known_depth_error = median(&mut known);
        known.extend(std::iter::repeat_n(1.0, holes));
        Self {
            psnr_db: psnr,
            ssim,
            depth_error: median(&mut known),
            known_depth_error,
        }
    }
}

/// Peak signal-to-noise ratio of an image against a view, dB: `10 log₁₀(1 / MSE)` over usable
/// pixels, the image clamped to 0 to 1 and rounded to 8 bits. At most that of one wrong step of 8
/// bits in a tenth of the values.
///
/// # Panics
/// If the view has a smaller buffer of colors than the image.
pub fn psnr_db(image: &Image, view: &TrainingView) -> f64 {
    let mut sum = 0_u64;
    for (c, plane) in image.rgb.iter().enumerate() {
        for (pixel, value) in plane.iter().enumerate() {
            if view.mask.get(pixel).copied().unwrap_or(true) {
                // The cast saturates.
                let rendered = libm::roundf(value * 255.0) as u8;
                let difference = u64::from(rendered.abs_diff(view.rgb[3 * pixel + c]));
                sum += difference * difference;
            }
        }
    }
    let mean = sum as f64 / (3 * view.valid_pixels().max(1)) as f64;
    10.0 * libm::log10(255.0 * 255.0 / mean.max(0.1))
}

/// NaN of no values.
fn median(values: &mut [f32]) -> f64 {
    let middle = values.len() / 2;
    match values.is_empty() {
        true => f64::NAN,
        false => f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1),
    }
}

/// Errors of the usable pixels with a depth, at most 1; `None` for a hole of the scene.
fn depth_errors(image: &Image, view: &TrainingView) -> impl Iterator<Item = Option<f32>> {
    let usable = |pixel: usize| view.mask.get(pixel).copied().unwrap_or(true);
    let both = image.median_depth_m.iter().zip(&view.depth_m).enumerate();
    both.filter(move |(pixel, (_, d))| usable(*pixel) && **d > 0.0)
        .map(|(_, (z, d))| z.is_finite().then(|| ((z - d).abs() / d).min(1.0)))
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use camera_models::{CameraModel, Distortion};

    use super::*;
    use crate::camera::Camera;
    use crate::config::RenderConfig;
    use crate::scene::{Background, Splat, Splats};

    #[test]
    fn holes_of_the_scene_are_errors_of_depth() {
        let model = CameraModel::new((32, 32), [30.0, 30.0, 15.5, 15.5], Distortion::None);
        let camera = Camera::new(model, RigidTransform::identity()).unwrap();
        let mut view = TrainingView::new(camera, vec![0; 3 * 32 * 32], 0);
        view.depth_m = vec![2.0; 32 * 32];
        view.depth_sigma_m = vec![0.01; 32 * 32];
        let mut splats = Splats::empty(0).unwrap();
        let mut ball = Splat::sphere(0.1, [0.5; 3]);
        (ball.position_m, ball.opacity_logit) = ([0.0, 0.0, 2.0], 4.0);
        splats.push(&ball).unwrap();
        let background = Background::Constant([0.0; 3]);
        let scene = Scene { splats, background };
        let renderer = Renderer::new(RenderConfig::default()).unwrap();
        let errors = |view| {
            let found = Evaluation::new(&renderer, &scene, &[view]);
            [found.depth_error, found.known_depth_error]
        };
        // The ball covers few pixels.
        let [whole, known] = errors(view.clone());
        assert!(whole == 1.0 && known < 0.01, "{whole} {known}");
        view.mask = (0..32 * 32)
            .map(|i| (14..18).contains(&(i % 32)) && (14..18).contains(&(i / 32)))
            .collect();
        assert!(errors(view).into_iter().all(|error| error < 0.01));
    }
}
