//! Fusion of depth images to a truncated signed distance field (TSDF) in hashed voxel blocks.
//!
//! Contract: a voxel holds the weighted mean of its signed distances from the surfaces of the
//! views, measured along their normals, positive outside. Weights are inverse variances along the
//! normal. Surfaces that several views see through fade. Space that no view saw has no voxels, so
//! memory grows with the area of the surfaces, not with the number of views. The result depends on
//! the order of the views, but not on the number of threads. An invalid view changes nothing.

use cad_transforms::RigidTransform;

use crate::config::FusionConfig;
use crate::error::TerrainError;
use crate::view::DepthView;

mod allocation;
pub(crate) mod block;
mod cells;
mod fit;
mod frame;
pub(crate) mod grid;
mod integration;
mod observe;
mod pixels;
mod pyramid;
mod step;
mod update;

use block::{COUNT, DISTANCE_STEPS, EDGE, WEIGHT_STEPS};
use frame::{Frame, Images};
use grid::{Grid, MAX_COORDINATE};
use integration::Integration;

/// A TSDF of depth images.
///
/// A camera looks down at a floor 1 m below it:
///
/// ```
/// use cad_transforms::RigidTransform;
/// use terrain::fusion::Volume;
/// use terrain::{DepthView, FusionConfig, RowMotion};
///
/// let (depth_m, sigma_m) = (vec![1.0; 64 * 48], vec![0.005; 64 * 48]);
/// let half = [std::f64::consts::PI, 0.0, 0.0];
/// let down = RigidTransform::from_rotation_vector(half, [0.0, 0.0, 1.0])?;
/// let view = DepthView {
///     size: [64, 48],
///     focal_px: [60.0; 2],
///     center_px: [31.5, 23.5],
///     world_from_view: down,
///     row_motion: RowMotion::default(),
///     pose_sigma_m: 0.002,
///     depth_m: &depth_m,
///     sigma_m: &sigma_m,
///     color: None,
///     classes: None,
/// };
/// let mut volume = Volume::new(FusionConfig::default())?;
/// volume.add(&view)?;
/// // Two voxels of 2 cm above the floor.
/// let voxel = volume.voxel([0, 0, 2]).expect("it was observed");
/// assert!((voxel.distance_m - 0.04).abs() < 1e-4, "{voxel:?}");
/// assert!((voxel.sigma_m - 0.006).abs() < 1e-3, "{voxel:?}");
/// assert_eq!(volume.voxel([0, 0, 30]), None);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Volume {
    config: FusionConfig,
    grid: Grid,
    views: u64,
    /// For the next view.
    images: Images,
}

/// A voxel of a [`Volume`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Voxel {
    /// Signed distance from the surface, m; positive outside.
    pub distance_m: f64,
    /// One standard deviation of the distance from independent errors of the views, m.
    pub sigma_m: f64,
    /// Views that saw a surface within a voxel of it, at most 255.
    pub views: u8,
}

/// Size of a [`Volume`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct VolumeStats {
    /// Fused views.
    pub views: u64,
    /// Blocks of 8 x 8 x 8 voxels.
    pub blocks: usize,
    /// Blocks with surfaces.
    pub surface_blocks: usize,
    /// Times that a voxel was seen through and lost weight.
    pub carved: u64,
    /// Bytes of memory.
    pub bytes: usize,
}

