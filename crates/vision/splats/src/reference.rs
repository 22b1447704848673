//! The reference implementation: f64, one pixel and one Gaussian after the other, no tiles.
//!
//! It defines what an image is; the fast renderer is compared with it, and it with finite
//! differences. Sources: projection, blending and their gradients of Kerbl et al., 3D Gaussian
//! Splatting, 2023, after Zwicker et al., EWA Splatting, 2002; gradients as in Ye and Kanazawa,
//! Mathematical Supplement for the gsplat Library, 2023.
//!
//! For each pixel `u`, over Gaussians in the order of their depth z: `σ = ½ dᵀ Q d` with `d = u - m`,
//! `α = min(max_alpha, o exp(-σ))`, skipped below `min_alpha`; color, depth and transmittance are
//! `C += T α c`, `D += T α z`, `T ← T (1 - α)`; a Gaussian that would take T to `min_transmittance`
//! or below ends the pixel and is left out. Accumulated alpha is `1 - T`, the expected depth
//! `D / (1 - T)`, the median depth the z of the Gaussian that takes T to a half or below.
//!
//! ```
//! use cad_transforms::RigidTransform;
//! use camera_models::{CameraModel, Distortion};
//! use splats::{Background, Camera, Exposure, RenderConfig, Scene, Splat, Splats, reference};
//!
//! let mut splats = Splats::empty(0)?;
//! let ball = Splat { opacity_logit: 9.0, position_m: [0.0, 0.0, 2.0], ..Splat::sphere(0.1, [1.0, 0.0, 0.0]) };
//! splats.push(&ball)?;
//! let scene = Scene { splats, background: Background::Constant([0.0, 0.0, 1.0]) };
//! let model = CameraModel::new((9, 9), [20.0, 20.0, 4.0, 4.0], Distortion::None);
//! let camera = Camera::new(model, RigidTransform::identity())?;
//!
//! let scene = reference::Scene::from(&scene);
//! let image = reference::render(&scene, &camera, &Exposure::NONE, &RenderConfig::default());
//! let middle = 4 * 9 + 4;
//! assert!(image.rgb[middle][0] > 0.98 && image.rgb[0][2] > 0.98);
//! assert_eq!(image.median_depth_m[middle], 2.0);
//! assert!(image.median_depth_m[0].is_nan());
//! # Ok::<(), splats::SplatError>(())
//! ```

mod backward;
mod footprint;
mod harmonics;
mod scene;
#[cfg(test)]
pub(crate) mod tests;

use nalgebra::{Vector2, Vector3};

use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::scene::Exposure;
pub use backward::{Gradients, ImageGradient, backward};
use footprint::Footprint;
pub use scene::{Background, Scene};

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
struct Contribution<'a> {
    of: &'a Footprint,
    /// Pixel minus mean.
    d: Vector2<f64>,
    /// `exp(-σ)`.
    falloff: f64,
    alpha: f64,
    /// Transmittance before.
    transmittance: f64,
}

/// All that reaches a pixel, in order.
struct Ray<'a> {
    contributions: Vec<Contribution<'a>>,
    /// Transmittance behind all.
    transmittance: f64,
    /// Color without background.
    color: Vector3<f64>,
    /// `Σ w z`.
    depth: f64,
    median_depth: f64,
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

/// The first harmonics in a unit direction.
pub(crate) fn harmonics(direction: Vector3<f64>, count: usize) -> Vec<f64> {
    let values = harmonics::values(direction, count);
    values.into_iter().map(|(value, _)| value).collect()
}

/// Every pixel, row by row, with the background's color.
fn pixels<'a>(
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

fn expose(exposure: &Exposure, color: Vector3<f64>) -> [f64; 3] {
    exposure.matrix.map(|row| {
        let [r, g, b, offset] = row.map(f64::from);
        r * color.x + g * color.y + b * color.z + offset
    })
}

/// Blends all Gaussians at a pixel, front to back.
fn blend<'a>(footprints: &'a [Footprint], u: Vector2<f64>, config: &RenderConfig) -> Ray<'a> {
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
        ray.depth += of.z * weight;
        if transmittance > 0.5 && next <= 0.5 {
            ray.median_depth = of.z;
        }
        ray.transmittance = next;
        ray.contributions.push(Contribution {
            of,
            d,
            falloff,
            alpha,
            transmittance,
        });
    }
    ray
}
