//! One camera of the hub, and its alarms.

use session_archive::time::HostTime;

use super::frame_decimator::FrameDecimator;
use super::outgoing::{Out, alarm};
use super::setup::CameraSetup;
use super::stream_clock::StreamClock;
use super::stream_monitor::StreamMonitor;
use crate::encode::CameraEncoder;
use crate::sync::renumber::Renumber;

/// One camera.
pub(super) struct CameraState {
    pub(super) setup: CameraSetup,
    pub(super) encoder: CameraEncoder,
    pub(super) numbers: Renumber,
    pub(super) clock: StreamClock,
    pub(super) monitor: StreamMonitor,
    /// Position of its IMU among all IMUs.
    pub(super) imu: Option<usize>,
    /// Position of the first camera that exposes simultaneously with it; both use its decimator.
    pub(super) together_with: usize,
    pub(super) decimator: FrameDecimator,
    pub(super) digest: Option<u64>,
    /// Arrival of the newest frame whose image differed from the previous one.
    pub(super) changed: HostTime,
    pub(super) frozen_alarm: bool,
    pub(super) encoder_alarm: bool,
    /// Text of the active disconnect alarm.
    pub(super) disconnect_alarm: Option<String>,
}

impl CameraState {
    pub(super) fn note_frozen(&mut self, frozen: bool, at: HostTime, out: &Out) {
        if !frozen {
            self.changed = at;
        }
        let alarm = self.monitor.is_too_long(at.since(self.changed));
        if alarm != self.frozen_alarm {
            self.frozen_alarm = alarm;
            self.alarm("the image is frozen", alarm, at, out);
        }
    }

    pub(super) fn note_return(&mut self, at: HostTime, out: &Out) {
        if let Some(what) = self.disconnect_alarm.take() {
            self.alarm(&what, false, at, out);
        }
    }

    pub(super) fn note_encoder(&mut self, at: HostTime, out: &Out) {
        let alarm = self.encoder.is_failing();
        if alarm != self.encoder_alarm {
            self.encoder_alarm = alarm;
            self.alarm("the encoder fails and is started again", alarm, at, out);
        }
    }

    pub(super) fn alarm(&self, what: &str, active: bool, at: HostTime, out: &Out) {
        alarm(&self.setup.name, what, active, at, out);
    }
}
