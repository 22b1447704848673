//! Level of detail: fewer, larger Gaussians where the originals would be smaller than pixels.
//!
//! Neighbors along a Morton curve form clusters. Each cluster has levels, in each of which about
//! four Gaussians of the level below are [merged](merge). A camera takes of each cluster that it
//! can see the coarsest level whose Gaussians stay small in the image. The price is stated by
//! comparison with [`Renderer::render`].

mod merge;
#[cfg(test)]
mod tests;

use std::ops::Range;

use estimator_config::config;
use rayon::prelude::*;

use super::forward::Renderer;
use super::image::Image;
use super::view::View;
use crate::camera::Camera;
use crate::error::SplatError;
use crate::scene::{Exposure, Plane, Scene, Splats, morton_order};

/// Ranges of Gaussians of a task of projection.
const RANGES_PER_TASK: usize = 64;

/// Standard deviations from a mean beyond which a Gaussian has no pixels: `√(2 ln 255)`.
const REACH_SIGMAS: f32 = 3.33;

/// Border of an image within which Gaussians of any size may have pixels because of dilation, px.
const BORDER_PX: f32 = 2.0;

config! {
    /// Configuration of [`DetailScene`].
    pub struct DetailConfig {
        /// Gaussians of a cluster. More are culled and coarsened together.
        pub cluster: usize = 128,
        /// Gaussians that one of the next level replaces.
        pub merge: usize = 4,
        /// Number of levels above the originals.
        pub levels: usize = 4,
        /// Largest scale in the image that Gaussians of a coarser level may have, px: the mean over
        /// the cluster of the largest axis. More is faster and less sharp: on a wall of fine
        /// texture 0.6 halves the Gaussians at 39 dB, 0.8 leaves a quarter at 31 dB.
        pub max_sigma_px: f32 = 0.6,
        /// Gaussians are merged only up to this factor on their largest scale.
        pub max_growth: f32 = 6.0,
    }
}

/// A scene with levels of detail.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use camera_models::{CameraModel, Distortion};
/// use splats::{
///     Background, Camera, DetailConfig, DetailScene, Exposure, RenderConfig, Renderer, Scene,
///     Splat, Splats,
/// };
///
/// // A dense wall 20 m in front of a small camera.
/// let mut splats = Splats::empty(0)?;
/// for i in 0..10_000_u16 {
///     let [x, y] = [i % 100, i / 100].map(|v| f32::from(v) * 0.1 - 5.0);
///     splats.push(&Splat { position_m: [x, y, 20.0], ..Splat::sphere(0.06, [0.8, 0.4, 0.1]) })?;
/// }
/// let scene = Scene { splats, background: Background::Constant([0.0; 3]) };
/// let detail = DetailScene::new(&scene, &DetailConfig::default())?;
///
/// let model = CameraModel::new((64, 64), [50.0, 50.0, 31.5, 31.5], Distortion::None);
/// let camera = Camera::new(model, RigidTransform::identity())?;
/// assert!(detail.count(&camera) < 5000);
/// let renderer = Renderer::new(RenderConfig::default())?;
/// let image = renderer.render_detail(&detail, &camera, &Exposure::NONE);
/// let exact = renderer.render(&scene, &camera, &Exposure::NONE);
/// let middle = 32 * 64 + 32;
/// assert!((image.rgb[0][middle] - exact.rgb[0][middle]).abs() < 0.05);
/// # Ok::<(), splats::SplatError>(())
/// ```
#[derive(Clone, Debug)]
pub struct DetailScene {
    /// Gaussians of all levels, cluster by cluster.
    scene: Scene,
    clusters: Vec<Cluster>,
    config: DetailConfig,
}

#[derive(Clone, Debug)]
struct Cluster {
    /// Sphere around all that has pixels, in the world, m.
    center: [f32; 3],
    radius: f32,
    /// Largest distance of a mean from the center, m.
    spread: f32,
    /// From the originals to the coarsest.
    levels: Vec<LevelRange>,
}

#[derive(Clone, Debug)]
struct LevelRange {
    range: Range<usize>,
    /// Mean of the largest standard deviations, m.
    sigma_m: f32,
}

impl DetailScene {
    /// # Errors
    /// [`SplatError::Setting`] if a setting is outside of its domain.
    pub fn new(scene: &Scene, config: &DetailConfig) -> Result<Self, SplatError> {
        let setting =
            |name, found: usize, range: Range<usize>, expected| match range.contains(&found) {
                true => Ok(()),
                false => Err(SplatError::Setting {
                    name,
                    found: found as f64,
                    expected,
                }),
            };
        setting("cluster", config.cluster, 8..1 << 16, "8 to 65535")?;
        setting("merge", config.merge, 2..65, "2 to 64")?;
        setting("levels", config.levels, 0..17, "0 to 16")?;
        let order = morton_order(&scene.splats);
        let built: Vec<Vec<Splats>> = order
            .par_chunks(config.cluster)
            .map(|indices| levels(scene.splats.select(indices), config))
            .collect();
        let mut planes = vec![Vec::new(); Plane::count(scene.splats.degree())];
        let mut clusters = Vec::with_capacity(built.len());
        for levels in built {
            let mut ranges = Vec::with_capacity(levels.len());
            for splats in &levels {
                let start = planes[0].len();
                for (all, plane) in planes.iter_mut().zip(splats.planes()) {
                    all.extend(plane);
                }
                ranges.push(LevelRange {
                    range: start..planes[0].len(),
                    sigma_m: mean_sigma_m(splats),
                });
            }
            clusters.push(Cluster::new(&levels, ranges));
        }
        let splats = Splats::from_planes(scene.splats.degree(), planes)?;
        let background = scene.background.clone();
        Ok(Self {
            scene: Scene { splats, background },
            clusters,
            config: *config,
        })
    }