impl Volume {
    /// # Errors
    /// [`TerrainError::Config`].
    pub fn new(config: FusionConfig) -> Result<Self, TerrainError> {
        let check = |what, found: f64, valid: bool, expected| match valid {
            true => Ok(()),
            false => Err(TerrainError::Config {
                what,
                found,
                expected,
            }),
        };
        let voxel = config.voxel_m;
        check(
            "the voxel",
            voxel,
            (0.002..=0.5).contains(&voxel),
            "0.002 to 0.5 m",
        )?;
        let unit = config.unit_sigma_m;
        check(
            "the sigma of weight 1",
            unit,
            (1e-4..=1.0).contains(&unit),
            "0.0001 to 1 m",
        )?;
        let voxels = config.front_voxels.min(config.back_voxels);
        check(
            "the truncation",
            voxels,
            (1.0..=16.0).contains(&voxels),
            "1 to 16 voxels",
        )?;
        let depth = config.max_depth_m;
        check(
            "the maximum depth",
            depth,
            (0.1..=100.0).contains(&depth),
            "0.1 to 100 m",
        )?;
        let cos = config.min_incidence_cos;
        check(
            "the cosine of the incidence",
            cos,
            (0.05..=1.0).contains(&cos),
            "0.05 to 1",
        )?;
        Ok(Self {
            config,
            grid: Grid::default(),
            views: 0,
            images: Images::default(),
        })
    }

    /// The configuration.
    pub fn config(&self) -> &FusionConfig {
        &self.config
    }

    /// Fuses a view.
    ///
    /// # Errors
    /// [`TerrainError::ImageSize`], [`TerrainError::View`], [`TerrainError::TooFar`].
    pub fn add(&mut self, view: &DepthView<'_>) -> Result<(), TerrainError> {
        view.validate()?;
        self.check_distance(&view.world_from_view)?;
        let frame = Frame::new(&self.config, view, std::mem::take(&mut self.images));
        let keys = allocation::blocks_at_surfaces(&self.config, &frame);
        self.grid.allocate(&keys);
        Integration::new(&self.config, &frame).run(&mut self.grid);
        self.images = frame.images;
        self.views += 1;
        Ok(())
    }

    /// The voxel whose center is this many voxels from the origin of the world, if a view saw it.
    pub fn voxel(&self, at: [i64; 3]) -> Option<Voxel> {
        let edge = EDGE as i64;
        let key = at.map(|k| k.div_euclid(edge));
        if key.iter().any(|k| k.abs() > i64::from(MAX_COORDINATE)) {
            return None;
        }
        let block = self.grid.get(key.map(|k| k as i32))?;
        let [x, y, z] = at.map(|k| k.rem_euclid(edge) as usize);
        let voxel = (z * EDGE + y) * EDGE + x;
        debug_assert!(voxel < COUNT);
        (block.weight[voxel] > 0).then(|| Voxel {
            distance_m: f64::from(block.distance[voxel]) * self.m_per_step(),
            sigma_m: self.sigma_m(block.weight[voxel]),
            views: block
                .surface
                .as_ref()
                .map_or(0, |surface| surface.views[voxel]),
        })
    }

    /// Counts of the volume.
    pub fn stats(&self) -> VolumeStats {
        let blocks = (0..self.grid.len()).map(|number| self.grid.at(number).0);
        VolumeStats {
            views: self.views,
            blocks: self.grid.len(),
            surface_blocks: blocks
                .clone()
                .filter(|block| block.surface.is_some())
                .count(),
            carved: blocks.map(|block| u64::from(block.carved)).sum(),
            bytes: self.grid.bytes(),
        }
    }

    pub(crate) fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Metres of a step of a stored distance.
    pub(crate) fn m_per_step(&self) -> f64 {
        update::stored_range(&self.config) / f64::from(DISTANCE_STEPS)
    }

    /// One standard deviation of a weight, m.
    pub(crate) fn sigma_m(&self, weight: u16) -> f64 {
        self.config.unit_sigma_m / (f64::from(weight) / f64::from(WEIGHT_STEPS)).sqrt()
    }

    fn check_distance(&self, world_from_view: &RigidTransform) -> Result<(), TerrainError> {
        let block_m = self.config.voxel_m * EDGE as f64;
        let max_m = f64::from(MAX_COORDINATE) * block_m - 2.0 * self.config.max_depth_m;
        let distance_m = world_from_view
            .translation_m()
            .iter()
            .fold(0.0, |a: f64, b| a.max(b.abs()));
        match distance_m <= max_m {
            true => Ok(()),
            false => Err(TerrainError::TooFar { distance_m, max_m }),
        }
    }
}
