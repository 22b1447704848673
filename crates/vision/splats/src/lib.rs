//! Scenes of 3D Gaussians.
#![allow(
    clippy::needless_range_loop,
    reason = "formulas of vectors and matrices use the same index in several arrays"
)]

mod camera;
mod config;
mod error;
pub mod files;
mod harmonics;
mod lanes;
pub mod reference;
mod render;
mod scene;
mod train;

pub use camera::{Camera, Shutter};
pub use config::RenderConfig;
pub use error::SplatError;
pub use lanes::Level;
pub use render::{Gradients, Image, ImageGradient, Pass, RenderStats, Renderer};
pub use scene::{Background, Exposure, MAX_DEGREE, Plane, Scene, Sky, Splat, Splats, coefficients};
pub use train::{
    Evaluation, ExposureConfig, GrowthCheck, GrowthConfig, LossConfig, OptimizerConfig, PoseConfig,
    Preset, StartPoint, StepReport, TrainConfig, TrainReport, Trainer, TrainingView, psnr_db,
    splats_from_points, train,
};
