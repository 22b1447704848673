//! Scenes of 3D Gaussians on the GPU: rendering, gradients and training steps, through Vulkan,
//! Metal or DirectX 12.
//!
//! - [`Gpu`] is the device; software that computes on the processor is used only on request.
//! - [`GpuScene`] is a scene in its memory.
//! - [`GpuRenderer::render`] gives the image of [`splats::Renderer`], [`GpuRenderer::backward`] its
//!   gradients.
//! - [`GpuTrainer`] runs the steps of a [`splats::Trainer`], without a read-back between them.
//!
//! Contract: the results of `splats`, which has the formulas and the constants, up to rounding.
//! Sums have a fixed order and no floating-point number is added atomically, so that the same input
//! gives the same bytes on the same device. A device that is lost or has no memory left is an
//! error, never a panic. The kernels were executed on lavapipe only, never on a GPU: nothing is
//! known about their speed there.
//!
//! Stages, each a file in `shaders/`: `project` (projection), `sort` and `scan` (order by depth,
//! then pairs by tile), `bins` and `tiles` (lists of Gaussians per tile), `blend` (image); backward
//! `pixels`, `slots` (sums of each pair), `texels` (sky), `transform` (parameters), `totals`; in a
//! training `loss` before and `adam` after them.
//!
//! ```
//! use cad_transforms::RigidTransform;
//! use camera_models::{CameraModel, Distortion};
//! use splats::{Background, Camera, Exposure, ImageGradient, Plane, RenderConfig, Scene};
//! use splats::{Splat, Splats};
//! use splats_gpu::{Adapters, Gpu, GpuRenderer, GpuScene};
//!
//! let gpu = match Gpu::open(Adapters::SoftwareToo) {
//!     Ok(gpu) => gpu,
//!     Err(error) => {
//!         eprintln!("skipped: {error}");
//!         return Ok(());
//!     }
//! };
//! let mut splats = Splats::empty(0)?;
//! splats.push(&Splat { position_m: [0.0, 0.0, 2.0], ..Splat::sphere(0.2, [0.5; 3]) })?;
//! let scene = Scene { splats, background: Background::Constant([0.0; 3]) };
//! let model = CameraModel::new((32, 32), [30.0, 30.0, 16.0, 16.0], Distortion::None);
//! let camera = Camera::new(model, RigidTransform::identity())?;
//!
//! let mut renderer = GpuRenderer::new(&gpu, RenderConfig::default())?;
//! let on_device = GpuScene::new(&gpu, &scene)?;
//! let image = renderer.render(&on_device, &camera, &Exposure::NONE)?;
//! assert!((image.expected_depth_m[16 * 32 + 16] - 2.0).abs() < 1e-5);
//!
//! // The sum of all red values grows with opacity.
//! let mut gradient = ImageGradient::default();
//! gradient.rgb = [vec![1.0; 1024], vec![0.0; 1024], vec![0.0; 1024]];
//! let gradients = renderer.backward(&on_device, &camera, &Exposure::NONE, &gradient)?;
//! assert!(gradients.planes[Plane::OPACITY][0] > 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod adam;
mod backward;
mod device;
mod error;
mod forward;
mod frame;
mod gradients;
mod kernel;
mod loss;
mod memory;
mod scene;
mod shaders;
mod sort;
mod trainer;
mod view;

pub use device::{Adapters, Gpu};
pub use error::GpuError;
pub use forward::GpuRenderer;
pub use loss::Losses;
pub use scene::GpuScene;
pub use trainer::GpuTrainer;
