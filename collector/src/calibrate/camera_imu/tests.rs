//! What is read before anything is measured.

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

#[test]
fn noise_of_kalibr_names_file_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("imu.yaml");
    let good = "# by us\naccelerometer_noise_density: 1.6e-03 # m/s^2/sqrt(Hz)\naccelerometer_random_walk: 3.0e-05\n\
                gyroscope_noise_density: 1.2e-04\ngyroscope_random_walk: 2e-6\nupdate_rate: 400\n";
    fs::write(&path, good).unwrap();
    assert_eq!(kalibr_noise(&path).unwrap(), ZED_NOISE);
    for (from, to, expected) in [
        (
            "1.2e-04",
            "0,00012",
            "gyroscope_noise_density: found \"0,00012\"",
        ),
        ("1.2e-04", "-1.2e-04", "gyroscope_noise_density: found"),
        (
            "gyroscope_random_walk",
            "# gyroscope_random_walk",
            "gyroscope_random_walk is missing",
        ),
    ] {
        fs::write(&path, good.replace(from, to)).unwrap();
        let error = kalibr_noise(&path).unwrap_err().to_string();
        assert!(
            error.contains(expected) && error.contains("imu.yaml"),
            "{error}"
        );
    }
}

#[test]
fn lenses_of_records() {
    let record = CameraCalibration {
        width: 672,
        height: 376,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![0.1, 0.2, 0.3, 0.4, 0.5],
        k: vec![350.0, 0.0, 330.0, 0.0, 351.0, 180.0, 0.0, 0.0, 1.0],
        ..CameraCalibration::default()
    };
    let lens = model(&record).unwrap();
    assert_eq!(
        [lens.fx, lens.fy, lens.cx, lens.cy],
        [350.0, 351.0, 330.0, 180.0]
    );
    assert_eq!(lens.distortion.coefficients(), record.d);
    let short = CameraCalibration {
        d: vec![0.1; 4],
        ..record
    };
    let error = model(&short).unwrap_err().to_string();
    assert!(error.contains("\"plumb_bob\" with 4 numbers"), "{error}");
}
