//! The loss of an image on the device, and its gradient.

use bytemuck::{Pod, Zeroable};
use splats::{LossConfig, TrainingView};
use wgpu::ComputePass;

use crate::backward::Backward;
use crate::device::Gpu;
use crate::error::GpuError;
use crate::frame::Frame;
use crate::kernel::Kernel;
use crate::memory::{Store, Uniform};
use crate::view::TILE;

const LOSS: &str = include_str!("shaders/loss.wgsl");
const LOSSES: &str = include_str!("shaders/losses.wgsl");

/// Planes of what is blurred: five quantities of three channels.
const BLURRED_PLANES: usize = 15;
/// Planes of derivatives: three of three channels.
const DERIVATIVE_PLANES: usize = 9;
/// Radius of the window of the similarity, px.
const RADIUS: usize = 5;

/// `Loss` in the kernels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct Settings {
    size: [u32; 4],
    weights: [f32; 4],
    depth: [f32; 4],
    window: [[f32; 4]; 2],
}

/// Mean loss of an image, in parts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// Mean absolute difference of colors, 0 to 1.
    pub l1: f64,
    /// Mean structural similarity, at most 1; 0 where the loss does not have it.
    pub ssim: f64,
    /// Mean robust squared error of depth, sigmas².
    pub depth: f64,
}

/// Computes losses on the device.
#[derive(Debug)]
pub(crate) struct LossKernels {
    compare: Kernel,
    blur_images: Kernel,
    similarity: Kernel,
    blur_derivatives: Kernel,
    add_derivatives: Kernel,
    sum_losses: Kernel,
    settings: Uniform,
    recorded: Store,
    depths: Store,
    sums: Store,
    blurred: Store,
    derivatives: Store,
    pub(crate) losses: Store,
}

/// What the kernels have to do for a view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LossWork {
    groups: [u32; 2],
    has_similarity: bool,
    /// Number of usable pixels.
    pub(crate) count: f64,
}

