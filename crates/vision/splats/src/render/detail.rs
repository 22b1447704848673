//! Level of detail: fewer, larger Gaussians where the originals would be smaller than pixels.
//!
//! Neighbors along a Morton curve form clusters. Each cluster has levels, in each of which about
//! four Gaussians of the level below are [merged](merge). A camera takes of each cluster that it
//! can see the coarsest level whose Gaussians stay small in the image. Its image is rendered
//! cluster by cluster from front to back, and what only complete pixels would show is left out
//! ([`region`]). The price is stated by comparison with [`Renderer::render`].

mod baked;
mod clusters;
mod image;
mod merge;
mod pixels;
mod region;
#[cfg(test)]
mod tests;

use std::ops::Range;

use estimator_config::config;
use rayon::prelude::*;

use self::baked::Baked;
use self::clusters::{Candidate, Clusters, Level, Sphere};
use self::merge::Merging;
use self::region::{Camera as RegionCamera, Rectangle};
use super::forward::Renderer;
use super::image::Image;
use super::view::View;
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::error::SplatError;
use crate::lanes::{Kernel, Lanes, Level as Instructions};
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
        /// Dilation of the images in which coarser levels are used, px²: that of
        /// [`RenderConfig`], or 0 with its compensation.
        pub dilation_px2: f32 = 0.3,
        /// Alpha below which a Gaussian does not contribute to a pixel of a camera without
        /// distortion and motion.
        pub min_alpha: f32 = 1.0 / 255.0,
        /// Transmittance below which a pixel of such a camera is complete.
        pub min_transmittance: f32 = 1e-4,
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
    baked: Baked,
    clusters: Clusters,
    config: DetailConfig,
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
        let mut baked = Baked::new(scene.splats.degree());
        let mut clusters = Clusters::default();
        for levels in built {
            let mut of_cluster = Vec::with_capacity(levels.len());
            for splats in &levels {
                let (start, first_block) = (planes[0].len(), baked.blocks());
                for (all, plane) in planes.iter_mut().zip(splats.planes()) {
                    all.extend(plane);
                }
                baked.extend(splats);
                of_cluster.push(Level {
                    range: start..planes[0].len(),
                    blocks: first_block..baked.blocks(),
                    sigma_m: mean_sigma_m(splats),
                });
            }
            clusters.push(&sphere(&levels), of_cluster);
        }
        let splats = Splats::from_planes(scene.splats.degree(), planes)?;
        let background = scene.background.clone();
        Ok(Self {
            scene: Scene { splats, background },
            baked,
            clusters,
            config: *config,
        })
    }

    /// Number of Gaussians in what an image of a camera can show, hidden ones among them.
    pub fn count(&self, camera: &Camera) -> usize {
        let config = RenderConfig::default();
        let view = View::new(camera, &config);
        let ranges = self.ranges(&view, &config, Instructions::best());
        ranges.iter().map(|range| range.len()).sum()
    }

    /// Gaussians of the clusters that a camera can see, at their levels.
    fn ranges(
        &self,
        view: &View,
        config: &RenderConfig,
        instructions: Instructions,
    ) -> Vec<Range<usize>> {
        let mut found = instructions.run(Find {
            scene: self,
            view,
            config,
        });
        // As they lie in memory.
        found.sort_unstable_by_key(|candidate| candidate.cluster);
        let levels = found.iter().map(|candidate| self.clusters.level(candidate));
        levels.map(|level| level.range.clone()).collect()
    }
}

/// Clusters that a camera can see.
struct Find<'a> {
    scene: &'a DetailScene,
    view: &'a View,
    config: &'a RenderConfig,
}

impl Kernel for Find<'_> {
    type Output = Vec<Candidate>;

    #[inline(always)]
    fn run<V: Lanes>(self) -> Self::Output {
        let whole = Rectangle {
            origin: [0; 2],
            size: [self.view.width, self.view.height],
        };
        let camera = RegionCamera::new(self.view, whole, self.config, &self.scene.config);
        let mut found = Vec::new();
        let max_sigma_px = self.scene.config.max_sigma_px;
        self.scene
            .clusters
            .find::<V>(&camera, max_sigma_px, &mut found);
        found
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
        let view = self.view(&scene.scene, camera);
        if view.lens.is_none() && view.rolling.is_none() {
            return image::render(self, scene, &view, exposure);
        }
        let ranges = scene.ranges(&view, &self.config, self.level);
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
    let dilation = f64::from(config.dilation_px2).sqrt() / f64::from(config.max_sigma_px);
    let merging = Merging {
        count: config.merge,
        max_growth: config.max_growth,
        dilation: if dilation.is_finite() { dilation } else { 0.0 },
    };
    let mut levels = vec![splats];
    while levels.len() <= config.levels {
        let last = &levels[levels.len() - 1];
        let merged = merge::neighbors(last, &merging);
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

/// The sphere around all levels of a cluster.
fn sphere(levels: &[Splats]) -> Sphere {
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
    Sphere {
        center,
        radius_m: reach.fold(0.0, f32::max),
        spread_m: means()
            .map(|(position, _)| distance(position))
            .fold(0.0, f32::max),
    }
}
