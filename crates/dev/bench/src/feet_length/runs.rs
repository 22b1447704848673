//! Walks and the costs of the stages on them.

use serde::{Deserialize, Serialize};

use super::map_size::MapSize;
use super::stage_run::StageCost;

/// Sources of what the stages read.
pub(super) const PLAIN: &str = "plain data";
pub(super) const IMAGES: &str = "images";

/// Costs of a walk of some length.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Run {
    pub(super) source: String,
    pub(super) minutes: u32,
    pub(super) keyframes: usize,
    pub(super) detections: usize,
    pub(super) stages: Vec<StageCost>,
    pub(super) map: MapSize,
}

impl Run {
    pub(super) fn stage(&self, name: &str) -> Option<&StageCost> {
        self.stages.iter().find(|own| own.stage == name)
    }

    pub(super) fn print(&self) {
        let stages = self.stages.iter().map(|own| {
            format!(
                "{} {:.2} s CPU, {:.2} s, {:.0} MB",
                own.stage, own.cpu_s, own.wall_s, own.peak_mb
            )
        });
        println!(
            "{} min of {}: {} keyframes, {} detections; {}; map {:.0} m2, {} blocks, {:.0} MB",
            self.minutes,
            self.source,
            self.keyframes,
            self.detections,
            stages.collect::<Vec<_>>().join("; "),
            self.map.area_m2,
            self.map.blocks,
            self.map.blocks_mb
        );
    }
}
