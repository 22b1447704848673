use super::*;
use crate::files::Disk;
use crate::test_data::{Folder, shared};

/// The reader on files on disk.
fn read(path: &Path) -> SetResult {
    super::read(&Disk, path, None)
}

fn text(lens: &str) -> String {
    format!(
        "{{\"value0\": {{\n \"T_imu_cam\": [\n  {{\"px\": 0.05, \"py\": 0, \"pz\": 0, \"qx\": 0, \"qy\": 0, \"qz\": \
         0.7071067811865476, \"qw\": 0.7071067811865476}}],\n \"intrinsics\": [\n  {lens}],\n \"resolution\": [[640, \
         480]],\n \"calib_gyro_bias\": [0.1, 0.2, 0.3, 0, 0, 0, 0, 0, 0, 0, 0, 0.5],\n \"imu_update_rate\": 200,\n \
         \"gyro_noise_std\": [1e-4, 2e-4, 1e-4],\n \"accel_noise_std\": [1e-3, 1e-3, 1e-3],\n \"gyro_bias_std\": \
         [1e-5, 1e-5, 1e-5],\n \"accel_bias_std\": [1e-4, 1e-4, 1e-4],\n \"cam_time_offset_ns\": -2500000\n}}}}\n"
    )
}

const UCM: &str = "{\"camera_type\": \"ucm\", \"intrinsics\": {\"fx\": 300, \"fy\": 300, \"cx\": 320, \"cy\": \
                   240, \"alpha\": 0.6}}";

#[test]
fn frames_order_and_units() {
    let folder = Folder::new();
    let (set, notes) = read(&folder.file("calibration.json", &text(UCM))).unwrap();
    let imu = set.imu.unwrap();
    // qw is last: a quarter turn about z takes the camera's x axis to the IMU's y axis.
    let y = imu.imu_from_first.rotate([1.0, 0.0, 0.0]);
    assert!((y[1] - 1.0).abs() < 1e-12, "{y:?}");
    assert_eq!(imu.imu_from_first.translation_m(), [0.05, 0.0, 0.0]);
    assert_eq!(imu.time_offset_s, Some(-0.0025));
    assert_eq!(imu.gyro_bias, Some([0.1, 0.2, 0.3]));
    assert_eq!(imu.noise.unwrap().gyro_noise_density, 2e-4);
    assert_eq!(
        set.cameras[0].model.distortion,
        Distortion::Eucm {
            alpha: 0.6,
            beta: 1.0
        }
    );
    let said = |what: &str| assert!(notes.iter().any(|n| n.0.contains(what)), "{notes:?}");
    said("gyro_noise_std differs between the axes");
    said("calib_gyro_bias: scale and misalignment are not carried");
}

#[test]
fn invalid_files_are_rejected() {
    let folder = Folder::new();
    let check = |from: &str, to: &str, expected: &str| {
        let good = text(UCM);
        assert!(good.contains(from), "{from}");
        let path = folder.file("calibration.json", &good.replacen(from, to, 1));
        let error = read(&path).unwrap_err().to_string();
        assert!(
            error.contains(expected),
            "found {error:?}, expected {expected:?}"
        );
        assert!(error.ends_with("calibration.json"), "{error}");
    };
    check(
        "\"ucm\"",
        "\"fov\"",
        "found \"fov\", expected value0.intrinsics[0].camera_type to be ds or",
    );
    check(
        "\"alpha\"",
        "\"beta\"",
        "value0.intrinsics[0].intrinsics.alpha is missing",
    );
    check("0.05", "0,05", "is there a decimal comma?");
    check("0.05", "NaN", "line 3: found");
    check("0.05", "50.0", "the IMU is 50 m from the first camera");
    check("0.7071067811865476", "0.9", "value0.T_imu_cam[0]");
    check(
        "[[640, 480]]",
        "[]",
        "0 elements, expected one for each of the 1 in T_imu_cam",
    );
    check(
        "\"fx\": 300",
        "\"fx\": \"wide\"",
        "expected a finite number as value0.intrinsics[0].intrinsics.fx",
    );
    check(
        "200",
        "-200",
        "expected a number above 0 as value0.imu_update_rate",
    );
}

#[test]
fn the_real_files() {
    let Some(path) = shared("06_calibration/basalt_calib/euroc_ds_calib.json") else {
        return;
    };
    let (set, notes) = read(&path).unwrap();
    let m = &set.cameras[1].model;
    assert_eq!(
        (m.fx, m.cy, m.width, m.height),
        (361.6713883800533, 255.9772968522045, 752, 480)
    );
    let (stereo, _) = set.stereo(None).unwrap();
    // EuRoC's own calibration of the same pair.
    assert!(
        (stereo.baseline_m() - 0.110_074).abs() < 5e-4,
        "{}",
        stereo.baseline_m()
    );
    assert!(notes.iter().any(|n| n.0.contains("vignetting")));
    assert_eq!(stereo.imu.unwrap().rate_hz, 200.0);
}

#[test]
fn impossible_value_is_named_by_its_key() {
    let folder = Folder::new();
    let check = |from: &str, to: &str, expected: &str| {
        let path = folder.file("calibration.json", &text(UCM).replacen(from, to, 1));
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    let of_lens = "line 5: value0.intrinsics[0].intrinsics";
    check(
        "\"fy\": 300",
        "\"fy\": -300",
        &format!("{of_lens}.fy: focal lengths 300 and -300"),
    );
    check(
        "\"cx\": 320",
        "\"cx\": 3200",
        &format!("{of_lens}.cx: principal point (3200, 240)"),
    );
    check(
        "0.05",
        "50.0",
        "line 3: value0.T_imu_cam[0]: the IMU is 50 m from the first camera",
    );
}
