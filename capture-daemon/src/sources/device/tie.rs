//! Ties the clocks of a camera and its IMU.

use session_archive::time::HostTime;
use zed::report::Sample;

use crate::sources::FrameSync;

/// Collects what both sides say.
#[derive(Debug, Default)]
pub(super) struct Ties {}

impl Ties {
    pub(super) fn frame(&mut self, _: u32, _: HostTime, _: HostTime) -> Option<FrameSync> {
        None
    }
    pub(super) fn imu(&mut self, _: &Sample, _: HostTime) {}
    pub(super) fn camera_restarted(&mut self) {}
    pub(super) fn imu_restarted(&mut self) {}
}
