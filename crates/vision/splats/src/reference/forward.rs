//! Rendering, pixel by pixel.

use nalgebra::{Vector2, Vector3};

use super::footprint::{self, Footprint};
use super::scene::Scene;
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::scene::Exposure;

/// An image, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green and blue, after the exposure.
    pub rgb: Vec<[f64; 3]>,
    /// Expected depth along the optical axis, m; NaN where accumulated alpha is too small.
    pub expected_depth_m: Vec<f64>,
    /// Median depth along the optical axis, m; NaN where accumulated alpha is below a half.
    pub median_depth_m: Vec<f64>,
    /// Accumulated alpha, 0 to 1.
    pub alpha: Vec<f64>,
}

/// One Gaussian's contribution to a pixel.
pub(super) struct Contribution<'a> {
    pub(super) of: &'a Footprint,
    /// Pixel minus mean.
    pub(super) d: Vector2<f64>,
    /// Depth at the pixel.
    pub(super) z: f64,
    /// `exp(-σ)`.
    pub(super) falloff: f64,
    pub(super) alpha: f64,
    /// Transmittance before.
    pub(super) transmittance: f64,
}

/// All that reaches a pixel, in order.
pub(super) struct Ray<'a> {
    pub(super) contributions: Vec<Contribution<'a>>,
    /// Transmittance behind all.
    pub(super) transmittance: f64,
    /// Color without background.
    pub(super) color: Vector3<f64>,
    /// Sum of weights times depths.
    pub(super) depth: f64,
    pub(super) median_depth: f64,
}

/// Renders a scene.
pub fn render(scene: &Scene, camera: &Camera, exposure: &Exposure, config: &RenderConfig) -> Image {
    let footprints = footprint::all(scene, camera, config);
    let (width, height) = (
        camera.model().width as usize,
        camera.model().height as usize,
    );
    let mut image = Image {
        width,
        height,
        ..Image::default()
    };
    for (u, background) in pixels(scene, camera) {
        let ray = blend(&footprints, u, config);
        let color = ray.color + background * ray.transmittance;
        let alpha = 1.0 - ray.transmittance;
        let has_depth = alpha >= f64::from(config.min_depth_alpha);
        image.rgb.push(expose(exposure, color));
        image.expected_depth_m.push(match has_depth {
            true => ray.depth / alpha,
            false => f64::NAN,
        });
        image.median_depth_m.push(ray.median_depth);
        image.alpha.push(alpha);
    }
    image
}

/// Every pixel, row by row, with the background's color.
pub(super) fn pixels<'a>(
    scene: &'a Scene,
    camera: &'a Camera,
) -> impl Iterator<Item = (Vector2<f64>, Vector3<f64>)> + 'a {
    let (width, height) = (camera.model().width, camera.model().height);
    (0..height).flat_map(move |row| {
        (0..width).map(move |column| {
            let u = [f64::from(column), f64::from(row)];
            (u.into(), scene.background_color(camera, u))
        })
    })
}

pub(super) fn expose(exposure: &Exposure, color: Vector3<f64>) -> [f64; 3] {
    exposure.matrix.map(|row| {
        let [r, g, b, offset] = row.map(f64::from);
        r * color.x + g * color.y + b * color.z + offset
    })
}

/// Blends all Gaussians at a pixel, front to back.
pub(super) fn blend<'a>(
    footprints: &'a [Footprint],
    u: Vector2<f64>,
    config: &RenderConfig,
) -> Ray<'a> {
    let mut ray = Ray {
        contributions: Vec::new(),
        transmittance: 1.0,
        color: Vector3::zeros(),
        depth: 0.0,
        median_depth: f64::NAN,
    };
    for of in footprints {
        let d = u - of.mean;
        let falloff = libm::exp(-0.5 * d.dot(&(of.conic * d)));
        let alpha = (of.opacity * falloff).min(f64::from(config.max_alpha));
        if alpha < f64::from(config.min_alpha) {
            continue;
        }
        let transmittance = ray.transmittance;
        let next = transmittance * (1.0 - alpha);
        if next <= f64::from(config.min_transmittance) {
            break;
        }
        let weight = transmittance * alpha;
        ray.color += of.color * weight;
        let z = of.z + of.slope.value.dot(&d);
        ray.depth += z * weight;
        if transmittance > 0.5 && next <= 0.5 {
            ray.median_depth = z;
        }
        ray.transmittance = next;
        ray.contributions.push(Contribution {
            of,
            d,
            z,
            falloff,
            alpha,
            transmittance,
        });
    }
    ray
}
