//! Held-out images beside rendered ones.

use camera_models::Eye;
use scene_bundle::outputs::splats::SplatView;
use splats::{Image, Renderer, Scene, TrainingView};

use crate::pipeline::StageError;
use crate::pipeline::stages::networks::Networks;

/// Width up to which comparisons are reduced, px.
const WIDTH: u32 = 360;

/// A held-out view as recorded and as rendered.
#[derive(Debug)]
pub(super) struct Comparison {
    /// Number of the view.
    pub(super) view: usize,
    pub(super) camera: String,
    pub(super) psnr_db: f64,
    /// Both beside each other.
    pub(super) png: Vec<u8>,
}

/// Of each camera the index of the left view with the median PSNR.
pub(super) fn medians(views: &[SplatView], psnr_db: &[f64]) -> Vec<usize> {
    let mut cameras: Vec<&str> = Vec::new();
    for view in views {
        if !cameras.contains(&view.camera.as_str()) {
            cameras.push(&view.camera);
        }
    }
    let median = |camera: &str| {
        let is_of = |k: &usize| views[*k].camera == camera && views[*k].eye == Eye::Left;
        let mut of_camera: Vec<usize> = (0..views.len()).filter(is_of).collect();
        of_camera.sort_by(|a, b| psnr_db[*a].total_cmp(&psnr_db[*b]).then(a.cmp(b)));
        of_camera.get(of_camera.len() / 2).copied()
    };
    cameras.into_iter().filter_map(median).collect()
}

/// Of the comparisons of each camera that with the median PSNR, cameras in their order.
pub(super) fn of_each_camera(mut all: Vec<Comparison>) -> Vec<Comparison> {
    let mut chosen = Vec::new();
    while let Some(first) = all.first() {
        let camera = first.camera.clone();
        let (mut of_camera, others) = all.into_iter().partition(|c| c.camera == camera);
        all = others;
        let of_camera: &mut Vec<Comparison> = &mut of_camera;
        of_camera.sort_by(|a, b| a.psnr_db.total_cmp(&b.psnr_db).then(a.view.cmp(&b.view)));
        chosen.push(of_camera.swap_remove(of_camera.len() / 2));
    }
    chosen
}

/// A view as recorded and, to the right of it, as rendered.
pub(super) fn png(
    renderer: &Renderer,
    scene: &Scene,
    view: &TrainingView,
) -> Result<Vec<u8>, StageError> {
    let factor = view.camera.model().width.div_ceil(WIDTH);
    let view = view.reduced(factor)?;
    let image = renderer.render(scene, &view.camera, &view.exposure);
    let model = view.camera.model();
    let (width, height) = (model.width as usize, model.height as usize);
    let mut rgb = Vec::with_capacity(6 * width * height);
    for row in 0..height {
        rgb.extend(&view.rgb[3 * row * width..3 * (row + 1) * width]);
        for pixel in row * width..(row + 1) * width {
            rgb.extend(color(&image, pixel));
        }
    }
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 2 * width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&rgb)?;
    writer.finish()?;
    Ok(file)
}

/// LPIPS of a view, if there is a network for it. Masked pixels are those of the recorded image in
/// both.
pub(super) fn lpips(
    networks: &Networks,
    renderer: &Renderer,
    scene: &Scene,
    view: &TrainingView,
) -> Result<Option<f64>, StageError> {
    let image = renderer.render(scene, &view.camera, &view.exposure);
    let mut rendered = view.rgb.clone();
    let (pixels, _) = rendered.as_chunks_mut::<3>();
    for (pixel, rgb) in pixels.iter_mut().enumerate() {
        if view.mask.get(pixel).copied().unwrap_or(true) {
            *rgb = color(&image, pixel);
        }
    }
    networks.lpips([image.width, image.height], &view.rgb, &rendered)
}

/// A rendered color in 8 bits.
fn color(image: &Image, pixel: usize) -> [u8; 3] {
    let value = |plane: &Vec<f32>| libm::roundf(255.0 * plane[pixel]) as u8;
    image.rgb.each_ref().map(value)
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use camera_models::{CameraModel, Distortion};
    use splats::{Background, Camera, RenderConfig, Splats};

    use super::*;
    use crate::pipeline::stages::networks::only_mean_square;

    #[test]
    fn masked_pixels_are_equal_in_both_images_of_lpips() {
        let Some(networks) = only_mean_square() else {
            return;
        };
        let model = CameraModel::new((4, 3), [3.0, 3.0, 1.5, 1.0], Distortion::None);
        let camera = Camera::new(model, RigidTransform::identity()).expect("a camera");
        let scene = Scene {
            splats: Splats::empty(0).expect("a degree"),
            background: Background::Constant([0.0; 3]),
        };
        let renderer = Renderer::new(RenderConfig::default()).expect("a renderer");
        let mut view = TrainingView::new(camera, vec![255; 3 * 12], 0);
        let lpips =
            |view: &TrainingView| lpips(&networks, &renderer, &scene, view).expect("a distance");
        // From 1 to -1.
        assert_eq!(lpips(&view), Some(4.0));
        view.mask = (0..12).map(|pixel| pixel % 4 == 0).collect();
        assert_eq!(lpips(&view), Some(1.0));
    }
}
