//! Gradients of a loss with respect to a scene, the camera's pose and the exposure.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::footprint::{self, FootprintGradient};
use super::forward::{Ray, blend, pixels};
use super::scene::{Background, Scene, sky_direction};
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::scene::Exposure;

/// Gradient of a loss with respect to an image, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImageGradient {
    /// With respect to red, green and blue after the exposure.
    pub rgb: Vec<[f64; 3]>,
    /// With respect to the expected depth, 1/m. Ignored where there is none.
    pub expected_depth: Vec<f64>,
    /// With respect to the accumulated alpha.
    pub alpha: Vec<f64>,
}

/// Gradients of a loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// With respect to the Gaussians' parameters, in the order of [`Plane`](crate::Plane).
    pub planes: Vec<Vec<f64>>,
    /// With respect to a small motion of the camera in its own axes: translation, 1/m, and
    /// rotation, 1/rad; `world_from_camera · exp(motion)`. Without the part of a sky.
    pub motion: [f64; 6],
    /// With respect to the exposure's matrix.
    pub exposure: [[f64; 4]; 3],
    /// With respect to the texels of a sky, or one color.
    pub background: Vec<[f64; 3]>,
}

/// Gradients of a loss whose gradient with respect to the image is given.
///
/// # Panics
/// If a buffer of the image's gradient has not one value per pixel.
pub fn backward(
    scene: &Scene,
    camera: &Camera,
    exposure: &Exposure,
    config: &RenderConfig,
    image: &ImageGradient,
) -> Gradients {
    let footprints = footprint::all(scene, camera, config);
    let mut position = vec![usize::MAX; scene.len()];
    for (k, footprint) in footprints.iter().enumerate() {
        position[footprint.index] = k;
    }
    let zero = || FootprintGradient {
        mean: Vector2::zeros(),
        conic: Matrix2::zeros(),
        opacity: 0.0,
        color: Vector3::zeros(),
        z: 0.0,
        slope: Vector2::zeros(),
    };
    let mut of_footprints: Vec<_> = footprints.iter().map(|_| zero()).collect();
    let mut gradients = Gradients {
        planes: vec![vec![0.0; scene.len()]; scene.planes.len()],
        motion: [0.0; 6],
        exposure: [[0.0; 4]; 3],
        background: vec![[0.0; 3]; background_len(scene)],
    };
    for (pixel, (u, background)) in pixels(scene, camera).enumerate() {
        let ray = blend(&footprints, u, config);
        let color = ray.color + background * ray.transmittance;
        let outer = Vector3::from(image.rgb[pixel]);
        let mut g = Vector3::zeros();
        for row in 0..3 {
            let matrix = exposure.matrix[row].map(f64::from);
            for c in 0..3 {
                g[c] += matrix[c] * outer[row];
                gradients.exposure[row][c] += outer[row] * color[c];
            }
            gradients.exposure[row][3] += outer[row];
        }
        let (mut g_depth, mut g_alpha) = (0.0, image.alpha[pixel]);
        let alpha = 1.0 - ray.transmittance;
        if alpha >= f64::from(config.min_depth_alpha) {
            g_depth = image.expected_depth[pixel] / alpha;
            g_alpha -= g_depth * ray.depth / alpha;
        }
        let g_transmittance = g.dot(&background) - g_alpha;
        let outer = (g, g_depth, g_transmittance);
        ray_backward(&ray, config, outer, &position, &mut of_footprints);
        background_backward(scene, camera, u, g * ray.transmittance, &mut gradients);
    }
    for (footprint, gradient) in footprints.iter().zip(&of_footprints) {
        let planes = &mut gradients.planes;
        let (v, w) = footprint.backward(scene, camera, config, gradient, planes);
        for k in 0..3 {
            gradients.motion[k] += v[k];
            gradients.motion[3 + k] += w[k];
        }
    }
    gradients
}

/// Adds a pixel's gradients to those of the footprints that it sees.
fn ray_backward(
    ray: &Ray<'_>,
    config: &RenderConfig,
    (g, g_depth, g_transmittance): (Vector3<f64>, f64, f64),
    position: &[usize],
    of_footprints: &mut [FootprintGradient],
) {
    // What lies behind the present Gaussian: its color and depth times their gradients.
    let mut behind = 0.0;
    for c in ray.contributions.iter().rev() {
        let own = g.dot(&c.of.color) + g_depth * c.z;
        let weight = c.transmittance * c.alpha;
        let out = &mut of_footprints[position[c.of.index]];
        out.color += g * weight;
        out.z += g_depth * weight;
        out.slope += c.d * (g_depth * weight);
        out.mean -= c.of.slope.value * (g_depth * weight);
        let by_alpha = c.transmittance * own
            - (behind + ray.transmittance * g_transmittance) / (1.0 - c.alpha);
        behind += weight * own;
        if c.of.opacity * c.falloff > f64::from(config.max_alpha) {
            continue;
        }
        out.opacity += c.falloff * by_alpha;
        let by_sigma = -c.alpha * by_alpha;
        out.mean -= c.of.conic * c.d * by_sigma;
        out.conic += c.d * c.d.transpose() * (0.5 * by_sigma);
    }
}

fn background_len(scene: &Scene) -> usize {
    match &scene.background {
        Background::Constant(_) => 1,
        Background::Sky(sky) => sky.texels().len(),
    }
}

fn background_backward(
    scene: &Scene,
    camera: &Camera,
    u: Vector2<f64>,
    gradient: Vector3<f64>,
    gradients: &mut Gradients,
) {
    let mut add = |index: usize, weight: f64| {
        for c in 0..3 {
            gradients.background[index][c] += weight * gradient[c];
        }
    };
    match &scene.background {
        Background::Constant(_) => add(0, 1.0),
        Background::Sky(sky) => {
            let Some(direction) = sky_direction(camera, u.into()) else {
                return;
            };
            for (index, weight) in sky.taps(direction) {
                add(index, f64::from(weight));
            }
        }
    }
}
