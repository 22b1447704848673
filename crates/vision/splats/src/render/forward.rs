//! Rendering of an image.

use std::ops::Range;

use rayon::prelude::*;

use super::bins::Bins;
use super::blend::{Blend, TileImage};
use super::image::Image;
use super::project::{self, Footprint};
use super::rays::RayTables;
use super::view::View;
use super::{finish, order};
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::error::SplatError;
use crate::lanes::Level;
use crate::scene::{Background, Exposure, Scene};

/// Work that an image needed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderStats {
    /// Gaussians with pixels in the image.
    pub visible: usize,
    /// Gaussians that f32 cannot represent in the image.
    pub degenerate: usize,
    /// Pairs of a Gaussian and a tile.
    pub pairs: usize,
}

/// Renders scenes.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use camera_models::{CameraModel, Distortion};
/// use splats::{Background, Camera, Exposure, RenderConfig, Renderer, Scene, Splat, Splats};
///
/// let mut splats = Splats::empty(0)?;
/// let ball = Splat::sphere(0.2, [1.0, 0.0, 0.0]);
/// let ball = Splat { opacity_logit: 9.0, position_m: [0.0, 0.0, 2.0], ..ball };
/// splats.push(&ball)?;
/// let scene = Scene { splats, background: Background::Constant([0.0, 0.0, 1.0]) };
/// let model = CameraModel::new((64, 48), [60.0, 60.0, 32.0, 24.0], Distortion::None);
/// let camera = Camera::new(model, RigidTransform::identity())?;
///
/// let renderer = Renderer::new(RenderConfig::default())?;
/// let image = renderer.render(&scene, &camera, &Exposure::NONE);
/// let middle = 24 * 64 + 32;
/// assert!(image.rgb[0][middle] > 0.98 && image.rgb[2][0] > 0.98);
/// assert_eq!(image.median_depth_m[middle], 2.0);
/// assert!(image.median_depth_m[0].is_nan());
/// # Ok::<(), splats::SplatError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Renderer {
    pub(super) config: RenderConfig,
    pub(super) level: Level,
    rays: RayTables,
}

/// An image with what its gradients need.
#[derive(Debug)]
pub struct Pass {
    /// The image.
    pub image: Image,
    /// Work that it needed.
    pub stats: RenderStats,
    pub(super) footprints: Vec<Footprint>,
    pub(super) bins: Bins,
    pub(super) tiles: Vec<TileImage>,
}

impl Renderer {
    /// # Errors
    /// [`SplatError::Setting`] if a setting is outside of its domain.
    pub fn new(config: RenderConfig) -> Result<Self, SplatError> {
        let setting = |name, found: f32, valid: bool, expected| match valid {
            true => Ok(()),
            false => Err(SplatError::Setting {
                name,
                found: f64::from(found),
                expected,
            }),
        };
        let c = &config;
        let share = |v: f32| v > 0.0 && v < 1.0;
        setting(
            "dilation_px2",
            c.dilation_px2,
            (0.01..100.0).contains(&c.dilation_px2),
            "0.01 to 100",
        )?;
        setting(
            "max_alpha",
            c.max_alpha,
            share(c.max_alpha),
            "above 0 and below 1",
        )?;
        setting(
            "min_alpha",
            c.min_alpha,
            share(c.min_alpha),
            "above 0 and below 1",
        )?;
        let t = c.min_transmittance;
        setting("min_transmittance", t, (0.0..0.5).contains(&t), "0 to 0.5")?;
        let a = c.min_depth_alpha;
        setting("min_depth_alpha", a, share(a), "above 0 and below 1")?;
        let d = c.slope_dilation_px2;
        setting(
            "slope_dilation_px2",
            d,
            (0.001..100.0).contains(&d),
            "0.001 to 100",
        )?;
        let m = c.max_slope_share;
        setting(
            "max_slope_share",
            m,
            (0.0..1.0).contains(&m),
            "0 to below 1",
        )?;
        setting(
            "near_m",
            c.near_m,
            c.near_m > 0.0 && c.near_m < c.far_m,
            "above 0 and below far_m",
        )?;
        setting("far_m", c.far_m, c.far_m <= 1e9, "at most 1e9")?;
        setting(
            "margin",
            c.margin,
            (0.0..=10.0).contains(&c.margin),
            "0 to 10",
        )?;
        setting(
            "min_shear",
            c.min_shear,
            share(c.min_shear),
            "above 0 and below 1",
        )?;
        let m = c.min_compensation;
        setting("min_compensation", m, share(m), "above 0 and below 1")?;
        Ok(Self {
            config,
            level: Level::best(),
            rays: RayTables::default(),
        })
    }

    /// The same renderer on another instruction set, which changes no result.
    #[must_use]
    pub fn with_level(mut self, level: Level) -> Self {
        self.level = level;
        self
    }

    /// The instruction set.
    pub(crate) fn level(&self) -> Level {
        self.level
    }

    /// The configuration.
    pub fn config(&self) -> &RenderConfig {
        &self.config
    }

    /// Renders an image.
    pub fn render(&self, scene: &Scene, camera: &Camera, exposure: &Exposure) -> Image {
        self.forward(scene, camera, exposure).image
    }

    /// Renders many images of a scene, in parallel.
    pub fn render_batch(
        &self,
        scene: &Scene,
        cameras: &[Camera],
        exposure: &Exposure,
    ) -> Vec<Image> {
        let images = cameras.par_iter();
        images
            .map(|camera| self.render(scene, camera, exposure))
            .collect()
    }

    /// Renders an image and keeps what its gradients need.
    pub fn forward(&self, scene: &Scene, camera: &Camera, exposure: &Exposure) -> Pass {
        let ranges = project::whole(&scene.splats);
        self.forward_ranges(scene, &ranges, 1, camera, exposure)
    }

    /// The camera as the kernels use it for a scene.
    pub(super) fn view(&self, scene: &Scene, camera: &Camera) -> View {
        let mut view = View::new(camera, &self.config);
        if let Background::Sky(_) = scene.background {
            view.rays = self.rays.of(camera);
        }
        view
    }

    /// Renders some ranges of the Gaussians.
    pub(super) fn forward_ranges(
        &self,
        scene: &Scene,
        ranges: &[Range<usize>],
        ranges_per_task: usize,
        camera: &Camera,
        exposure: &Exposure,
    ) -> Pass {
        let view = self.view(scene, camera);
        let (splats, config) = (&scene.splats, &self.config);
        let (footprints, degenerate) =
            project::project(splats, ranges, ranges_per_task, &view, config, self.level);
        let order = order::by_depth(&footprints);
        let bins = Bins::new(&footprints, &order, &view);
        let tiles: Vec<TileImage> = (0..bins.tiles())
            .into_par_iter()
            .map(|tile| {
                self.level.run(Blend {
                    footprints: &footprints,
                    entries: bins.entries(tile),
                    view: &view,
                    tile,
                    config: &self.config,
                })
            })
            .collect();
        let image = finish::finish(&tiles, scene, &view, exposure, &self.config);
        Pass {
            image,
            stats: RenderStats {
                visible: footprints.len(),
                degenerate,
                pairs: bins.pairs(),
            },
            footprints,
            bins,
            tiles,
        }
    }
}
