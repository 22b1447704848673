//! Gradients of a loss, given its gradient with respect to an image.
//!
//! Each pair of a Gaussian and a tile has a slot into which its tile writes sums over pixels; the
//! slots of a Gaussian are then added in the order of tiles. No number is added by an atomic
//! operation, so that the same input gives the same bytes on the same device.

use splats::{Camera, Exposure, Gradients, ImageGradient, Plane, SplatError};
use wgpu::ComputePass;

use crate::device::Gpu;
use crate::error::GpuError;
use crate::forward::{
    COMMON, GEOMETRY, GpuRenderer, HARMONICS, LENS, SKY, THREADS, encoder, submit,
};
use crate::frame::{Encoded, status};
use crate::kernel::Kernel;
use crate::memory::{Download, Store, floats};
use crate::scene::GpuScene;

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
const SLOT: usize = 14;
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
        let transform = [COMMON, LENS, GEOMETRY, HARMONICS, TRANSFORM];
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
        renderer: &GpuRenderer,
        scene: &GpuScene,
        of: &Encoded,
    ) -> Result<(), GpuError> {
        let gpu = &renderer.gpu;
        let (pixels, tiles) = (of.view.pixels(), of.view.tiles());
        self.gradient.reserve(gpu, GRADIENT_PLANES * pixels)?;
        self.start.reserve(gpu, START_PLANES * pixels)?;
        self.of_tile.reserve(gpu, OF_TILE * tiles)?;
        self.boxes.reserve(gpu, 4 * tiles)?;
        self.slots.reserve(gpu, SLOT * renderer.frame.pairs())?;
        let planes = Plane::count(scene.degree);
        self.by_parameter.reserve(gpu, planes * scene.splats)?;
        self.extras.reserve(gpu, EXTRAS * scene.splats)?;
        self.by_texel.reserve(gpu, 3 * scene.texels())
    }

    /// Encodes the work after that of the image, whose gradient is there. `motion`: that of the
    /// camera's motion too.
    pub(crate) fn encode(
        &self,
        pass: &mut ComputePass<'_>,
        renderer: &GpuRenderer,
        scene: &GpuScene,
        of: &Encoded,
        motion: bool,
    ) {
        let (gpu, f) = (&renderer.gpu, &renderer.frame);
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

impl GpuRenderer {
    /// Gradients of a loss whose gradient with respect to the image is given. Renders the image.
    ///
    /// # Errors
    /// [`GpuError::Splats`] if a plane has not one value per pixel; others of the device.
    pub fn backward(
        &mut self,
        scene: &GpuScene,
        camera: &Camera,
        exposure: &Exposure,
        gradient: &ImageGradient,
    ) -> Result<Gradients, GpuError> {
        let gpu = self.gpu.clone();
        let planes = planes(gradient, camera.pixels())?;
        let mut backward = match self.backward.take() {
            Some(backward) => backward,
            None => Backward::new(&gpu)?,
        };
        let (values, texels) = (Plane::count(scene.degree) * scene.splats, scene.texels());
        let found = loop {
            let mut encoder = encoder(&gpu);
            let encoded = self.encode(&mut encoder, scene, camera, exposure)?;
            backward.reserve(self, scene, &encoded)?;
            for (k, plane) in planes.iter().enumerate() {
                backward.gradient.write(&gpu, k * plane.len(), plane);
            }
            let description = wgpu::ComputePassDescriptor::default();
            let mut pass = encoder.begin_compute_pass(&description);
            backward.encode(&mut pass, self, scene, &encoded, true);
            drop(pass);
            let from = [
                (&self.frame.status, status::LEN),
                (&backward.by_parameter, values),
                (&backward.extras, EXTRAS * scene.splats),
                (&backward.totals, TOTALS_LEN),
                (&backward.by_texel, 3 * texels),
            ];
            let download = Download::new(&gpu, &mut encoder, &from)?;
            submit(&gpu, "gradients", encoder)?;
            let found = download.read(&gpu)?;
            if self.fits(&found[0])? {
                break found;
            }
        };
        self.backward = Some(backward);
        let [by_parameter, extras, totals] = [1, 2, 3].map(|k| floats(&found[k]));
        let mut gradients = gather(scene.splats, &by_parameter, &extras, &totals);
        gradients.background = floats(&found[4]).as_chunks().0.to_vec();
        Ok(gradients)
    }
}

/// The planes of the gradient of an image, zeros where there are none.
fn planes(of: &ImageGradient, pixels: usize) -> Result<[Vec<f32>; GRADIENT_PLANES], SplatError> {
    let [red, green, blue] = &of.rgb;
    let all = [
        ("gradient of red", red, false),
        ("gradient of green", green, false),
        ("gradient of blue", blue, false),
        ("gradient of the expected depth", &of.expected_depth, true),
        ("gradient of the accumulated alpha", &of.alpha, true),
        ("error", &of.error, true),
    ];
    let mut out: [Vec<f32>; GRADIENT_PLANES] = Default::default();
    for (out, (what, plane, may_be_empty)) in out.iter_mut().zip(all) {
        *out = match plane.len() {
            found if found == pixels => plane.clone(),
            0 if may_be_empty => vec![0.0; pixels],
            found => {
                let expected = pixels;
                return Err(SplatError::Size {
                    what,
                    found,
                    expected,
                });
            }
        };
    }
    Ok(out)
}

/// Gradients of the visible Gaussians, without those of the background.
fn gather(splats: usize, by_parameter: &[f32], extras: &[f32], totals: &[f32]) -> Gradients {
    let extra = |k: usize| &extras[k * splats..(k + 1) * splats];
    let visible: Vec<usize> = (0..splats).filter(|i| extras[*i] > 0.0).collect();
    let of = |plane: &[f32]| visible.iter().map(|i| plane[*i]).collect::<Vec<f32>>();
    let absolute = of(extra(1)).into_iter().zip(of(extra(2)));
    let wide = |k: usize| f64::from(totals[k]);
    Gradients {
        indices: visible.iter().map(|i| *i as u32).collect(),
        planes: by_parameter.chunks_exact(splats.max(1)).map(of).collect(),
        absolute: absolute.map(|(x, y)| [x, y]).collect(),
        error: of(extra(3)),
        weight: of(extra(4)),
        motion: std::array::from_fn(|k| wide(16 + k)),
        exposure: std::array::from_fn(|row| std::array::from_fn(|k| wide(4 * row + k))),
        background: Vec::new(),
    }
}
