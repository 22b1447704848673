//! Simulators on scene bundles: images and depth at camera poses, agents that walk on the
//! reconstructed ground, episodes for reinforcement learning.
//!
//! World frame z up, bodies x forward, y left, z up; metres, radians, seconds. The same scene,
//! configuration and seed give the same bits on any number of threads and for any number of
//! environments.

mod agent;
mod alignment;
#[cfg(feature = "rapier")]
mod bodies;
mod camera;
mod confidence;
mod episode;
mod error;
mod geodesic;
mod ground;
mod guide;
mod map_image;
mod randomness;
mod reference_poses;
mod scene;
mod snapshot;
mod support;
pub mod testing;
mod view_judge;
mod world;

pub use agent::{AgentConfig, AgentState, Drive, Footing, Motion, Playback, WearerState, advance};
pub use alignment::{Alignment, AlignmentConfig, AlignmentModel, align_points, align_trajectories};
#[cfg(feature = "rapier")]
pub use bodies::{BodiesConfig, Body, BodyContact, BodyShape, BodyState, RigidBodies};
pub use camera::{
    CameraBatch, CameraConfig, CameraSchedule, CameraView, Capture, DepthKind, ExposureConfig,
    FrameBuffers, FrameQueue, FrameRequest, Frames, NoiseConfig, NoiseKey, Quality, RenderReport,
    ShutterConfig, TimingConfig, VariationConfig, pinhole, scaled_model,
};
pub use confidence::ObservedScene;
pub use episode::{
    EndConfig, EndReason, REWARD_TERMS, RandomizationConfig, RewardConfig, StartConfig, StartMode,
    Task, TaskConfig,
};
pub use error::SimulationError;
pub use geodesic::DistanceField;
pub use ground::{Block, BlockReason, Cover, Ground, Surface};
pub use guide::Guide;
pub use map_image::MapImage;
pub use randomness::{RandomStream, Stream};
pub use reference_poses::{Deviation, DeviationConfig, ReferencePoses};
pub use scene::{
    Area, BeogymConfig, BundleConfig, GaussianSource, GaussianStore, Missing, Place, RecordedView,
    Recording, RecordingCamera, ResidencyConfig, SceneData, Sector, SectorEdge, SectorGaussians,
    Similarity,
};
pub use snapshot::MAX_SNAPSHOT_BYTES;
pub use support::{SupportConfig, SupportGrid, SupportNode};
pub use view_judge::ViewJudge;
pub use world::{ObservationConfig, ObservationField, StepResult, World, WorldConfig, block_code};
