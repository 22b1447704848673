//! What a stop waits for, and for how long.

use session_archive::time::{HostTime, NS_PER_S};

use crate::hub::Outgoing;

/// Time that a stop waits for streams of which nothing is being encoded or queued, ns.
pub const STOP_LIMIT_NS: i64 = 250_000_000;
/// Maximum time that a stop waits for samples that are being encoded or queued, ns.
pub const MAX_STOP_NS: i64 = 20 * NS_PER_S;

/// Time that decides whether an item belongs before or after a stop.
pub(super) fn item_time(item: &Outgoing) -> Option<HostTime> {
    match item {
        Outgoing::Frame { frame, .. } => Some(HostTime(frame.time)),
        Outgoing::Imu { batch, .. } => batch.times.first().map(|t| HostTime(*t)),
        Outgoing::Dropped { at, .. } => Some(*at),
        _ => None,
    }
}
