use super::*;
use crate::camera::Quality;
use crate::scene::{Kind, Lighting};
use crate::simulation::{Settings, Simulation};

const RIG: &str = include_str!("../../../../../cad-transforms/rigs/example.toml");

fn session() -> Simulation {
    let settings = Settings {
        kind: Kind::Targets,
        lighting: Lighting::Day,
        seed: 1,
        seconds: 2.0,
        rate_hz: 10.0,
        width: 160,
        height: 90,
        quality: Quality::FAST,
    };
    Simulation::new(&settings, &Rig::parse(RIG).unwrap()).unwrap()
}

fn calibration_error(text: &str) -> CalibrationError {
    CalibrationError::parse(text, &["feet", "left_shoulder"]).unwrap()
}

#[test]
fn recorded_calibration_is_unchanged_and_ground_truth_differs() {
    let rig = Rig::parse(RIG).unwrap();
    let text = "[[camera]]\nname = \"left_shoulder\"\nrotation_deg = [0.0, 0.5, 0.0]\n\
                translation_mm = [1.0, 0.0, 2.0]\nright_translation_mm = [0.0, 0.3, 0.0]\ntime_offset_ms = 3.0\n\
                focal_px = [1.5, 0.0]\n";
    let nominal = session();
    assert!(!nominal.differs_from_calibration());
    let is = session()
        .with_calibration_error(&rig, &calibration_error(text))
        .unwrap();
    assert!(is.differs_from_calibration());
    let at = nominal
        .cameras()
        .iter()
        .position(|c| c.name == "left_shoulder")
        .unwrap();
    for camera in 0..nominal.cameras().len() {
        assert_eq!(is.calibration(camera), nominal.calibration(camera));
        assert_eq!(
            is.true_calibration(camera) == nominal.calibration(camera),
            camera != at
        );
        let same = is.cameras()[camera] == nominal.cameras()[camera];
        assert_eq!(same, camera != at);
    }
    let (new, old) = (&is.cameras()[at], &nominal.cameras()[at]);
    let turned = old.rig_from_eye[0].inverse() * new.rig_from_eye[0];
    assert!((turned.angle_rad().to_degrees() - 0.5).abs() < 1e-9);
    assert!((turned.translation() - Vector3::new(1e-3, 0.0, 2e-3)).norm() < 1e-12);
    // Rotation about y, which is down: the former axis points to the left.
    let forward = turned.rotation() * Vector3::z();
    assert!((forward.x - 0.5_f64.to_radians().sin()).abs() < 1e-9);
    let of =
        |camera: &crate::rig::SimCamera| camera.rig_from_eye[1].inverse() * camera.rig_from_eye[0];
    let shifted = of(new) * of(old).inverse();
    assert!((shifted.distance_m() - 3e-4).abs() < 1e-12);
    // The IMU moves rigidly with its camera.
    let imu = |s: &Simulation| s.imus()[at].imu_from_rig * s.cameras()[at].rig_from_eye[0];
    let off = imu(&is).inverse() * imu(&nominal);
    assert!(off.distance_m() < 1e-12 && off.angle_rad() < 1e-9);
    assert_eq!(new.time_offset_ns, 3_000_000);
    assert_eq!(new.models[1].fx, old.models[1].fx + 1.5);

    // The true rig file describes the same rig.
    let again = Rig::parse(&is.true_rig_toml(&rig)).unwrap();
    let again = session().with_true_rig(&again).unwrap();
    for (a, b) in again.cameras().iter().zip(is.cameras()) {
        for eye in 0..2 {
            let off = a.rig_from_eye[eye].inverse() * b.rig_from_eye[eye];
            assert!(
                off.distance_m() < 1e-12 && off.angle_rad() < 1e-9,
                "{}",
                a.name
            );
        }
    }
    assert_eq!(again.calibration(at), nominal.calibration(at));
    assert_eq!(
        Rig::parse(&is.true_rig_toml(&rig)).unwrap().shoe_tags(),
        rig.shoe_tags()
    );
}

#[test]
fn zero_calibration_error_changes_nothing() {
    let rig = Rig::parse(RIG).unwrap();
    let is = session()
        .with_calibration_error(&rig, &calibration_error("[[camera]]\nname = \"feet\"\n"))
        .unwrap();
    assert!(!is.differs_from_calibration());
    assert_eq!(is.cameras(), session().cameras());
}

#[test]
fn frames_with_a_time_offset_show_an_earlier_instant() {
    let rig = Rig::parse(RIG).unwrap();
    let text = "[[camera]]\nname = \"feet\"\ntime_offset_ms = 20.0\n";
    let is = session()
        .with_calibration_error(&rig, &calibration_error(text))
        .unwrap();
    let nominal = session();
    let at = nominal
        .cameras()
        .iter()
        .position(|c| c.name == "feet")
        .unwrap();
    let (late, prompt) = (is.target_observations(at), nominal.target_observations(at));
    let time_ns = 1_400_000_000;
    assert_eq!(
        late.corners(0, time_ns),
        prompt.corners(0, time_ns - 20_000_000)
    );
    assert!(late.corners(0, time_ns).len() > 8);
    assert_ne!(late.corners(0, time_ns), prompt.corners(0, time_ns));
}

#[test]
fn invalid_file_is_rejected_with_all_problems() {
    let parse = |text: &str| {
        CalibrationError::parse(text, &["feet"])
            .unwrap_err()
            .to_string()
    };
    let text =
        "[[camera]]\nname = \"foot\"\nrotation_deg = [0.0, 90.0, 0.0]\ntime_offset_ms = nan\n";
    let message = parse(text);
    for expected in [
        "camera is \"foot\", expected one of feet",
        "rotation_deg of foot is [0.0, 90.0, 0.0], expected -45 to 45 degrees",
        "time_offset_ms of foot is [NaN], expected -500 to 500 ms",
    ] {
        assert!(message.contains(expected), "{message}");
    }
    let twice = "[[camera]]\nname = \"feet\"\n[[camera]]\nname = \"feet\"\n";
    assert!(parse(twice).contains("\"feet\" is named twice"));
    assert!(parse("[[camera]]\nname = \"feet\"\nturned = 1\n").contains("unknown field"));
}
