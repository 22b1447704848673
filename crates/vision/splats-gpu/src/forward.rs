//! Rendering: from the Gaussians to an image.

use splats::{Camera, Exposure, Image, RenderConfig, RenderStats, Renderer};
use wgpu::{CommandEncoder, ComputePass};

use crate::backward::Backward;
use crate::device::Gpu;
use crate::error::GpuError;
use crate::frame::{EncodedFrame, Frame, IMAGE_PLANES, status};
use crate::kernel::Kernel;
use crate::memory::{Download, floats};
use crate::scene::GpuScene;
use crate::shaders::{COMMON, GEOMETRY, HARMONICS, LENS, SKY, SLOPE, THREADS};
use crate::sort::Sorter;
use crate::view::View;

const PROJECT: &str = include_str!("shaders/project.wgsl");
const BINS: &str = include_str!("shaders/bins.wgsl");
const TILES: &str = include_str!("shaders/tiles.wgsl");
const BLEND: &str = include_str!("shaders/blend.wgsl");

/// Pairs that fit at first.
const FIRST_PAIRS: usize = 1 << 14;

/// Renders scenes on the device.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use camera_models::{CameraModel, Distortion};
/// use splats::{Background, Camera, Exposure, RenderConfig, Renderer, Scene, Splat, Splats};
/// use splats_gpu::{Adapters, Gpu, GpuRenderer, GpuScene};
///
/// let gpu = match Gpu::open(Adapters::SoftwareToo) {
///     Ok(gpu) => gpu,
///     Err(error) => {
///         println!("skipped: {error}");
///         return Ok(());
///     }
/// };
/// let mut splats = Splats::empty(0)?;
/// splats.push(&Splat { position_m: [0.0, 0.0, 2.0], ..Splat::sphere(0.2, [1.0, 0.0, 0.0]) })?;
/// let scene = Scene { splats, background: Background::Constant([0.0, 0.0, 1.0]) };
/// let model = CameraModel::new((64, 48), [60.0, 60.0, 32.0, 24.0], Distortion::None);
/// let camera = Camera::new(model, RigidTransform::identity())?;
///
/// let mut renderer = GpuRenderer::new(&gpu, RenderConfig::default())?;
/// let on_device = GpuScene::new(&gpu, &scene)?;
/// let image = renderer.render(&on_device, &camera, &Exposure::NONE)?;
///
/// let expected = Renderer::new(RenderConfig::default())?;
/// let expected = expected.render(&scene, &camera, &Exposure::NONE);
/// for (found, expected) in image.rgb[0].iter().zip(&expected.rgb[0]) {
///     assert!((found - expected).abs() < 1e-4);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct GpuRenderer {
    pub(crate) gpu: Gpu,
    pub(crate) config: RenderConfig,
    kernels: Kernels,
    sorter: Sorter,
    pub(crate) frame: Frame,
    stats: RenderStats,
    /// Made by the first gradients.
    pub(crate) backward: Option<Backward>,
}

#[derive(Debug)]
struct Kernels {
    project: Kernel,
    count_tiles: Kernel,
    list_pairs: Kernel,
    find_tiles: Kernel,
    blend: Kernel,
}

impl GpuRenderer {
    /// # Errors
    /// [`GpuError::Splats`] if a setting is outside of its domain; others of the device.
    pub fn new(gpu: &Gpu, config: RenderConfig) -> Result<Self, GpuError> {
        // The settings have the same domains there.
        Renderer::new(config)?;
        let bins = |name| Kernel::new(gpu, name, &[COMMON, BINS]);
        let kernels = Kernels {
            project: Kernel::new(
                gpu,
                "project",
                &[COMMON, LENS, GEOMETRY, SLOPE, HARMONICS, PROJECT],
            )?,
            count_tiles: bins("count_tiles")?,
            list_pairs: bins("list_pairs")?,
            find_tiles: Kernel::new(gpu, "find_tiles", &[COMMON, TILES])?,
            blend: Kernel::new(gpu, "blend", &[COMMON, SKY, BLEND])?,
        };
        let lengths = [status::SPLATS as u32, status::PAIRS as u32];
        Ok(Self {
            kernels,
            sorter: Sorter::new(gpu, &lengths)?,
            frame: Frame::new(gpu)?,
            gpu: gpu.clone(),
            config,
            stats: RenderStats::default(),
            backward: None,
        })
    }

    /// Renders an image.
    ///
    /// # Errors
    /// [`GpuError`] of the device.
    pub fn render(
        &mut self,
        scene: &GpuScene,
        camera: &Camera,
        exposure: &Exposure,
    ) -> Result<Image, GpuError> {
        let gpu = self.gpu.clone();
        loop {
            let mut encoder = encoder(&gpu);
            let encoded = self.encode(&mut encoder, scene, camera, exposure)?;
            let pixels = encoded.view.pixels();
            let from = [
                (&self.frame.status, status::LEN),
                (&self.frame.image, IMAGE_PLANES * pixels),
            ];
            let download = Download::new(&gpu, &mut encoder, &from)?;
            submit(&gpu, "rendering", encoder)?;
            let found = download.read(&gpu)?;
            if self.fits(&found[0])? {
                return Ok(image(&encoded.view, &floats(&found[1])));
            }
        }
    }

    /// Work that the last image needed.
    pub fn stats(&self) -> RenderStats {
        self.stats
    }

