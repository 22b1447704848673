mod config;
mod loss;
mod view;
pub use config::{
    ExposureConfig, GrowthConfig, LossConfig, OptimizerConfig, PoseConfig, Preset, TrainConfig,
};
pub use view::TrainingView;
