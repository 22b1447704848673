use super::*;
use crate::test_data::{Folder, shared};

/// The reader on files on disk.
fn read(path: &Path) -> SetResult {
    super::read(&Disk, path, None)
}

/// As Kalibr prints a chain: PyYAML, lists of lists, the second camera beside the first.
const CHAIN: &str = "cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.01]
  - [0.0, 0.0, -1.0, 0.02]
  - [1.0, 0.0, 0.0, -0.03]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.294719325148729, 0.08601391290708914,
    -0.0003238494917967103, 0.00019368128471670667]
  distortion_model: radtan
  intrinsics: [461.487246372674, 460.11319997, 362.66, 246.15]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: 0.0052
cam1:
  T_cam_imu:
  - [0.0, -1.0, 0.0, -0.1]
  - [0.0, 0.0, -1.0, 0.02]
  - [1.0, 0.0, 0.0, -0.03]
  - [0.0, 0.0, 0.0, 1.0]
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [0.01, 0.02, -0.03, 0.04]
  distortion_model: equidistant
  intrinsics: [460.5, 459.1, 380.0, 255.0]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
  timeshift_cam_imu: 0.0053
";

const IMU: &str = "accelerometer_noise_density: 0.0019\naccelerometer_random_walk: 4.3e-05 # comment\n\
                   gyroscope_noise_density: 0.0002\ngyroscope_random_walk: 2.2e-06\nrostopic: /imu0\n\
                   update_rate: 200.0\n";

#[test]
fn a_chain_with_its_imu() {
    let folder = Folder::new();
    let path = folder.file("camchain-imucam.yaml", CHAIN);
    folder.file("imu.yaml", IMU);
    let (set, notes) = read(&path).unwrap();
    let m = &set.cameras[0].model;
    assert_eq!((m.fx, m.cy, m.width), (461.487246372674, 246.15, 752));
    assert_eq!(
        m.distortion,
        Distortion::RadTan4 {
            k1: -0.294719325148729,
            k2: 0.08601391290708914,
            p1: -0.0003238494917967103,
            p2: 0.00019368128471670667
        }
    );
    assert!(matches!(
        set.cameras[1].model.distortion,
        Distortion::KannalaBrandt4 { k4: 0.04, .. }
    ));
    // T_cn_cnm1 takes cam0's points to cam1: a point on cam0's axis is to the left in cam1.
    let (stereo, _) = set.stereo(None).unwrap();
    assert_eq!(
        stereo.right_from_left.apply([0.0, 0.0, 2.0]),
        [-0.11, 0.0, 2.0]
    );
    let imu = set.imu.unwrap();
    // T_cam_imu takes the IMU's points to the camera: its x axis is along the optical axis.
    let in_imu = imu.imu_from_first.rotate([0.0, 0.0, 1.0]);
    assert!((in_imu[0] - 1.0).abs() < 1e-12, "{in_imu:?}");
    assert_eq!(imu.time_offset_s, Some(0.0052));
    assert_eq!(imu.rate_hz, Some(200.0));
    assert_eq!(imu.noise.unwrap().gyro_random_walk, 2.2e-06);
    assert_eq!(set.provenance.files.len(), 2);
    assert!(
        notes
            .iter()
            .any(|n| n.0.contains("timeshift_cam_imu is 0.0053")),
        "{notes:?}"
    );
    assert!(stereo.imu.is_some());
}

#[test]
fn an_omni_camera_is_an_extended_unified_one() {
    let folder = Folder::new();
    let text = "cam0:\n  camera_model: omni\n  intrinsics: [1.2, 800.0, 790.0, 320.0, 240.0]\n  \
                distortion_model: radtan\n  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n  resolution: [640, 480]\n";
    let (set, _) = read(&folder.file("camchain.yaml", text)).unwrap();
    let lens = camera_models::Lens::new(&set.cameras[0].model);
    for point in [[0.3_f64, -0.2, 1.0], [1.5, 0.4, 0.2], [2.0, 1.0, -0.5]] {
        let [x, y, z] = point;
        let d = (x * x + y * y + z * z).sqrt();
        // Mei and Rives 2007: onto the sphere, then from a point xi behind it.
        let expected = [
            800.0 * x / (z + 1.2 * d) + 320.0,
            790.0 * y / (z + 1.2 * d) + 240.0,
        ];
        let found = lens.project(point).unwrap();
        assert!((found[0] - expected[0]).abs() < 1e-9 && (found[1] - expected[1]).abs() < 1e-9);
    }
}

#[test]
fn invalid_files_are_rejected() {
    let folder = Folder::new();
    let check = |from: &str, to: &str, expected: &str| {
        assert!(CHAIN.contains(from), "{from}");
        let path = folder.file("camchain.yaml", &CHAIN.replacen(from, to, 1));
        let error = read(&path).unwrap_err().to_string();
        assert!(
            error.contains(expected),
            "found {error:?}, expected {expected:?}"
        );
        assert!(error.ends_with("camchain.yaml"), "{error}");
    };
    check(
        "461.487246372674,",
        "461,487,",
        "line 12: found 5 numbers (were decimal commas",
    );
    check(
        "camera_model: pinhole",
        "camera_model: pinhole8",
        "expected cam0.camera_model to be",
    );
    check("radtan", "fov", "the FOV model is not read");
    check(
        "  resolution: [752, 480]\n",
        "",
        "cam0.resolution is missing, found T_cam_imu",
    );
    check(
        "[1.0, 0.0, 0.0, -0.03]",
        "[-1.0, 0.0, 0.0, -0.03]",
        "line 3: found a matrix where",
    );
    check(
        "-0.11",
        "-110",
        "cam1 is 110 m from the first camera, expected at most 10: not in metres?",
    );
    check(
        "0.00019368128471670667",
        ".nan",
        "expected a finite number as cam0.distortion_coeffs[3]",
    );
    check(
        "752, 480",
        "752, 48.5",
        "expected a whole number of pixels above 0",
    );
    check("cam0:", "cam5:", "cam0 is missing");
    let omni = "cam0: {camera_model: omni, intrinsics: [1, 2, 3, 4, 5], distortion_model: radtan, \
                distortion_coeffs: [1, 0, 0, 0], resolution: [9, 9]}\n";
    let error = read(&folder.file("o.yaml", omni)).unwrap_err().to_string();
    assert!(error.contains("no model here is both"), "{error}");
}

