//! The running encoder of a camera.

use std::sync::Arc;

use video::Encoder;
use video::encoder::Preset;

use super::delivery::EncoderShared;

/// Running time after which a failure counts as the first one again.
pub(super) const FAILURE_RESET_NS: i64 = 10_000_000_000;

/// The encoder that runs.
pub(super) struct Running {
    pub(super) encoder: Encoder,
    pub(super) shared: Arc<EncoderShared>,
    /// Settings last applied to it.
    pub(super) effort: Effort,
}

/// Settings that may change from one chunk to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Effort {
    pub(super) quality_db: f64,
    pub(super) preset: Preset,
}
