//! Samples that may be the beginning of a new epoch.

use super::epoch::{Epoch, Sample};

/// Samples that may be the beginning of a new epoch.
#[derive(Clone, Debug)]
pub(super) enum Suspicion {
    /// Consecutive late arrivals: a burst, or the device clock stepped back.
    Late { next: Box<Epoch>, since: i64 },
    /// Samples that arrived before they could have been sent: the device clock stepped forward, or
    /// a tick is wrong, or the minimum latency had not been observed yet.
    Early { early_samples: Vec<Early> },
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Early {
    pub(super) sample: Sample,
    pub(super) height: f64,
    pub(super) low: bool,
}
