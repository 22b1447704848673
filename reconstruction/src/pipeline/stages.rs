//! The stages from a hand-off to a scene bundle, in order.
//!
//! | stage | reads | makes |
//! |---|---|---|
//! | `rig` | hand-off, files given instead | `rig` |
//! | `odometry` | hand-off, `rig` | `trajectory-causal`, `tracks` |
//! | `mapping` | hand-off, `rig`, `trajectory-causal`, `tracks` | `trajectory`, `rig-adjusted` |
//! | `depth` | hand-off, `rig-adjusted`, `trajectory` | `keyframes`, `depth` |
//! | `cloud` | hand-off, `rig-adjusted`, `trajectory`, `keyframes`, `depth` | `cloud`, `masks` |

use super::{Pipeline, PipelineError, Stage};
use crate::input::Input;

mod bundle_adjustment;
mod cloud;
mod depth;
pub mod frame_set_reader;
pub mod networks;
mod odometry;
mod pose_interpolation;
pub mod rig;

/// Names of the stages, in order.
pub const NAMES: [&str; 5] = ["rig", "odometry", "bundle-adjustment", "depth", "cloud"];
/// Name of the hand-off among the sources; its hash is its seal.
pub const HANDOFF: &str = "handoff";

/// How much work is done: points on the curve of error against time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preset {
    /// Least time.
    Fast,
    /// The knee of the curve.
    #[default]
    Balanced,
    /// Least error.
    Accurate,
}

/// What the stages are told.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// How much work is done.
    pub preset: Preset,
    /// What is told of the rig instead of what the session says.
    pub rig_overrides: rig::RigOverrides,
    /// Networks of the user's.
    pub networks: networks::Networks,
}

/// The table.
///
/// # Errors
/// [`PipelineError::Table`].
pub fn pipeline(options: Options) -> Result<Pipeline<Input>, PipelineError> {
    let preset = options.preset;
    let stages: Vec<Box<dyn Stage<Input>>> = vec![
        Box::new(rig::RigStage {
            rig_overrides: options.rig_overrides,
        }),
        Box::new(odometry::OdometryStage { preset }),
        Box::new(bundle_adjustment::BundleAdjustmentStage { preset }),
        Box::new(depth::DepthStage {
            preset,
            networks: options.networks.clone(),
        }),
        Box::new(cloud::CloudStage {
            networks: options.networks,
        }),
    ];
    Pipeline::new(stages, &[HANDOFF])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_good_and_its_names_are_known() {
        let pipeline = pipeline(Options::default()).expect("a good table");
        assert_eq!(pipeline.names(), NAMES);
    }
}
