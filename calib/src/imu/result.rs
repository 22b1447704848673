//! The result of one IMU.

use calib::imu_noise::Measurement;

use session_input::imu::recording::ImuRecording;

/// The JSON document.
pub(super) const DOCUMENT: &str = "imu-noise.json";

/// An IMU with its estimate.
pub(super) struct ImuResult {
    pub(super) recording: ImuRecording,
    pub(super) found: Measurement,
}

impl ImuResult {
    /// Names of its files, as `feet_imu-…` for `feet/imu`.
    pub(super) fn files(&self) -> [String; 3] {
        files_of(&self.recording.name)
    }
}

/// Kalibr's file and two plots.
pub(super) fn files_of(imu: &str) -> [String; 3] {
    let name = imu.replace('/', "_");
    ["noise.yaml", "gyro.svg", "accel.svg"].map(|end| format!("{name}-{end}"))
}
