//! What mends a rig of which lenses or places are not known: command lines, the same in every program that says so.
//!
//! `BOARDS` stands for a session in which boards were shown, `SESSION` and `SCENE` for what is reconstructed;
//! docs/calibration.md has the whole way.

/// Finds lenses and places from boards alone; writes `rig.toml` and a `NAME.yaml` for each camera.
pub const CALIBRATE: &str = "paws calib cameras BOARDS --target board.toml --out calibration";

/// Finds where IMUs sit, with what [`CALIBRATE`] found; writes `rig-imu.toml`.
pub const PLACE_IMUS: &str =
    "paws calib camera-imu BOARDS --target board.toml --calibration calibration --out calibration";

/// Gives lenses and places to a session of the library that was recorded without and handed over.
pub const RECONSTRUCT: &str = "paws reconstruct run SESSION --calibration calibration --out SCENE";

/// What mends a camera without lenses before anything is recorded.
///
/// ```
/// let text = calib::mend::before("feet");
/// assert!(text.contains("`paws calib cameras BOARDS --target board.toml --out calibration`"));
/// assert!(text.contains("calibration = \"calibration/feet.yaml\""));
/// ```
pub fn before(camera: &str) -> String {
    format!(
        "record a board (BOARDS), then `{CALIBRATE}`, then calibration = \"calibration/{camera}.yaml\" in its [[camera]]"
    )
}

/// What mends a session that was recorded without lenses or places.
pub fn after() -> String {
    format!("record a board (BOARDS), then `{CALIBRATE}`, then `{RECONSTRUCT}`")
}

/// That lenses of these cameras are not known, and what mends it; none for no cameras.
pub fn without_lenses(cameras: &[&str]) -> Option<String> {
    if cameras.is_empty() {
        return None;
    }
    Some(format!(
        "the lenses of {} are not known, so what is recorded cannot be reconstructed by itself; to mend it, also later: {}",
        cameras.join(", "),
        after()
    ))
}
