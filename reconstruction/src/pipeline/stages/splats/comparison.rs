//! Held-out images beside rendered ones.

use camera_models::Eye;
use scene_bundle::outputs::splats::SplatView;
use splats::{Renderer, Scene, TrainingView};

use crate::pipeline::StageError;

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
            let value = |plane: &Vec<f32>| libm::roundf(255.0 * plane[pixel]) as u8;
            rgb.extend(image.rgb.each_ref().map(value));
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
