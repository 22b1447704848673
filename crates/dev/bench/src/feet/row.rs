//! A row of the results.

use serde::{Deserialize, Serialize};

use super::{detections, gait};

/// Results of a walk with a rig, or of several walks.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Row {
    /// Commit and date.
    pub(super) source: String,
    pub(super) rig: String,
    pub(super) walk: String,
    pub(super) is_held_out: bool,
    pub(super) is_day: bool,
    pub(super) tags: Option<detections::Row>,
    pub(super) gait: gait::Row,
}
