use super::*;
use crate::cad::device::housing_from_optical;
use crate::cad::{Format, read_bytes};

const STEP: &[u8] = include_bytes!("../../../tests/data/plate_ap214.step");

const MAP: &str = r#"format = 1
name = "chest plate"
revision = "C"
note = "drawing 12"
root = "plate"

[[camera]]
name = "left_shoulder"
part = "left_mount/zed_x_mini"
model = "zed_x_mini"
serial = 47000001
baseline_m = 0.04988
sigma_translation_mm = 0.2
sigma_rotation_deg = 0.2

[[camera]]
name = "right_shoulder"
part = "plate/right_mount/zed_x_mini"
model = "zed_x_mini"

[[camera]]
name = "feet"
part = "feet_mount"
model = "zed_mini"
[camera.part_from_datum]
translation_mm = [0, 0, 3]
rpy_deg = [0, 0, 0]

[[frame]]
frame = "feet/imu"
part = "feet_mount"
"#;

fn source() -> CadSource {
    CadSource {
        file: "plate.step".to_owned(),
        blake3: blake3::hash(STEP).to_hex().to_string(),
    }
}

#[test]
fn a_step_file_becomes_a_rig() {
    let cad = read_bytes(STEP, Format::Step).unwrap();
    let rig = Map::parse(MAP).unwrap().rig(&cad, source()).unwrap();
    assert_eq!(rig.cameras(), ["feet", "left_shoulder", "right_shoulder"]);
    assert_eq!(rig.serial("left_shoulder"), Some("47000001"));
    assert_eq!(rig.provenance().cad.as_ref().unwrap().file, "plate.step");
    assert!(
        rig.provenance()
            .note
            .starts_with("drawing 12; ZED Mini: Stereolabs zed_macro"),
        "{}",
        rig.provenance().note
    );
    let place = |name: &str| {
        let frame = name.parse().unwrap();
        rig.transform(&Frame::rig(), &frame).unwrap()
    };
    // The part is rotated by 45 degrees at (28.660, 145, 105) mm; the lens is 10 mm back, 25 left,
    // 16 up in it.
    let s = 0.5_f64.sqrt();
    let expected = [
        28.660_254_038 + s * (-10.0 - 25.0),
        145.0 + s * (-10.0 + 25.0),
        105.0 + 16.0,
    ];
    let left = place("left_shoulder/left");
    for (found, expected) in left.translation_m().iter().zip(expected) {
        assert!((1e3 * found - expected).abs() < 1e-6, "{left:?}");
    }
    let axis = left.rotate([0.0, 0.0, 1.0]);
    assert!(
        (axis[0] - s).abs() < 1e-9 && (axis[1] - s).abs() < 1e-9,
        "{axis:?}"
    );
    let baseline = |camera: &str| {
        let [l, r] = ["left", "right"].map(|part| format!("{camera}/{part}").parse().unwrap());
        rig.transform(&l, &r).unwrap().translation_m()
    };
    assert_eq!(baseline("left_shoulder"), [0.04988, 0.0, 0.0]);
    assert_eq!(baseline("right_shoulder"), [0.05, 0.0, 0.0]);
    // A stated mount and a device add up; a mount without a tolerance leaves the covariance
    // unknown.
    let covariance = rig.edges()[0].covariance.unwrap().sigmas();
    let lever = 0.2_f64.to_radians() * 0.0189;
    assert!(
        covariance[1] > 0.00102 && covariance[1] < 0.00102 + lever,
        "{covariance:?}"
    );
    assert_eq!(rig.edges()[2].covariance, None);
    // The datum is 3 mm above the part's origin, in the part's own axes.
    let part = cad.find("feet_mount").unwrap().root_from_part;
    let up = RigidTransform::from_translation_m([0.0, 0.0315, 0.01325 + 0.003]).unwrap();
    let off = place("feet/left").inverse() * (part * up * housing_from_optical());
    assert!(off.distance_m() < 1e-12 && off.angle_rad() < 1e-12);
    assert_eq!(place("feet/imu"), part);
}

