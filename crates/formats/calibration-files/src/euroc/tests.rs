use super::*;
use crate::files::Disk;
use crate::read_stereo;
use crate::test_data::{Folder, shared};

/// The reader on files on disk.
fn read(path: &Path, width: u32, height: u32) -> PairResult {
    super::read_pair(&Disk, path, [width, height])
}

/// Body frame of these synthetic files: the left camera rotated so that the body's x is along its
/// z.
const LEFT: &str = "%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [0.0, 0.0, 1.0, 0.1,\n         \
                    -1.0, 0.0, 0.0, 0.05,\n         0.0, -1.0, 0.0, 0.0,\n         0.0, 0.0, 0.0, 1.0]\nrate_hz: 20\n\
                    resolution: [640, 480]\ncamera_model: pinhole\nintrinsics: [400.0, 401.0, 320.0, 240.0] #fu\n\
                    distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 1.7e-05]\n";

const IMU: &str = "sensor_type: imu\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1.0, 0.0, 0.0, 0.0,\n         \
                   0.0, 1.0, 0.0, 0.0,\n         0.0, 0.0, 1.0, 0.02,\n         0.0, 0.0, 0.0, 1.0]\nrate_hz: 200\n";

/// 10 cm to the right of the left camera: along the body's -y.
fn right() -> String {
    LEFT.replace("0.05", "-0.05")
}

fn folder(left: &str, right: &str, imu: Option<&str>) -> Folder {
    let folder = Folder::new();
    folder.file("mav0/cam0/sensor.yaml", left);
    folder.file("mav0/cam1/sensor.yaml", right);
    imu.map(|imu| folder.file("mav0/imu0/sensor.yaml", imu));
    folder
}

#[test]
fn the_real_sequence() {
    let Some(path) = shared("03_stereo_imu/euroc_V1_01_micro") else {
        return;
    };
    let (calibration, notes) = read_stereo(&path, 752, 480).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    assert_eq!(
        calibration.left.k_matrix(),
        [458.654, 0.0, 367.215, 0.0, 457.296, 248.375, 0.0, 0.0, 1.0]
    );
    assert_eq!(
        calibration.right.distortion,
        Distortion::RadTan4 {
            k1: -0.28368365,
            k2: 0.07451284,
            p1: -0.00010473,
            p2: -3.55590700e-05
        }
    );
    // The VI-Sensor's stereo baseline is 11 cm, its cameras nearly parallel.
    assert!(
        (calibration.baseline_m() - 0.110_078).abs() < 1e-6,
        "{}",
        calibration.baseline_m()
    );
    let [x, y, z] = calibration.right_from_left.translation_m();
    assert!(x < -0.109 && y.abs() < 0.002 && z.abs() < 0.002);
    assert!(calibration.right_from_left.angle_rad() < 0.02);
    assert!(!calibration.is_rectified());

    // T_BS of the IMU is the identity, so imu_from_left is body_from_left: its printed digits come
    // back.
    let imu = calibration.imu.unwrap();
    assert_eq!(
        imu.imu_from_left.translation_m(),
        [-0.0216401454975, -0.064676986768, 0.00981073058949]
    );
    let rows = imu.imu_from_left.rotation_rows();
    assert!((rows[1] - -0.999880929698).abs() < 1e-11 && (rows[3] - 0.999557249008).abs() < 1e-11);
    assert_eq!(imu.rate_hz, 200.0);
    let noise = imu.noise.unwrap();
    assert_eq!(
        (noise.gyro_noise_density, noise.gyro_random_walk),
        (1.6968e-04, 1.9393e-05)
    );
    assert_eq!(
        (noise.accel_noise_density, noise.accel_random_walk),
        (2.0e-3, 3.0e-3)
    );
    assert_eq!(calibration.provenance.files.len(), 3);

    let error = read_stereo(&path, 376, 240).unwrap_err().to_string();
    assert!(
        error.contains("images of 376x240: found 752x480"),
        "{error}"
    );
}

#[test]
fn directions_and_forms() {
    let folder = folder(LEFT, &right(), Some(IMU));
    let (calibration, notes) = read(&folder.path().join("mav0"), 640, 480).unwrap();
    let close = |found: [f64; 3], expected: [f64; 3]| {
        assert!(
            found
                .iter()
                .zip(expected)
                .all(|(f, e)| (f - e).abs() < 1e-15),
            "{found:?} {expected:?}"
        );
    };
    // A point 1 m in front of the left camera is 10 cm to the left in the right one.
    close(
        calibration.right_from_left.apply([0.0, 0.0, 1.0]),
        [-0.1, 0.0, 1.0],
    );
    // The same point in the IMU's frame: body x ahead, and the IMU 2 cm above the body's origin.
    close(
        calibration
            .imu
            .unwrap()
            .imu_from_left
            .apply([0.0, 0.0, 1.0]),
        [1.1, 0.05, -0.02],
    );
    assert_eq!(
        notes,
        [Note("imu0/sensor.yaml has no noise densities".to_owned())]
    );

    let by_file = read_stereo(&folder.path().join("mav0/cam1/sensor.yaml"), 640, 480).unwrap();
    let by_folder = read_stereo(folder.path(), 640, 480).unwrap();
    assert_eq!((by_file.0, by_folder.0), (calibration.clone(), calibration));
}

