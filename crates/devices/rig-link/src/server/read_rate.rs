//! Limit of the read rate while the rig records, to leave the disk to the recorder.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::time::{Instant, sleep};

use crate::rig::{Rig, State};

/// Read rate limit shared by all readers.
pub(super) struct ReadRateLimiter {
    bytes_per_s: u64,
    /// When the next byte is due.
    due: Mutex<Option<Instant>>,
}

impl ReadRateLimiter {
    pub(super) fn new(bytes_per_s: u64) -> Self {
        Self {
            bytes_per_s: bytes_per_s.max(1),
            due: Mutex::new(None),
        }
    }

    /// Waits after reading `bytes` to keep the rate; does not wait unless the rig records.
    pub(super) async fn after(&self, bytes: usize, rig: &dyn Rig) {
        if !matches!(rig.status().state, State::Recording | State::Stopping) {
            return;
        }
        let cost = Duration::from_secs_f64(bytes as f64 / self.bytes_per_s as f64);
        let now = Instant::now();
        let wait = {
            let mut due = self.due.lock().unwrap_or_else(PoisonError::into_inner);
            let next = due.map_or(now, |due| due.max(now)) + cost;
            *due = Some(next);
            next - now
        };
        sleep(wait).await;
    }
}
