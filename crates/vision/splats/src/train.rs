//! Training of a scene from images.
//!
//! [`Trainer`] holds the scene, its optimizer and the views; [`Trainer::step`] renders one view,
//! compares it and corrects what it shows. Splitting and removal of Gaussians happen at fixed steps
//! of a schedule; [`train`] decides by held-out views how many of them the scene needs.

mod adam;
mod codec;
mod config;
mod consistency;
mod evaluate;
mod exposures;
mod fuse;
mod grow;
mod loss;
mod measured;
mod need;
mod poses;
mod schedule;
mod start;
#[cfg(test)]
mod tests;
mod trainer;
mod view;

pub(crate) use codec::{Codec, State, broken};
pub use config::{
    ExposureConfig, GrowthConfig, LossConfig, OptimizerConfig, PoseConfig, Preset, TrainConfig,
};
pub use evaluate::{Evaluation, psnr_db};
pub use grow::GrowthStatistics;
pub use measured::{MAX_VOXELS_PER_POINT, points_from_views};
pub use need::{GrowthByNeed, GrowthCheck, TrainReport, train};
pub use start::{StartConfig, StartPoint, splats_from_points};
pub use trainer::device::{TrainingDevice, TrainingRun, TrainingState, TrainingStep};
pub use trainer::{StepReport, Trainer};
pub use view::TrainingView;
