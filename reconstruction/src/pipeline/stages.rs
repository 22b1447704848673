//! The stages from a hand-off to a scene bundle, in order.
//!
//! | stage | reads | writes |
//! |---|---|---|
//! | `rig` | hand-off, overrides | `rig` |
//! | `odometry` | hand-off, `rig` | `trajectory-causal`, `trajectory-odom`, `tracks` |
//! | `bundle-adjustment` | hand-off, `rig`, `trajectory-causal`, `trajectory-odom`, `tracks` | `trajectory`, `rig-refined` |
//! | `depth` | hand-off, `rig-refined`, `trajectory` | `keyframes`, `depth` |
//! | `cloud` | hand-off, `rig-refined`, `trajectory`, `keyframes`, `depth` | `cloud`, `masks` |
//! | `tags` | hand-off, `rig-refined`, `trajectory` | `tag-detections` |
//! | `terrain` | `rig-refined`, `trajectory`, `keyframes`, `depth`, `cloud`, `masks`, `tag-detections` | `terrain` |
//! | `feet` | `rig-refined`, `trajectory`, `tag-detections`, `keyframes`, `depth` | `feet`, `contacts` |
//! | `maps` | `terrain`, `contacts`, `rig-refined` | `maps`, `collision` |
//! | `splats` | hand-off, `rig-refined`, `trajectory`, `keyframes`, `depth`, `masks` | `splats` |

use super::{Pipeline, PipelineError, Stage};
use crate::input::Input;

pub use crate::input::HANDOFF;
pub use maps::{map_collision, map_levels};
pub use preset::Preset;

mod bundle_adjustment;
mod cloud;
mod depth;
mod depth_frames;
pub mod device;
#[cfg(test)]
mod down_looking;
pub mod feet;
pub mod frame_set_reader;
mod keyframe_candidates;
mod keyframe_spacing;
mod maps;
pub mod networks;
mod odometry;
mod pose_interpolation;
mod preset;
pub mod rig;
mod rolling_shutter;
pub(crate) mod soles;
pub mod splats;
pub mod tags;
mod terrain;

/// Names of the stages, in order.
pub const NAMES: [&str; 10] = [
    "rig",
    "odometry",
    "bundle-adjustment",
    "depth",
    "cloud",
    "tags",
    "terrain",
    "feet",
    "maps",
    "splats",
];

/// Options of the stages.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Trade-off of error against time.
    pub preset: Preset,
    /// Calibration that overrides that of the session.
    pub rig_overrides: rig::RigOverrides,
    /// The user's networks.
    pub networks: networks::Networks,
    /// Preset of the stage `splats` in place of that of all stages.
    pub splat_preset: Option<Preset>,
    /// Number of training steps of the stage `splats` in place of the preset's.
    pub splat_steps: Option<usize>,
    /// Most images inside of a sector of the stage `splats` in place of 1250.
    pub splat_sector_views: Option<usize>,
    /// Where the stage `splats` trains.
    pub device: device::Device,
    /// Memory that the stage `splats` may use, bytes, where it is known.
    pub memory_bytes: Option<u64>,
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
            networks: options.networks.clone(),
        }),
        Box::new(tags::TagsStage),
        Box::new(terrain::TerrainStage),
        Box::new(feet::FeetStage),
        Box::new(maps::MapsStage),
        Box::new(splats::SplatsStage {
            preset: options.splat_preset.unwrap_or(preset),
            steps: options.splat_steps,
            sector_views: options.splat_sector_views,
            device: options.device,
            networks: options.networks,
            memory_bytes: options.memory_bytes,
        }),
    ];
    Pipeline::new(stages, &[HANDOFF])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_valid_and_its_names_are_known() {
        let pipeline = pipeline(Options::default()).expect("a good table");
        assert_eq!(pipeline.names(), NAMES);
    }
}
