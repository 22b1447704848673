//! `paws calib verify` on rendered walks: of a rig as its file states, and of one with a camera
//! that was rotated since.

use std::fs;
use std::path::Path;

use nalgebra::Vector3;
use rig_sim::calibration_error::CalibrationError;
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::Settings;
use serde_json::Value;

use crate::rendered::{self, calib};

/// A short walk in small images, with the left shoulder rotated by this rotation vector, rad.
fn write(folder: &Path, turned: Vector3<f64>) {
    let settings = Settings {
        kind: Kind::Pavement,
        lighting: Lighting::Day,
        seed: 3,
        seconds: 12.0,
        rate_hz: 15.0,
        width: 336,
        height: 188,
        quality: Quality::FAST,
    };
    let mut deviation = CalibrationError::default();
    deviation.of_mut("left_shoulder").rotation = turned;
    rendered::write(folder, &settings, &deviation);
}

/// Exit code, and what was printed.
fn verify(session: &Path, more: &[&str]) -> (Option<i32>, String) {
    calib(&[&["verify", session.to_str().unwrap()], more].concat())
}

#[test]
fn nominal_rig_passes_and_rotated_camera_fails() {
    let folder = tempfile::tempdir().unwrap();
    let [good, turned] = ["good", "turned"].map(|name| folder.path().join(name));
    write(&good, Vector3::zeros());
    let [json, html] = ["v.json", "v.html"].map(|name| folder.path().join(name));
    let files = [
        "--json",
        json.to_str().unwrap(),
        "--html",
        html.to_str().unwrap(),
    ];
    let (code, text) = verify(&good, &files);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("PASS  "), "{text}");
    let report: Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    assert_eq!(report["verdict"], "PASS");
    assert_eq!(report["found"]["cameras"].as_array().unwrap().len(), 3);
    let page = fs::read_to_string(&html).unwrap();
    assert!(page.contains("left_shoulder") && page.contains("<svg"));

    write(&turned, Vector3::new(0.0, 0.04, 0.0));
    let (code, text) = verify(&turned, &[]);
    assert_eq!(code, Some(1), "{text}");
    let expected = "left_shoulder on the plate: rotated by 2.";
    assert!(text.contains(expected), "{text}");
    assert!(text.contains("since revision nominal-1"), "{text}");
}
