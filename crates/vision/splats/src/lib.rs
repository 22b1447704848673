//! Scenes of 3D Gaussians (Kerbl et al., 3D Gaussian Splatting for Real-Time Radiance Field
//! Rendering, 2023): rendering and training on the CPU, and files.
//!
//! - A [`Scene`] is [`Splats`], a structure of arrays, before a [`Background`]. World frame, m.
//! - A [`Camera`] has any lens of `camera-models`, a pose and, with a rolling shutter, a motion.
//!   Pixel coordinates have integer values at pixel centers.
//! - [`Renderer::render`] gives color, expected and median depth and accumulated alpha in one pass,
//!   [`Renderer::backward`] the gradients of a loss with respect to all parameters, the pose, the
//!   [`Exposure`] and the background. [`mod@reference`] is the same in f64, slow and plain.
//! - [`DetailScene`] renders many small images faster, at a price that is stated.
//! - [`Trainer`] fits a scene to [`TrainingView`]s; [`train()`] chooses the number of Gaussians by
//!   held-out views.
//! - [`Coverage`] is what the views of a training saw; with it an image from any camera has a
//!   [`Confidence`].
//! - [`Cells`] divide a long walk into sectors, each of which is trained by itself to a [`Part`].
//! - [`files`] reads and writes `.ply`, `.splat` and `.spz`.
//!
//! The same input gives the same bytes on any number of threads and with every instruction set.
//! Nothing here knows sessions, bundles or paths.
//!
//! ```
//! use cad_transforms::RigidTransform;
//! use camera_models::{CameraModel, Distortion};
//! use splats::{
//!     Background, Camera, Exposure, RenderConfig, Renderer, Scene, StartPoint, files,
//!     splats_from_points,
//! };
//!
//! // A disc 2 m in front of the camera.
//! let disc = StartPoint {
//!     position_m: [0.0, 0.0, 2.0],
//!     normal: Some([0.0, 0.0, -1.0]),
//!     spacing_m: 0.5,
//!     sigma_m: 0.01,
//!     color: [0.9, 0.3, 0.1],
//! };
//! let splats = splats_from_points(&[disc])?;
//! let bytes = files::ply::write(&splats, false);
//! let splats = files::ply::read(&bytes, 1_000_000)?.splats;
//!
//! let scene = Scene { splats, background: Background::Constant([0.0, 0.0, 0.0]) };
//! let model = CameraModel::new((65, 49), [60.0, 60.0, 32.0, 24.0], Distortion::None);
//! let camera = Camera::new(model, RigidTransform::identity())?;
//! let renderer = Renderer::new(RenderConfig::default())?;
//! let image = renderer.render(&scene, &camera, &Exposure::NONE);
//!
//! // Half opaque, so that its color is half there.
//! let middle = 24 * 65 + 32;
//! assert!((image.alpha[middle] - 0.5).abs() < 1e-3);
//! assert!((image.rgb[0][middle] - 0.45).abs() < 1e-3);
//! assert_eq!(image.expected_depth_m[middle], 2.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![allow(
    clippy::needless_range_loop,
    reason = "formulas of vectors and matrices use the same index in several arrays"
)]

mod camera;
mod confidence;
mod config;
mod error;
mod harmonics;
mod lanes;
pub mod reference;
mod render;
mod scene;
mod sectors;
mod train;

pub use camera::{Camera, Shutter};
pub use confidence::{
    Confidence, ConfidenceConfig, Coverage, CoverageConfig, CoverageImage, DIRECTIONS, Directions,
    IMAGE_CHANNELS, ImageMeasureConfig, MeasureConfig, ObservedGaussian, ObservedSky,
    ObservedSpace, SpaceBlock,
};
pub use config::RenderConfig;
pub use error::SplatError;
pub use gaussians::{GaussianError, files};
pub use lanes::Level;
pub use render::{
    DetailConfig, DetailScene, Gradients, Image, ImageGradient, Pass, RenderStats, Renderer,
};
pub use scene::{Background, Exposure, MAX_DEGREE, Plane, Scene, Sky, Splat, Splats, coefficients};
pub use sectors::{CellBox, CellVisibility, Cells, Part, SectorConfig, merged_background};
pub use train::{
    Evaluation, ExposureConfig, GrowthByNeed, GrowthCheck, GrowthConfig, GrowthStatistics,
    LossConfig, MAX_VOXELS_PER_POINT, OptimizerConfig, PoseConfig, Preset, StartConfig, StartPoint,
    StepReport, TrainConfig, TrainReport, Trainer, TrainingDevice, TrainingRun, TrainingState,
    TrainingStep, TrainingView, points_from_views, psnr_db, splats_from_points, train,
};
