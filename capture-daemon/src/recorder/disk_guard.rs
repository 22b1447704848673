//! Every second: free space, with a warning while little is left and a clean stop at the reserve.

use session_archive::time::HostTime;

use super::Recorder;
use crate::disk::START_MARGIN_BYTES;

/// A warning is raised when less than this can still be recorded, s.
const MIN_SECONDS_LEFT: f64 = 600.0;

pub(super) const DISK_LOW: &str = "disk: less than 10 minutes can still be recorded";

pub(super) const DISK_FULL: &str = "disk: too full to record";

impl Recorder {
    /// Warns when free space runs low or is too little to begin; stops cleanly when it has run out.
    pub(super) fn guard_disk(&mut self, at: HostTime, bytes_per_second: Option<u64>) {
        let Some(free) = self.free_bytes else {
            return;
        };
        let usable = free.saturating_sub(self.setup.reserve_bytes);
        self.seconds_left = bytes_per_second.map(|rate| usable as f64 / rate.max(1) as f64);
        let full = match bytes_per_second {
            Some(_) => usable == 0,
            None => usable < START_MARGIN_BYTES,
        };
        let alarm = match self.seconds_left {
            _ if full => Some(DISK_FULL),
            Some(left) if left < MIN_SECONDS_LEFT => Some(DISK_LOW),
            _ => None,
        };
        if alarm != self.disk_alarm {
            if let Some(over) = std::mem::replace(&mut self.disk_alarm, alarm) {
                self.on_alarm(at, over.to_owned(), "disk", false);
            }
            if let Some(text) = alarm {
                self.on_alarm(at, text.to_owned(), "disk", true);
            }
        }
        if full && self.session.is_some() {
            let _ = self.stop("disk full");
        }
    }
}
