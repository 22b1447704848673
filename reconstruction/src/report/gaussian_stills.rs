//! Images of the scene of Gaussians along the path of a camera, for readers without WebGL and for
//! print.
//!
//! Contract: pinhole images with the field of view of the view of the Gaussians, at equal steps of
//! time from the start to the end of the path.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use splats::{Camera, Exposure, RenderConfig, Renderer, Scene, SplatError};

use super::error::ReportError;
use super::fly_path::FlyPath;
use super::png_file::png;

const WIDTH: u32 = 320;
const HEIGHT: u32 = 180;
/// Focal length by half the height, as in `gaussian_viewer.js`.
const FOCAL: f64 = 1.5;
/// Number of images.
const COUNT: usize = 8;

/// An image.
pub(super) struct Still {
    /// Time since the start of the path, s.
    pub(super) time_s: f64,
    /// PNG file.
    pub(super) png: Vec<u8>,
}

/// Renders the images.
pub(super) fn along(
    scene: &Scene,
    compensated: bool,
    path: &FlyPath,
) -> Result<Vec<Still>, ReportError> {
    let mut config = RenderConfig::default();
    config.compensate = compensated;
    let renderer = Renderer::new(config)?;
    let last = path.poses.len().saturating_sub(1);
    let mut numbers: Vec<usize> = (0..COUNT).map(|k| k * last / (COUNT - 1)).collect();
    numbers.dedup();
    let stills = numbers.into_iter().map(|number| {
        let camera = camera(&path.poses[number])?;
        let image = renderer.render(scene, &camera, &Exposure::NONE);
        let mut rgba = vec![255_u8; 4 * camera.pixels()];
        for (pixel, out) in rgba.chunks_exact_mut(4).enumerate() {
            for (channel, plane) in image.rgb.iter().enumerate() {
                // The cast saturates.
                out[channel] = libm::roundf(255.0 * plane[pixel]) as u8;
            }
        }
        Ok(Still {
            time_s: number as f64 * path.step_s,
            png: png([WIDTH as usize, HEIGHT as usize], &rgba)?,
        })
    });
    stills.collect()
}

fn camera(&[x, y, z, rotation @ ..]: &[f64; 7]) -> Result<Camera, SplatError> {
    let world_from_camera = RigidTransform::from_wxyz(rotation, [x, y, z]);
    let invalid = |error: cad_transforms::TransformError| SplatError::Camera {
        reason: error.to_string(),
    };
    let focal = FOCAL * f64::from(HEIGHT) / 2.0;
    let center = [WIDTH, HEIGHT].map(|edge| (f64::from(edge) - 1.0) / 2.0);
    let model = CameraModel::new(
        (WIDTH, HEIGHT),
        [focal, focal, center[0], center[1]],
        Distortion::None,
    );
    Camera::new(model, world_from_camera.map_err(invalid)?.inverse())
}

#[cfg(test)]
mod tests {
    use splats::{Background, Splats};

    use super::*;

    #[test]
    fn images_are_spread_over_the_path() {
        let scene = Scene {
            splats: Splats::empty(0).expect("a degree"),
            background: Background::Constant([1.0, 0.5, 0.0]),
        };
        let mut path = FlyPath {
            name: "feet".to_owned(),
            step_s: 0.5,
            poses: vec![[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]; 22],
        };
        let stills = along(&scene, false, &path).expect("images");
        let times: Vec<f64> = stills.iter().map(|still| still.time_s).collect();
        assert_eq!(times, [0.0, 1.5, 3.0, 4.5, 6.0, 7.5, 9.0, 10.5]);
        let decoder = png::Decoder::new(std::io::Cursor::new(&stills[3].png));
        let mut reader = decoder.read_info().expect("a PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
        reader.next_frame(&mut pixels).expect("pixels");
        assert_eq!(pixels[..4], [255, 128, 0, 255]);
        path.poses.truncate(1);
        assert_eq!(along(&scene, false, &path).expect("images").len(), 1);
    }
}