    /// Number of Gaussians that an image of a camera takes.
    pub fn count(&self, camera: &Camera) -> usize {
        let view = View::new(camera, &Default::default());
        self.ranges(&view, 0.0)
            .into_iter()
            .map(|range| range.len())
            .sum()
    }

    fn ranges(&self, view: &View, near_m: f32) -> Vec<Range<usize>> {
        let visible = self.clusters.iter();
        visible
            .filter_map(|cluster| {
                let z = cluster.depth(view, near_m)?;
                let px_per_m = view.focal[0].max(view.focal[1]) / z;
                let fits =
                    |level: &&LevelRange| level.sigma_m * px_per_m <= self.config.max_sigma_px;
                let coarsest = cluster.levels[1..].iter().rev().find(fits);
                Some(coarsest.unwrap_or(&cluster.levels[0]).range.clone())
            })
            .collect()
    }
}

impl Renderer {
    /// Renders a scene with levels of detail.
    pub fn render_detail(
        &self,
        scene: &DetailScene,
        camera: &Camera,
        exposure: &Exposure,
    ) -> Image {
        let view = View::new(camera, &self.config);
        let ranges = scene.ranges(&view, self.config.near_m);
        let pass = self.forward_ranges(&scene.scene, &ranges, RANGES_PER_TASK, camera, exposure);
        pass.image
    }

    /// Renders many images of a scene with levels of detail, in parallel.
    pub fn render_detail_batch(
        &self,
        scene: &DetailScene,
        cameras: &[Camera],
        exposure: &Exposure,
    ) -> Vec<Image> {
        let images = cameras.par_iter();
        images
            .map(|camera| self.render_detail(scene, camera, exposure))
            .collect()
    }
}

/// A cluster's Gaussians, level by level.
fn levels(splats: Splats, config: &DetailConfig) -> Vec<Splats> {
    let mut levels = vec![splats];
    while levels.len() <= config.levels {
        let last = &levels[levels.len() - 1];
        let merged = merge::neighbors(last, config.merge, config.max_growth);
        if merged.len() == last.len() {
            break;
        }
        levels.push(merged);
    }
    levels
}

fn largest_sigma_m(splats: &Splats, index: usize) -> f32 {
    let scales = &splats.planes()[Plane::SCALE..Plane::SCALE + 3];
    let log = scales.iter().map(|plane| plane[index]);
    libm::expf(log.fold(f32::NEG_INFINITY, f32::max))
}

fn mean_sigma_m(splats: &Splats) -> f32 {
    let sum: f32 = (0..splats.len()).map(|i| largest_sigma_m(splats, i)).sum();
    sum / splats.len().max(1) as f32
}

impl Cluster {
    fn new(levels: &[Splats], ranges: Vec<LevelRange>) -> Self {
        let means = || {
            let all = levels
                .iter()
                .flat_map(|splats| (0..splats.len()).map(move |i| (splats, i)));
            all.map(|(splats, i)| (splats.get(i).position_m, largest_sigma_m(splats, i)))
        };
        let mut low = [f32::INFINITY; 3];
        let mut high = [f32::NEG_INFINITY; 3];
        for (position, _) in means() {
            for k in 0..3 {
                low[k] = low[k].min(position[k]);
                high[k] = high[k].max(position[k]);
            }
        }
        let center: [f32; 3] = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
        let distance = |position: [f32; 3]| {
            let square: f32 = (0..3).map(|k| (position[k] - center[k]).powi(2)).sum();
            square.sqrt()
        };
        let reach = means().map(|(position, sigma)| distance(position) + REACH_SIGMAS * sigma);
        Self {
            center,
            radius: reach.fold(0.0, f32::max),
            spread: means()
                .map(|(position, _)| distance(position))
                .fold(0.0, f32::max),
            levels: ranges,
        }
    }

    /// Smallest depth of a mean, at least `near_m`; `None` if nothing can have pixels.
    fn depth(&self, view: &View, near_m: f32) -> Option<f32> {
        let offset: [f32; 3] = std::array::from_fn(|k| self.center[k] - view.center[k]);
        let [x, y, z] = view
            .rotation
            .map(|row| row[0] * offset[0] + row[1] * offset[1] + row[2] * offset[2]);
        if z + self.radius < near_m {
            return None;
        }
        // Sides of the image of a pinhole camera; others, and those in motion, see all in front.
        if view.lens.is_none() && view.rolling.is_none() {
            let size = [view.width, view.height];
            for (k, at) in [x, y].into_iter().enumerate() {
                let (focal, center) = (view.focal[k], view.principal[k]);
                let low = (-BORDER_PX - center) / focal;
                let high = (size[k] as f32 + BORDER_PX - center) / focal;
                let beyond = |slope: f32| self.radius * (1.0 + slope * slope).sqrt();
                if at - low * z < -beyond(low) || at - high * z > beyond(high) {
                    return None;
                }
            }
        }
        Some((z - self.spread).max(near_m).max(1e-3))
    }
}
