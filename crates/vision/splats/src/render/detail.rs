//! Level of detail: fewer, larger Gaussians where the originals would be smaller than pixels.
//!
//! Neighbors form clusters, [halves] of halves of the scene, and these the [nodes] of a hierarchy,
//! with their Gaussians [merged](merge). A camera takes of each branch that it can see the highest
//! node whose Gaussians stay small in the image. Its image is rendered node by node from front to
//! back, and what only complete pixels would show is left out ([`region`]). The price is stated by
//! comparison with [`Renderer::render`].

mod baked;
mod camera;
pub(super) mod config;
mod halves;
mod image;
mod merge;
mod nodes;
mod pixels;
mod region;
#[cfg(test)]
mod tests;

use std::ops::Range;

use rayon::prelude::*;

use self::baked::BakedBlocks;
use self::camera::{Rectangle, RegionCamera};
use self::config::DetailConfig;
use self::merge::Merging;
use self::nodes::{Node, Nodes, Sphere};
use self::region::Contents;
use super::forward::Renderer;
use super::image::Image;
use super::view::View;
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::error::SplatError;
use crate::scene::{Exposure, Plane, Scene, Splats};

/// Ranges of Gaussians of a task of projection.
const RANGES_PER_TASK: usize = 64;

/// Least `min_alpha`, and the standard deviations from a mean beyond which a Gaussian is below it:
/// `√(2 ln 500)`.
const LEAST_ALPHA: f32 = 0.002;
const REACH_SIGMAS: f32 = 3.53;

/// A level that has more than this share of the Gaussians below it is none.
const MAX_SHARE: f64 = 0.9;

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
    /// Gaussians of all levels, node by node.
    scene: Scene,
    baked: BakedBlocks,
    nodes: Nodes,
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
        let threshold = |name, found: f32, valid: bool, expected| match valid {
            true => Ok(()),
            false => Err(SplatError::Setting {
                name,
                found: f64::from(found),
                expected,
            }),
        };
        let (alpha, rest) = (config.min_alpha, config.min_transmittance);
        let is_share = (LEAST_ALPHA..1.0).contains(&alpha);
        threshold("min_alpha", alpha, is_share, "0.002 to 1")?;
        let is_small = (0.0..0.5).contains(&rest);
        threshold("min_transmittance", rest, is_small, "0 to 0.5")?;
        let order = halves::order(&scene.splats);
        let mut level: Vec<Splats> = order
            .par_chunks(config.cluster)
            .map(|indices| scene.splats.select(indices))
            .collect();
        let mut built = LevelBuilder::new(scene.splats.degree());
        built.add(&level, 0);
        let merging = Merging::new(config);
        for _ in 0..config.levels {
            let merged: Vec<Splats> = level
                .par_chunks(config.merge)
                .map(|children| merge::neighbors(&joined(children), &merging))
                .collect();
            let count = |level: &[Splats]| level.iter().map(Splats::len).sum::<usize>();
            // Few could be merged.
            if count(&merged) as f64 > MAX_SHARE * count(&level) as f64 {
                break;
            }
            built.add(&merged, config.merge);
            level = merged;
        }
        let splats = Splats::from_planes(scene.splats.degree(), built.planes)?;
        let background = scene.background.clone();
        Ok(Self {
            scene: Scene { splats, background },
            baked: built.baked,
            nodes: built.nodes,
            config: *config,
        })
    }

    /// Number of Gaussians in what an image of a camera can show, hidden ones among them.
    pub fn count(&self, camera: &Camera) -> usize {
        let config = RenderConfig::default();
        let view = View::new(camera, &config);
        self.ranges(&view, &config).iter().map(Range::len).sum()
    }

    /// Gaussians of the nodes that a camera takes, as they lie in memory.
    fn ranges(&self, view: &View, config: &RenderConfig) -> Vec<Range<usize>> {
        let whole = Rectangle {
            origin: [0; 2],
            size: [view.width, view.height],
        };
        let camera = RegionCamera::new(view, whole, config, &self.config);
        let (mut open, mut found) = (Vec::new(), Vec::new());
        let max_sigma_px = self.config.max_sigma_px;
        self.nodes
            .find(&camera, max_sigma_px, &mut open, &mut found);
        found.sort_unstable_by_key(|candidate| candidate.node);
        let nodes = found
            .iter()
            .map(|found| &self.nodes.all[found.node as usize]);
        nodes.map(|node| node.range.clone()).collect()
    }
}

