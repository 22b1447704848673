//! `paws calib cameras` on a rendered session of boards, of a rig that deviates from its nominal
//! calibration: the result is the ground truth within the stated tolerance, and nothing is
//! overwritten.

use std::fs;
use std::path::Path;

use cad_transforms::{Frame, FramePart, Rig, RigidTransform};
use nalgebra::Vector3;
use rig_sim::calibration_error::CalibrationError;
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::Settings;
use serde_json::Value;

use crate::rendered::{self, calib};

/// Writes the session; returns the ground-truth rig.
fn write(folder: &Path) -> Rig {
    let settings = Settings {
        kind: Kind::Targets,
        lighting: Lighting::Day,
        seed: 5,
        seconds: 45.0,
        rate_hz: 5.0,
        width: 672,
        height: 376,
        quality: Quality::FAST,
    };
    let mut deviation = CalibrationError::default();
    deviation.of_mut("left_shoulder").rotation = Vector3::new(2e-3, -3e-3, 1e-3);
    deviation.of_mut("feet").translation = Vector3::new(5e-4, 0.0, -8e-4);
    deviation.of_mut("right_shoulder").focal_px = [1.5, 1.5];
    deviation.of_mut("left_shoulder").imu_rotation = Vector3::new(0.01, -0.02, 0.0);
    rendered::write(folder, &settings, &deviation)
}

#[test]
fn calibration_recovers_the_ground_truth_rig() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("targets");
    let truth = write(&session);
    let out = folder.path().join("out");
    let (session, out_text) = (session.to_str().unwrap(), out.to_str().unwrap());
    let arguments = ["cameras", session, "--keep-model", "--out", out_text];
    let (code, text) = calib(&arguments);
    assert_eq!(code, Some(0), "{text}");

    let found = Rig::read(&out.join("rig.toml")).unwrap();
    assert!(found.provenance().note.contains("paws calib cameras"));
    let left = |camera: &str| Frame::of_camera(camera, FramePart::Left).unwrap();
    let between = |rig: &Rig, a: &Frame, b: &Frame| rig.transform(a, b).unwrap();
    let check = |a: &Frame, b: &Frame, metres: f64, degrees: f64| {
        let off: RigidTransform = between(&truth, a, b).inverse() * between(&found, a, b);
        let (m, d) = (off.distance_m(), off.angle_rad().to_degrees());
        assert!(
            m < metres && d < degrees,
            "{a} {b}: {m} m, {d} degrees\n{text}"
        );
    };
    // Fewer views than a real recording, at half its rate; full ones are in the benchmark.
    for camera in ["left_shoulder", "right_shoulder", "feet"] {
        let right = Frame::of_camera(camera, FramePart::Right).unwrap();
        check(&left(camera), &right, 1e-3, 0.05);
        check(&left("feet"), &left(camera), 1e-3, 0.05);
    }
    let document: Value =
        serde_json::from_slice(&fs::read(out.join("cameras.json")).unwrap()).unwrap();
    for eye in document["eyes"].as_array().unwrap() {
        let rms = eye["rms_px"].as_f64().unwrap();
        assert!(rms < 0.25, "{}: {rms}", eye["name"]);
    }
    let page = fs::read_to_string(out.join("cameras.html")).unwrap();
    assert!(page.contains("left_shoulder/right in left_shoulder/left") && page.contains("<svg"));
    // The cameras' files are valid calibrations.
    let (stereo, _) = calibration_files::read_stereo(&out.join("feet.yaml"), 672, 376).unwrap();
    assert!((stereo.baseline_m() - 0.063).abs() < 5e-4);

    imus_are_found(&folder.path().join("imus"), session, &out, &truth);

    let before = fs::read(out.join("rig.toml")).unwrap();
    let (code, text) = calib(&arguments);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("exists already"), "{text}");
    assert_eq!(fs::read(out.join("rig.toml")).unwrap(), before);

    // A board that was not shown.
    let board = folder.path().join("other.toml");
    fs::write(
        &board,
        "kind = \"chessboard\"\ncolumns = 9\nrows = 6\nsquare_m = 0.05\n",
    )
    .unwrap();
    let other = folder.path().join("other");
    let (code, text) = calib(&[
        "cameras",
        session,
        "--target",
        board.to_str().unwrap(),
        "--out",
        other.to_str().unwrap(),
    ]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("none of 1 target was detected"), "{text}");
    assert!(!other.exists());
}

/// `paws calib camera-imu` with the results of `paws calib cameras`: its rig file has the cameras
/// from there and the ground-truth IMUs.
fn imus_are_found(out: &Path, session: &str, calibration: &Path, truth: &Rig) {
    let (code, text) = calib(&[
        "camera-imu",
        session,
        "--calibration",
        calibration.to_str().unwrap(),
        "--line-us",
        "feet=22.606",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(code, Some(0), "{text}");
    let given = Rig::read(&calibration.join("rig.toml")).unwrap();
    let found = Rig::read(&out.join("rig-imu.toml")).unwrap();
    assert_eq!(found.revision(), format!("{}-imu", given.revision()));
    for camera in ["left_shoulder", "right_shoulder", "feet"] {
        let [left, right, imu] = [FramePart::Left, FramePart::Right, FramePart::Imu]
            .map(|part| Frame::of_camera(camera, part).unwrap());
        let imu_in = |rig: &Rig| rig.transform(&left, &imu).unwrap();
        let off = imu_in(truth).inverse() * imu_in(&found);
        let (m, d) = (off.distance_m(), off.angle_rad().to_degrees());
        assert!(m < 2e-3 && d < 0.2, "{camera}: {m} m, {d} degrees\n{text}");
        let sigmas = found.covariance(&left, &imu).unwrap().unwrap().sigmas();
        assert!(
            sigmas.iter().all(|s| (1e-5..3e-3).contains(s)),
            "{sigmas:?}"
        );
        for (a, b) in [(&Frame::rig(), &left), (&left, &right)] {
            let between = |rig: &Rig| rig.transform(a, b).unwrap();
            assert_eq!(between(&found), between(&given));
        }
    }
    // A folder that holds no calibration.
    let (code, text) = calib(&[
        "camera-imu",
        session,
        "--calibration",
        session,
        "--out",
        out.join("other").to_str().unwrap(),
    ]);
    assert_eq!(code, Some(1), "{text}");
    assert!(
        text.contains("expected what `paws calib cameras` writes"),
        "{text}"
    );
}
