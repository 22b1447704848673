//! Options of `paws calib camera-imu`.

use super::*;

#[test]
fn line_times_by_camera_and_for_all() {
    let options = Options {
        line_us: ["20", "feet=22.6"].map(|t| line_us(t).unwrap()).to_vec(),
        ..Options::default()
    };
    assert!((line_s(&options, "feet") - 22.6e-6).abs() < 1e-15);
    assert!((line_s(&options, "left_shoulder") - 20e-6).abs() < 1e-15);
    for wrong in ["22,6", "feet=", "feet=inf"] {
        let error = line_us(wrong).unwrap_err().to_string();
        assert!(error.contains("expected microseconds"), "{error}");
    }
}