#[test]
fn axes_and_datum_can_be_turned() {
    let cad = read_bytes(STEP, Format::Step).unwrap();
    let text = MAP
        .replace("root = \"plate\"", "root = \"left_mount\"")
        .replacen(
            "[[camera]]",
            "[rig_from_root]\ntranslation_mm = [0, 0, 10]\nrpy_deg = [0, 0, 90]\n[[camera]]",
            1,
        );
    let rig = Map::parse(&text).unwrap().rig(&cad, source()).unwrap();
    let left = rig
        .transform(&Frame::rig(), &"left_shoulder/left".parse().unwrap())
        .unwrap();
    // In the mount the part is at (10, 0, 5), rotated by 15 degrees; then all is rotated to the
    // left and lifted.
    let (s, c) = 15_f64.to_radians().sin_cos();
    let (x, y) = (10.0 - 10.0 * c - 25.0 * s, -10.0 * s + 25.0 * c);
    let expected = [-y, x, 5.0 + 16.0 + 10.0];
    for (found, expected) in left.translation_m().iter().zip(expected) {
        assert!((1e3 * found - expected).abs() < 1e-6, "{left:?} {expected}");
    }
}

#[test]
fn own_devices_come_before_known_ones() {
    let cad = read_bytes(STEP, Format::Step).unwrap();
    let device = "\n[[device]]\nname = \"zed_mini\"\ntitle = \"ZED Mini on our clamp\"\nbaseline_m = 0.0629\n\
                  datum_from_left_m = [0.001, 0.0314, 0.012]\nsource = \"measured\"\nsigma_translation_m = 0.0002\n\
                  sigma_rotation_deg = 0.1\nsigma_baseline_m = 0.0001\nfield_of_view_deg = [85, 54]\n";
    let rig = Map::parse(&(MAP.to_owned() + device))
        .unwrap()
        .rig(&cad, source())
        .unwrap();
    let [l, r] = ["feet/left", "feet/right"].map(|f| f.parse().unwrap());
    assert_eq!(rig.transform(&l, &r).unwrap().distance_m(), 0.0629);
    assert!(
        rig.provenance()
            .note
            .contains("ZED Mini on our clamp: measured")
    );
}

#[test]
fn mistakes_are_all_reported_with_lines() {
    let cad = read_bytes(STEP, Format::Step).unwrap();
    let text = MAP
        .replace("\"left_mount/zed_x_mini\"", "\"zed_x_mini\"")
        .replace(
            "part = \"feet_mount\"\nmodel",
            "part = \"foot_mount\"\nmodel",
        );
    let error = Map::parse(&text)
        .unwrap()
        .rig(&cad, source())
        .unwrap_err()
        .to_string();
    assert!(error.contains("line 9: part in [[camera]]: \"zed_x_mini\" fits 2 parts, write more of the path: plate/left_mount/zed_x_mini, plate/right"), "{error}");
    assert!(
        error.contains(
            "line 23: part in [[camera]]: no part is called \"foot_mount\" among 6; the nearest is \"plate/feet_mount\""
        ),
        "{error}"
    );

    let text = MAP
        .replace("root = \"plate\"", "root = \"x\"")
        .replace("imu\"\npart = \"feet_mount", "imu\"\npart = \"imu");
    let error = Map::parse(&text)
        .unwrap()
        .rig(&cad, source())
        .unwrap_err()
        .to_string();
    for expected in [
        "line 5: root in the map file: no part is called \"x\"",
        "line 31: part in [[frame]]: no part is called \"imu\"",
    ] {
        assert!(error.contains(expected), "no {expected:?} in {error}");
    }

    let text = MAP
        .replace("model = \"zed_mini\"", "model = \"zed_nano\"")
        .replace("rpy_deg = [0, 0, 0]", "rpy = [0, 0, 0]")
        .replace("frame = \"feet/imu\"", "frame = \"feet/mu\"")
        .replace("sigma_rotation_deg = 0.2\n", "");
    let error = Map::parse(&text).unwrap_err().to_string();
    for expected in [
        "expected one of zed_mini, zed_x_mini or a [[device]]",
        "unknown key rpy in [camera.part_from_datum]; known are translation_m",
        "\"feet/mu\" is not a frame",
        "sigma_rotation_rad is missing in [[camera]]",
    ] {
        assert!(error.contains(expected), "no {expected:?} in {error}");
    }
    let error = Map::parse("format = 2\n").unwrap_err().to_string();
    assert_eq!(
        error,
        "mapping parts to frames: line 1: format is 2, this program reads 1"
    );
}

#[test]
fn without_a_map_names_have_to_be_frames() {
    let cad = read_bytes(STEP, Format::Step).unwrap();
    let error = rig_of_frames(&cad, "x", source()).unwrap_err().to_string();
    assert!(
        error.contains("no part is called like a frame") && error.contains("plate/left_mount"),
        "{error}"
    );
}