#[test]
fn models_and_an_absent_imu() {
    let fisheye = |text: &str| text.replace("radial-tangential", "equidistant");
    let no_imu = folder(&fisheye(LEFT), &fisheye(&right()), None);
    let (calibration, notes) = read_stereo(no_imu.path(), 640, 480).unwrap();
    assert_eq!(
        calibration.left.distortion,
        Distortion::KannalaBrandt4 {
            k1: -0.28,
            k2: 0.07,
            k3: 0.0002,
            k4: 1.7e-05
        }
    );
    assert_eq!(calibration.imu, None);
    assert!(notes[0].0.contains("no imu0"), "{notes:?}");

    let none = |text: &str| {
        text.replace("radial-tangential", "none")
            .replace("distortion_coefficients", "unused")
    };
    let rectified = folder(&none(LEFT), &none(&right()), None);
    assert!(
        read_stereo(rectified.path(), 640, 480)
            .unwrap()
            .0
            .is_rectified()
    );
}

#[test]
fn invalid_files_are_rejected() {
    let check = |left: String, right: &str, imu: Option<&str>, expected: &str| {
        let folder = folder(&left, right, imu);
        let error = read_stereo(folder.path(), 640, 480)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(expected),
            "found {error:?}, expected {expected:?}"
        );
    };
    let right = right();
    let change = |from: &str, to: &str| {
        assert!(LEFT.contains(from));
        LEFT.replace(from, to)
    };
    check(
        change("0.0, 0.0, 1.0, 0.1", "0.0, 0.0, 1.1, 0.1"),
        &right,
        None,
        "line 6: found a T_BS where the rotation",
    );
    check(
        change("0.0, 0.0, 1.0, 0.1", "0.0, 0.0, -1.0, 0.1"),
        &right,
        None,
        "left-handed",
    );
    check(
        change("0.0, 0.0, 0.0, 1.0]", "0.1, 0.05, 0.0, 1.0]"),
        &right,
        None,
        "last row of the 4x4 matrix",
    );
    check(
        change("0.05,", "0.05"),
        &right,
        None,
        "line 7: found \"-1.0, 0.0, 0.0, 0.05\", expected a comma",
    );
    check(change("0.05,", "0,05,"), &right, None, "17 numbers");
    check(
        change("camera_model: pinhole", "camera_model: omni"),
        &right,
        None,
        "expected camera_model to be pinhole",
    );
    check(
        change("radial-tangential", "brown"),
        &right,
        None,
        "found \"brown\", expected distortion_model to be",
    );
    check(
        change(", 1.7e-05]", "]"),
        &right,
        None,
        "found 3 numbers, expected distortion_coefficients with 4",
    );
    check(
        change("intrinsics", "intrinsic"),
        &right,
        None,
        "intrinsics is missing, found sensor_type",
    );
    check(
        LEFT.to_owned(),
        IMU,
        None,
        "found \"imu\", expected sensor_type to be camera",
    );
    check(right.clone(), LEFT, None, "are left and right swapped?");
    let far_right = right.replace("-0.05,", "-100,");
    check(
        LEFT.to_owned(),
        &far_right,
        None,
        "cam1 is 100.05 m from the first camera",
    );
    let far = IMU.replace("0.02", "20");
    check(LEFT.to_owned(), &right, Some(&far), "the IMU is 20.00");
    check(
        LEFT.to_owned(),
        &right,
        Some(&IMU.replace("200", "0")),
        "line 9: found \"0\", expected a number above 0 as rate_hz",
    );
    let half_noise = format!("{IMU}gyroscope_noise_density: 1e-4\n");
    check(
        LEFT.to_owned(),
        &right,
        Some(&half_noise),
        "gyroscope_random_walk is missing",
    );

    let one_eyed = Folder::new();
    one_eyed.file("cam0/sensor.yaml", LEFT);
    let error = read_stereo(one_eyed.path(), 640, 480)
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("reading a calibration file: ") && error.ends_with("cam1/sensor.yaml"),
        "{error}"
    );
}
