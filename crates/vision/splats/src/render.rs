//! The renderer: tiles of 16x16 pixels, vectors of eight lanes, threads of the current rayon pool.
//!
//! Contract: the same image as the [reference](crate::reference) up to rounding, and the same bytes
//! on any number of threads and with every [`Level`]. Gaussians that cannot be represented in f32
//! in the image (degenerate or larger than about 10⁷ px) are not rendered and counted.
//!
//! Stages: projection of eight neighboring Gaussians at a time (`project`), order by depth
//! (`order`), lists of Gaussians per tile (`bins`), blending per tile (`blend`), background,
//! exposure and depths (`finish`).

mod backward;
mod bins;
mod blend;
mod finish;
mod order;
mod project;
#[cfg(test)]
mod tests;
mod view;

use rayon::prelude::*;

use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::error::SplatError;
use crate::lanes::Level;
use crate::scene::{Exposure, Scene};
pub use backward::{Gradients, ImageGradient};
use bins::Bins;
use blend::{Blend, TileImage};
use project::Footprint;
use view::View;

/// An image, row by row, a plane per channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green and blue, after the exposure.
    pub rgb: [Vec<f32>; 3],
    /// Expected depth along the optical axis, m; NaN where accumulated alpha is too small.
    pub expected_depth_m: Vec<f32>,
    /// Median depth along the optical axis, m; NaN where accumulated alpha is below a half.
    pub median_depth_m: Vec<f32>,
    /// Accumulated alpha, 0 to 1.
    pub alpha: Vec<f32>,
}

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
/// let ball = Splat { opacity_logit: 9.0, position_m: [0.0, 0.0, 2.0], ..Splat::sphere(0.2, [1.0, 0.0, 0.0]) };
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
#[derive(Clone, Copy, Debug)]
pub struct Renderer {
    config: RenderConfig,
    level: Level,
}

/// An image with what its gradients need.
#[derive(Debug)]
pub struct Pass {
    /// The image.
    pub image: Image,
    /// Work that it needed.
    pub stats: RenderStats,
    footprints: Vec<Footprint>,
    bins: Bins,
    tiles: Vec<TileImage>,
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
        let view = View::new(camera, &self.config);
        let (footprints, degenerate) =
            project::project(&scene.splats, &view, &self.config, self.level);
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
        let image = finish::finish(&tiles, scene, camera, &view, exposure, &self.config);
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
