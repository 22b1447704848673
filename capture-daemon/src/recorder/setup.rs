//! What the recorder knows of the rig before a recording.

use session_archive::manifest::{Camera, Imu};
use session_archive::record::{CameraCalibration, FrameTransforms};

/// Properties of the rig and the recording that do not change while the daemon runs.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The cameras, as the manifest lists them.
    pub cameras: Vec<Camera>,
    /// The IMUs, as the manifest lists them.
    pub imus: Vec<Imu>,
    /// Calibration per optical frame (`feet/left`).
    pub calibrations: Vec<(String, CameraCalibration)>,
    /// The rig's transforms.
    pub transforms: FrameTransforms,
    /// Files for `rig/`.
    pub rig_files: Vec<(String, Vec<u8>)>,
    /// Chunk length, ns.
    pub chunk_ns: i64,
    /// Pre-roll, ns.
    pub pre_roll_ns: i64,
    /// Recording ends when less than this is free, bytes.
    pub reserve_bytes: u64,
    /// Default name of sessions.
    pub name: String,
    /// Recording software, for the manifest.
    pub software: String,
}

impl Setup {
    /// Deficiencies of its sessions, each with a remedy.
    pub fn notes(&self) -> Vec<String> {
        let has_lens = |eye: String| self.calibrations.iter().any(|(known, _)| *known == eye);
        let cameras = self.cameras.iter().map(|camera| camera.name.as_str());
        let without: Vec<&str> = cameras
            .filter(|name| {
                !["left", "right"]
                    .map(|eye| has_lens(format!("{name}/{eye}")))
                    .iter()
                    .all(|is| *is)
            })
            .collect();
        command_line::remedy::missing_intrinsics(&without)
            .into_iter()
            .collect()
    }
}