    /// Whether all pairs of the images since the last call fitted; makes room if not.
    pub(crate) fn fits(&mut self, of: &[u32]) -> Result<bool, GpuError> {
        self.stats = RenderStats {
            visible: of[status::VISIBLE] as usize,
            degenerate: of[status::DEGENERATE] as usize,
            pairs: of[status::ALL_PAIRS] as usize,
        };
        if of[status::OVERFLOW] == 0 {
            return Ok(true);
        }
        let most = of[status::MOST_PAIRS] as usize;
        self.reserve_pairs(most + most / 2)?;
        self.frame.clear_flags(&self.gpu);
        Ok(false)
    }

    fn reserve_pairs(&mut self, pairs: usize) -> Result<(), GpuError> {
        self.frame.by_tile.reserve(&self.gpu, pairs)?;
        self.frame.splat_of_pair.reserve(&self.gpu, pairs)?;
        self.sorter.reserve(&self.gpu, pairs)
    }

    /// Encodes the work of an image.
    pub(crate) fn encode(
        &mut self,
        encoder: &mut CommandEncoder,
        scene: &GpuScene,
        camera: &Camera,
        exposure: &Exposure,
    ) -> Result<EncodedFrame, GpuError> {
        let gpu = self.gpu.clone();
        let mut view = View::new(camera, exposure, &self.config);
        if self.frame.by_tile.len() < FIRST_PAIRS {
            self.reserve_pairs(FIRST_PAIRS)?;
        }
        let capacity = self.frame.by_tile.len();
        view.counts = [scene.splats, scene.degree, capacity, scene.sky].map(|v| v as u32);
        self.sorter.reserve(&gpu, scene.splats)?;
        self.frame.reserve(&gpu, scene, camera, &view)?;
        self.frame.view.write(&gpu, &view);
        let mut of_image = [0_u32; status::OF_IMAGE];
        of_image[status::SPLATS] = scene.splats as u32;
        self.frame.status.write(&gpu, 0, &of_image);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        Ok(self.encode_passes(&mut pass, scene, view))
    }

    fn encode_passes(
        &self,
        pass: &mut ComputePass<'_>,
        scene: &GpuScene,
        view: View,
    ) -> EncodedFrame {
        let (gpu, f, k) = (&self.gpu, &self.frame, &self.kernels);
        let groups = |threads: usize| [threads.div_ceil(THREADS) as u32, 1];
        let splats = scene.splats;
        let uniform = (0, f.view.buffer());
        let project = [
            uniform,
            (1, scene.planes.buffer()),
            (2, f.footprints.buffer()),
            (3, f.by_depth.keys[0].buffer()),
            (4, f.by_depth.values[0].buffer()),
            (5, f.status.buffer()),
        ];
        k.project.run(gpu, pass, &project, groups(splats));
        let depth = (0, splats, 32);
        let order = self.sorter.sort(gpu, pass, &f.status, &f.by_depth, depth);
        let footprints = (1, f.footprints.buffer());
        let ranks = (2, f.by_depth.values[order].buffer());
        let first_pair = (3, f.first_pair.buffer());
        let count = [uniform, footprints, ranks, first_pair];
        k.count_tiles.run(gpu, pass, &count, groups(splats + 1));
        self.sorter
            .scan(gpu, pass, &f.status, &f.first_pair, splats + 1);
        let list = [
            uniform,
            footprints,
            ranks,
            first_pair,
            (4, f.status.buffer()),
            (5, f.by_tile.keys[0].buffer()),
            (6, f.by_tile.values[0].buffer()),
            (7, f.splat_of_pair.buffer()),
        ];
        k.list_pairs.run(gpu, pass, &list, groups(splats));
        let tiles = view.tiles();
        let bits = usize::BITS - tiles.leading_zeros();
        let capacity = f.by_tile.len();
        let by_tile = (1, capacity, bits);
        let entries = self.sorter.sort(gpu, pass, &f.status, &f.by_tile, by_tile);
        let find = [
            uniform,
            (1, f.status.buffer()),
            (2, f.by_tile.keys[entries].buffer()),
            (3, f.first_entry.buffer()),
        ];
        k.find_tiles.run(gpu, pass, &find, groups(tiles + 1));
        let blend = [
            uniform,
            footprints,
            (2, f.splat_of_pair.buffer()),
            (3, f.by_tile.values[entries].buffer()),
            (4, f.first_entry.buffer()),
            (5, scene.background.buffer()),
            (6, f.rays.buffer()),
            (7, f.image.buffer()),
            (8, f.blended.buffer()),
        ];
        k.blend.run(gpu, pass, &blend, [view.size[2], view.size[3]]);
        EncodedFrame {
            view,
            order,
            entries,
        }
    }
}

pub(crate) fn encoder(gpu: &Gpu) -> CommandEncoder {
    let description = wgpu::CommandEncoderDescriptor::default();
    gpu.device.create_command_encoder(&description)
}

pub(crate) fn submit(
    gpu: &Gpu,
    what: &'static str,
    encoder: CommandEncoder,
) -> Result<(), GpuError> {
    gpu.attempt(what, || {
        gpu.queue.submit([encoder.finish()]);
    })
}

/// Depths of 0 are none.
fn image(view: &View, values: &[f32]) -> Image {
    let pixels = view.pixels();
    let plane = |k: usize| values[k * pixels..(k + 1) * pixels].to_vec();
    let depth = |k: usize| {
        let depths = plane(k).into_iter();
        depths
            .map(|depth| if depth > 0.0 { depth } else { f32::NAN })
            .collect()
    };
    Image {
        width: view.size[0] as usize,
        height: view.size[1] as usize,
        rgb: [plane(0), plane(1), plane(2)],
        expected_depth_m: depth(3),
        median_depth_m: depth(4),
        alpha: plane(5),
    }
}
