//! Clock relation of a camera and its IMU, fed from both of their threads.

use session_archive::time::{HostTime, NS_PER_S};
use zed::frame_sync::{self, Bounds};
use zed::report::Sample;

use crate::sources::FrameSync;

/// Interval between reported estimates, ns.
const REPORT_INTERVAL_NS: i64 = NS_PER_S;

/// Collects samples and frames of both.
#[derive(Debug)]
pub(crate) struct FrameSyncTracker {
    sync: frame_sync::FrameSync,
    reported: HostTime,
}

impl Default for FrameSyncTracker {
    fn default() -> Self {
        Self {
            sync: frame_sync::FrameSync::new(Bounds::default()),
            reported: HostTime::MIN,
        }
    }
}

impl FrameSyncTracker {
    /// Takes a sample, marked or not.
    pub(crate) fn imu(&mut self, sample: &Sample, arrival: HostTime) {
        self.sync.sample(sample, arrival.0);
    }

    /// Takes a frame; returns the clock relation once a second, if it is known.
    pub(crate) fn frame(
        &mut self,
        sequence: u32,
        stamp: HostTime,
        arrival: HostTime,
    ) -> Option<FrameSync> {
        self.sync.frame(sequence, stamp.0);
        if arrival.since(self.reported) < REPORT_INTERVAL_NS {
            return None;
        }
        let tie = self.sync.estimate().ok()?;
        self.reported = arrival;
        Some(FrameSync {
            host_time: arrival,
            pairs: u32::try_from(tie.pairs).unwrap_or(u32::MAX),
            ticks: i64::try_from(tie.at_ticks).ok()?,
            stamp: HostTime(tie.host_ns),
            sigma_ns: tie.sigma_ns,
            residual_median_ns: tie.residual_median_ns,
            residual_p99_ns: tie.residual_p99_ns,
            count_minus_number: tie.sync_minus_sequence,
        })
    }

    /// Resets the estimate, because one of the devices restarts.
    pub(crate) fn restart(&mut self) {
        *self = Self::default();
    }
}
