//! One IMU of the hub, its open batch and its alarms.

use session_archive::record::ImuBatch;
use session_archive::time::HostTime;

use super::outgoing::{Out, Outgoing, alarm};
use super::setup::ImuSetup;
use super::stream_clock::StreamClock;
use super::stream_monitor::StreamMonitor;
use crate::sources::FrameSync;
use crate::sync::renumber::Renumber;

/// Maximum time span of an IMU batch, ns.
pub(super) const MAX_BATCH_NS: i64 = 100_000_000;

/// One IMU.
pub(super) struct ImuState {
    pub(super) position: usize,
    pub(super) setup: ImuSetup,
    pub(super) numbers: Renumber,
    pub(super) clock: StreamClock,
    pub(super) monitor: StreamMonitor,
    pub(super) batch: ImuBatch,
    pub(super) batch_since: HostTime,
    /// Text of the active disconnect alarm.
    pub(super) disconnect_alarm: Option<String>,
    /// Clock relation to its camera, and by how much its times are later, ns.
    pub(super) frame_sync: Option<(FrameSync, i64)>,
}

impl ImuState {
    pub(super) fn note_return(&mut self, at: HostTime, out: &Out) {
        if let Some(what) = self.disconnect_alarm.take() {
            self.alarm(&what, false, at, out);
        }
    }

    pub(super) fn alarm(&self, what: &str, active: bool, at: HostTime, out: &Out) {
        alarm(&self.setup.name, what, active, at, out);
    }
}

/// Delivers the open batch and leaves it empty.
pub(super) fn flush(imu: &mut ImuState, out: &Out) {
    let batch = std::mem::take(&mut imu.batch);
    if batch.times.is_empty() {
        return;
    }
    out(Outgoing::Imu {
        imu: imu.position,
        batch,
    });
}
