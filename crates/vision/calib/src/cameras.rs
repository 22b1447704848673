//! Camera calibration from images of calibration targets: lenses, then each stereo camera, then the
//! whole rig.
//!
//! Contract: [`calibrate`] takes target detections ([`TargetDetection`]) and the nominal values of
//! factory files and the rig file as priors. It returns values with covariances, the lens model
//! that the data support, and [`Finding`]s: everything that makes the result questionable. A result
//! with a finding of severity [`Severity::Fail`] must not be used. Parameters that the views do not
//! constrain keep their prior, with the sigma of the prior; a parameter with neither prior nor
//! observation is an error that names it. The same input gives the same bytes.
//!
//! Steps: selection of static, informative views (`view_selection`); initial lenses
//! (`initialization`); one lens model per stereo camera (`model_selection`); initial poses
//! (`pose_graph`); bundle adjustment ([`crate::adjust`]); board shape (`board_shape`); and gates
//! (`diagnostics`).
//!
//! Frames: the world frame is the target observed most often. A nominal `rig_from_left` is a prior,
//! so that the rig frame moves as little as possible; one without a tolerance is fixed. Without any
//! nominal pose the first camera is the origin: `rig` is at its left lens, x along the view, y to
//! the left, z up in its image ([`Input::origin`]).

mod board_shape;
mod config;
mod coverage;
mod diagnostics;
mod finding;
mod initialization;
mod input;
mod model_selection;
mod pipeline;
mod points;
mod pose_graph;
mod result;
mod target_view;
#[cfg(test)]
mod tests;
mod view_clusters;
mod view_selection;

pub use config::{
    BoardShapeConfig, CheckConfig, Config, CoverageConfig, FactoryPriorConfig,
    InitializationConfig, LensPriorConfig, ModelSelectionConfig, MotionConfig, PoseGraphConfig,
    PriorConfig, ViewConfig,
};
pub use coverage::Coverage;
pub use finding::{Finding, Severity};
pub use input::{Camera, ExtrinsicsPrior, Eye, Input, TargetDetection};
pub use model_selection::{Candidate, Choice};
pub use pipeline::calibrate;
pub use result::{Calibration, CamerasError, RigPoses};
