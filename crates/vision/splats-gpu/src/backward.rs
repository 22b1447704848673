//! Gradients of a loss, given its gradient with respect to an image.
//!
//! Each pair of a Gaussian and a tile has a slot into which its tile writes sums over pixels; the
//! slots of a Gaussian are then added in the order of tiles. No number is added by an atomic
//! operation, so that the same input gives the same bytes on the same device.

use splats::Plane;
use wgpu::ComputePass;

use crate::device::Gpu;
use crate::error::GpuError;
use crate::frame::{EncodedFrame, Frame};
use crate::kernel::Kernel;
use crate::memory::Store;
use crate::scene::GpuScene;
use crate::shaders::{COMMON, GEOMETRY, HARMONICS, LENS, SKY, SLOPE, THREADS};

const PIXELS: &str = include_str!("shaders/pixels.wgsl");
const TEXELS: &str = include_str!("shaders/texels.wgsl");
const SLOTS: &str = include_str!("shaders/slots.wgsl");
const TRANSFORM: &str = include_str!("shaders/transform.wgsl");
const TOTALS: &str = include_str!("shaders/totals.wgsl");

/// Planes of the gradient of an image: red, green, blue, expected depth, alpha, error.
pub(crate) const GRADIENT_PLANES: usize = 6;
/// Planes that the gradients of a tile start from.
const START_PLANES: usize = 6;
/// Sums of a slot.
const SLOT: usize = 16;
/// Planes beside those of the parameters.
pub(crate) const EXTRAS: usize = 11;
/// Sums of a tile, and of all.
const OF_TILE: usize = 16;
pub(crate) const TOTALS_LEN: usize = 22;

/// Computes gradients on the device.
#[derive(Debug)]
pub(crate) struct Backward {
    start_pixels: Kernel,
    sum_texels: Kernel,
    sum_pixels: Kernel,
    to_parameters: Kernel,
    sum_tiles: Kernel,
    sum_motion: Kernel,
    /// Of the image.
    pub(crate) gradient: Store,
    start: Store,
    of_tile: Store,
    boxes: Store,
    slots: Store,
    pub(crate) by_parameter: Store,
    pub(crate) extras: Store,
    pub(crate) totals: Store,
    pub(crate) by_texel: Store,
}

impl Backward {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let store = |what, len| Store::new(gpu, what, len);
        let totals = |name| Kernel::new(gpu, name, &[COMMON, TOTALS]);
        let transform = [COMMON, LENS, GEOMETRY, SLOPE, HARMONICS, TRANSFORM];
        Ok(Self {
            start_pixels: Kernel::new(gpu, "start_pixels", &[COMMON, SKY, PIXELS])?,
            sum_texels: Kernel::new(gpu, "sum_texels", &[COMMON, SKY, TEXELS])?,
            sum_pixels: Kernel::new(gpu, "sum_pixels", &[COMMON, SLOTS])?,
            to_parameters: Kernel::new(gpu, "to_parameters", &transform)?,
            sum_tiles: totals("sum_tiles")?,
            sum_motion: totals("sum_motion")?,
            gradient: store("the gradient of the image", 0)?,
            start: store("the gradient of the image", 0)?,
            of_tile: store("sums of tiles", 0)?,
            boxes: store("texels of tiles", 0)?,
            slots: store("slots of pairs", 0)?,
            by_parameter: store("gradients", 0)?,
            extras: store("gradients", 0)?,
            totals: store("sums of gradients", TOTALS_LEN)?,
            by_texel: store("gradients of the background", 0)?,
        })
    }

    pub(crate) fn reserve(
        &mut self,
        gpu: &Gpu,
        frame: &Frame,
        scene: &GpuScene,
        of: &EncodedFrame,
    ) -> Result<(), GpuError> {
        let (pixels, tiles) = (of.view.pixels(), of.view.tiles());
        self.gradient.reserve(gpu, GRADIENT_PLANES * pixels)?;
        self.start.reserve(gpu, START_PLANES * pixels)?;
        self.of_tile.reserve(gpu, OF_TILE * tiles)?;
        self.boxes.reserve(gpu, 4 * tiles)?;
        self.slots.reserve(gpu, SLOT * frame.pairs())?;
        let planes = Plane::count(scene.degree);
        self.by_parameter.reserve(gpu, planes * scene.splats)?;
        self.extras.reserve(gpu, EXTRAS * scene.splats)?;
        self.by_texel.reserve(gpu, 3 * scene.texels())
    }

    /// Encodes the work after that of the image, whose gradient is there. `motion`: that of the
    /// camera's motion too.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut ComputePass<'_>,
        f: &Frame,
        scene: &GpuScene,
        of: &EncodedFrame,
        motion: bool,
    ) {
        let groups = |threads: usize| [threads.div_ceil(THREADS) as u32, 1];
        let tiles = [of.view.size[2], of.view.size[3]];
        let uniform = (0, f.view.buffer());
        let (background, rays) = (scene.background.buffer(), f.rays.buffer());
        let pixels = [
            uniform,
            (1, f.blended.buffer()),
            (2, self.gradient.buffer()),
            (3, background),
            (4, rays),
            (5, self.start.buffer()),
            (6, self.of_tile.buffer()),
            (7, self.boxes.buffer()),
        ];
        self.start_pixels.run(gpu, pass, &pixels, tiles);
        if scene.sky > 0 {
            let texels = [
                uniform,
                (1, f.blended.buffer()),
                (2, self.start.buffer()),
                (4, rays),
                (5, self.boxes.buffer()),
                (6, self.by_texel.buffer()),
            ];
            self.sum_texels
                .run(gpu, pass, &texels, groups(scene.texels()));
        }
        let slots = [
            uniform,
            (1, f.footprints.buffer()),
            (2, f.splat_of_pair.buffer()),
            (3, f.entries(of).buffer()),
            (4, f.first_entry.buffer()),
            (5, self.start.buffer()),
            (6, self.slots.buffer()),
        ];
        self.sum_pixels.run(gpu, pass, &slots, tiles);
        let transform = [
            uniform,
            (1, scene.planes.buffer()),
            (2, f.footprints.buffer()),
            (3, f.order(of).buffer()),
            (4, f.first_pair.buffer()),
            (5, self.slots.buffer()),
            (6, self.by_parameter.buffer()),
            (7, self.extras.buffer()),
        ];
        self.to_parameters
            .run(gpu, pass, &transform, groups(scene.splats));
        let totals = (3, self.totals.buffer());
        let by_texel = (4, self.by_texel.buffer());
        let sums = [uniform, (1, self.of_tile.buffer()), totals, by_texel];
        self.sum_tiles.run(gpu, pass, &sums, [1, 1]);
        if motion {
            let sums = [uniform, (2, self.extras.buffer()), totals];
            self.sum_motion.run(gpu, pass, &sums, [1, 1]);
        }
    }
}