#[test]
fn the_real_noise_files() {
    for (name, rate_hz, gyro) in [
        ("zed2i", 320.0, 8.992407693407532e-05),
        ("alphasense", 200.0, 0.00020202932517334086),
    ] {
        let path = format!("06_calibration/grandtour/allan_variances/{name}/imu.yaml");
        let Some(path) = shared(&path) else { return };
        let imu = read_imu(&path).unwrap();
        assert_eq!((imu.rate_hz, imu.noise.gyro_noise_density), (rate_hz, gyro));
        let folder = Folder::new();
        assert_eq!(
            read_imu(&folder.file("imu.yaml", &imu_text(&imu))).unwrap(),
            imu
        );
    }
}

/// Of the first camera with these lines for its lens.
fn with_lens(lens: &str) -> Result<Distortion, String> {
    let folder = Folder::new();
    let text = format!(
        "cam0:\n  camera_model: pinhole\n  intrinsics: [460.5, 459.1, 380.0, 255.0]\n  resolution: [752, 480]\n{lens}"
    );
    match read(&folder.file("camchain.yaml", &text)) {
        Ok((set, _)) => Ok(set.cameras[0].model.distortion),
        Err(error) => Err(error.to_string()),
    }
}

#[test]
fn a_lens_is_never_dropped() {
    let refused = |lens: &str, expected: &str| {
        let error = with_lens(lens).unwrap_err();
        assert!(error.contains(expected), "{error}");
    };
    let coefficients = "  distortion_coeffs: [-0.29, 0.08, -0.0003, 0.0002]\n";
    refused(coefficients, "cam0.distortion_model is missing");
    refused(
        &format!("  distorsion_model: radtan\n{coefficients}"),
        "cam0.distortion_model is missing",
    );
    refused(
        &format!("  distortion_model: none\n{coefficients}"),
        "line 6: found -0.29 beside distortion_model none, expected only zeros as cam0.distortion_coeffs",
    );
    for none in ["[]", "[0.0, 0.0, 0.0, 0.0]"] {
        let lens = format!("  distortion_model: none\n  distortion_coeffs: {none}\n");
        assert_eq!(with_lens(&lens), Ok(Distortion::None));
    }
    assert_eq!(
        with_lens("  distortion_model: none\n"),
        Ok(Distortion::None)
    );
}

#[test]
fn a_camera_is_never_dropped() {
    let folder = Folder::new();
    let error = |text: &str| {
        read(&folder.file("camchain.yaml", text))
            .unwrap_err()
            .to_string()
    };
    let (first, _) = CHAIN.split_once("cam1:").unwrap();
    let cut = error(&format!("{first}cam1:\n"));
    assert!(
        cut.contains("line 16: found nothing, expected a block of keys as cam1"),
        "{cut}"
    );
    // Truncated before it, only the other camera shows it.
    let (set, notes) = read(&folder.file("camchain.yaml", first)).unwrap();
    assert_eq!(set.names(), ["cam0"]);
    assert!(
        notes.iter().any(|n| n
            .0
            .contains("cam0.cam_overlaps names cam1, which the file does not have")),
        "{notes:?}"
    );
    let gap = error(&CHAIN.replace("cam1:", "cam2:"));
    assert!(gap.contains("cam1 is missing, found cam0, cam2"), "{gap}");
    let twice = error(&format!("{CHAIN}cam01: {{}}\n"));
    assert!(twice.contains("cam2 is missing"), "{twice}");
    // The order in the file does not matter, other keys are not cameras.
    let rotated = format!(
        "calibrated: true\ncam1:{}{first}",
        CHAIN.split_once("cam1:").unwrap().1
    );
    let (set, _) = read(&folder.file("camchain.yaml", &rotated)).unwrap();
    assert_eq!(set.names(), ["cam0", "cam1"]);
    assert_eq!(
        set.cameras[1].camera_from_first.unwrap().translation_m(),
        [-0.11, 0.0, 0.0]
    );
}

#[test]
fn impossible_value_is_named_by_its_key() {
    let folder = Folder::new();
    let check = |from: &str, to: &str, expected: &str| {
        let path = folder.file("camchain.yaml", &CHAIN.replacen(from, to, 1));
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    check(
        "[461.4",
        "[-461.4",
        "line 12: cam0.intrinsics: focal lengths -461.487246372674 and",
    );
    check(
        "255.0",
        "2550.0",
        "line 31: cam1.intrinsics: principal point (380, 2550)",
    );
    check(
        "-0.11",
        "-110",
        "line 23: cam1.T_cn_cnm1: cam1 is 110 m from",
    );
    check(
        "-0.03]",
        "-30.0]",
        "line 3: cam0.T_cam_imu: the IMU is 30.0",
    );
}