impl LossKernels {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let kernel = |name| Kernel::new(gpu, name, &[LOSS]);
        let store = |what, len| Store::new(gpu, what, len);
        Ok(Self {
            compare: kernel("compare")?,
            blur_images: kernel("blur_images")?,
            similarity: kernel("similarity")?,
            blur_derivatives: kernel("blur_derivatives")?,
            add_derivatives: kernel("add_derivatives")?,
            sum_losses: Kernel::new(gpu, "sum_losses", &[LOSSES])?,
            settings: Uniform::new::<Settings>(gpu, &Zeroable::zeroed())?,
            recorded: store("the recorded image", 0)?,
            depths: store("recorded depths", 0)?,
            sums: store("sums of the loss", 0)?,
            blurred: store("blurred images", 0)?,
            derivatives: store("derivatives of the similarity", 0)?,
            losses: store("the loss", 4)?,
        })
    }

    /// Copies a view to the device.
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        view: &TrainingView,
        config: &LossConfig,
        depth_weight: f32,
    ) -> Result<LossWork, GpuError> {
        let model = view.camera.model();
        let pixels = view.camera.pixels();
        let groups = [model.width.div_ceil(TILE), model.height.div_ceil(TILE)];
        let count = view.valid_pixels().max(1) as f64;
        let has_depth = depth_weight > 0.0 && !view.depth_m.is_empty();
        let ssim = f64::from(config.ssim_weight);
        let settings = Settings {
            size: [model.width, model.height, groups[0], u32::from(has_depth)],
            weights: [
                ((1.0 - ssim) / (3.0 * count)) as f32,
                (ssim / (3.0 * count)) as f32,
                (f64::from(depth_weight) / count) as f32,
                config.noise * config.noise,
            ],
            depth: [config.depth_scale, config.min_depth_sigma_m, 0.0, 0.0],
            window: window(),
        };
        self.settings.write(gpu, &settings);
        self.recorded.reserve(gpu, pixels)?;
        self.recorded.write(gpu, 0, &packed(view));
        self.depths.reserve(gpu, 2 * pixels)?;
        if has_depth {
            self.depths.write(gpu, 0, &depths(view));
        }
        self.sums
            .reserve(gpu, 4 * (groups[0] * groups[1]) as usize)?;
        self.blurred.reserve(gpu, BLURRED_PLANES * pixels)?;
        self.derivatives.reserve(gpu, DERIVATIVE_PLANES * pixels)?;
        Ok(LossWork {
            groups,
            has_similarity: config.ssim_weight > 0.0,
            count,
        })
    }

    /// Encodes the work between that of the image and that of the gradients.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut ComputePass<'_>,
        work: LossWork,
        frame: &Frame,
        backward: &Backward,
    ) {
        let settings = (0, self.settings.buffer());
        let image = (1, frame.image.buffer());
        let recorded = (2, self.recorded.buffer());
        let depths = (3, self.depths.buffer());
        let gradient = (4, backward.gradient.buffer());
        let sums = (5, self.sums.buffer());
        let blurred = (6, self.blurred.buffer());
        let by = (7, self.derivatives.buffer());
        let groups = work.groups;
        let all = [settings, image, recorded, depths, gradient, sums];
        self.compare.run(gpu, pass, &all, groups);
        if work.has_similarity {
            let all = [settings, image, recorded, blurred];
            self.blur_images.run(gpu, pass, &all, groups);
            let all = [settings, recorded, sums, blurred, by];
            self.similarity.run(gpu, pass, &all, groups);
            self.blur_derivatives
                .run(gpu, pass, &[settings, blurred, by], groups);
            let all = [settings, image, recorded, gradient, blurred];
            self.add_derivatives.run(gpu, pass, &all, groups);
        }
        let all = [settings, sums, (8, self.losses.buffer())];
        self.sum_losses.run(gpu, pass, &all, [1, 1]);
    }
}

impl Losses {
    /// From the sums of the device: L1, depth, similarity.
    pub(crate) fn new(sums: &[f32], count: f64) -> Self {
        let [l1, depth, ssim] = [0, 1, 2].map(|k| f64::from(sums[k]));
        Self {
            l1: l1 / (3.0 * count),
            ssim: ssim / (3.0 * count),
            depth: depth / count,
        }
    }
}

/// The window of the similarity along one axis, from its middle outward: standard deviation 1.5.
fn window() -> [[f32; 4]; 2] {
    let value = |k: usize| (-((k * k) as f64) / 4.5).exp();
    let sum = value(0) + 2.0 * (1..=RADIUS).map(value).sum::<f64>();
    let mut out = [[0.0; 4]; 2];
    for k in 0..=RADIUS {
        out[k / 4][k % 4] = (value(k) / sum) as f32;
    }
    out
}

/// Colors and mask of each pixel in 32 bits.
fn packed(view: &TrainingView) -> Vec<u32> {
    let pixels = view.rgb.as_chunks::<3>().0.iter().enumerate();
    pixels
        .map(|(pixel, [red, green, blue])| {
            let valid = view.mask.get(pixel).copied().unwrap_or(true);
            u32::from_le_bytes([*red, *green, *blue, if valid { 255 } else { 0 }])
        })
        .collect()
}

/// Planes of depth and sigma; depths of 0 are unknown.
fn depths(view: &TrainingView) -> Vec<f32> {
    let both = view.depth_m.iter().zip(&view.depth_sigma_m);
    let known = both.map(|(d, sigma)| match d.is_finite() && sigma.is_finite() {
        true => *d,
        false => 0.0,
    });
    let mut out: Vec<f32> = known.collect();
    let finite = |sigma: &f32| if sigma.is_finite() { *sigma } else { 0.0 };
    out.extend(view.depth_sigma_m.iter().map(finite));
    out
}