/// What a scene consists of, while its levels are made.
struct LevelBuilder {
    planes: Vec<Vec<f32>>,
    baked: BakedBlocks,
    nodes: Nodes,
}

impl LevelBuilder {
    fn new(degree: usize) -> Self {
        Self {
            planes: vec![Vec::new(); Plane::count(degree)],
            baked: BakedBlocks::new(degree),
            nodes: Nodes::default(),
        }
    }

    /// Adds a level above the last one, each node of which has some nodes of that one as children;
    /// the leaves have none.
    fn add(&mut self, level: &[Splats], children: usize) {
        let below = self.nodes.roots.clone();
        let first = self.nodes.all.len();
        for (number, splats) in level.iter().enumerate() {
            let (start, first_block) = (self.planes[0].len(), self.baked.blocks());
            for (all, plane) in self.planes.iter_mut().zip(splats.planes()) {
                all.extend(plane);
            }
            self.baked.extend(splats);
            let from = below.start + number * children;
            let children = from..(from + children).min(below.end);
            let spheres: Vec<Sphere> = children
                .clone()
                .map(|child| self.nodes.all[child].sphere)
                .collect();
            self.nodes.all.push(Node {
                sphere: sphere(splats, &spheres),
                range: start..self.planes[0].len(),
                blocks: first_block..self.baked.blocks(),
                sigma_m: mean_sigma_m(splats),
                children,
            });
        }
        self.nodes.roots = first..self.nodes.all.len();
    }
}

/// Several clusters as one.
fn joined(parts: &[Splats]) -> Splats {
    let mut all = parts[0].clone();
    for part in &parts[1..] {
        for i in 0..part.len() {
            all.push(&part.get(i))
                .expect("a Gaussian of the scene itself");
        }
    }
    all
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
            let contents = Contents {
                nodes: &scene.nodes,
                baked: &scene.baked,
                config: &scene.config,
            };
            return image::render(self, contents, &scene.scene, &view, exposure);
        }
        let ranges = scene.ranges(&view, &self.config);
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

fn largest_sigma_m(splats: &Splats, index: usize) -> f32 {
    let scales = &splats.planes()[Plane::SCALE..Plane::SCALE + 3];
    let log = scales.iter().map(|plane| plane[index]);
    libm::expf(log.fold(f32::NEG_INFINITY, f32::max))
}

fn mean_sigma_m(splats: &Splats) -> f32 {
    let sum: f32 = (0..splats.len()).map(|i| largest_sigma_m(splats, i)).sum();
    sum / splats.len().max(1) as f32
}

/// The sphere around Gaussians and other spheres.
fn sphere(splats: &Splats, others: &[Sphere]) -> Sphere {
    let means = || (0..splats.len()).map(|i| splats.get(i).position_m);
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for position in means() {
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
    let (mut radius_m, mut spread_m) = (0.0_f32, 0.0_f32);
    for (i, position) in means().enumerate() {
        spread_m = spread_m.max(distance(position));
        radius_m = radius_m.max(distance(position) + REACH_SIGMAS * largest_sigma_m(splats, i));
    }
    for other in others {
        let distance = distance(other.center);
        spread_m = spread_m.max(distance + other.spread_m);
        radius_m = radius_m.max(distance + other.radius_m);
    }
    Sphere {
        center,
        radius_m,
        spread_m,
    }
}
