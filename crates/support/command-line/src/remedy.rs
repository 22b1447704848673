//! Remedies for a rig without intrinsics or extrinsics: command lines, the same in every program
//! that prints them.
//!
//! `BOARDS` stands for a session in which boards were recorded, `SESSION` and `SCENE` for input and
//! output of the reconstruction; docs/guides/calibration.md describes the whole procedure.

/// Calibrates intrinsics and extrinsics from boards alone; writes `rig.toml` and a `NAME.yaml` for
/// each camera.
pub const CALIBRATE: &str = "paws calib cameras BOARDS --target board.toml --out calibration";

/// Calibrates IMU extrinsics with the result of [`CALIBRATE`]; writes `rig-imu.toml`.
pub const CALIBRATE_IMUS: &str =
    "paws calib camera-imu BOARDS --target board.toml --calibration calibration --out calibration";

/// Reconstructs a session of the library that was recorded and handed over without calibration.
pub const RECONSTRUCT: &str = "paws reconstruct run SESSION --calibration calibration --out SCENE";

/// Remedy for a camera without intrinsics before a recording.
///
/// ```
/// let text = command_line::remedy::before_recording("feet");
/// assert!(text.contains("`paws calib cameras BOARDS --target board.toml --out calibration`"));
/// assert!(text.contains("calibration = \"calibration/feet.yaml\""));
/// ```
pub fn before_recording(camera: &str) -> String {
    format!(
        "record a board (BOARDS), then `{CALIBRATE}`, then calibration = \"calibration/{camera}.yaml\" in its [[camera]]"
    )
}

/// Remedy for a session that was recorded without intrinsics or extrinsics.
pub fn after_recording() -> String {
    format!("record a board (BOARDS), then `{CALIBRATE}`, then `{RECONSTRUCT}`")
}

/// Warning that the intrinsics of these cameras are unknown, with its remedy; `None` for no
/// cameras.
pub fn missing_intrinsics(cameras: &[&str]) -> Option<String> {
    if cameras.is_empty() {
        return None;
    }
    Some(format!(
        "the lenses of {} are not known, so the recording cannot be reconstructed by itself; remedy, also later: {}",
        cameras.join(", "),
        after_recording()
    ))
}
