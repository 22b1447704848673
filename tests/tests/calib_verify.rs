//! A slice of `cargo xtask bench calib_verify`: one walk of a minute, evaluated with the correct
//! nominal calibration and with errors of it.

use calib::verify::{Parameter, Status};
use harness::walks::{NominalError, Plan, Walk};
use rig_sim::scene::{Kind, Lighting};

#[test]
fn errors_of_the_nominal_calibration_are_detected_without_false_alarms() {
    let walk = Walk::make(Kind::Stairs, Lighting::Day, 9, &Plan::MINUTE).expect("a walk");
    let found = walk.compare();
    let off = |wrong: &NominalError| -> Vec<(Parameter, String, Vec<String>, Vec<f64>)> {
        let all = walk.verify(wrong, &found).findings.into_iter();
        all.filter(|f| f.status == Status::Inconsistent)
            .map(|f| (f.parameter, f.camera, f.alternatives, f.estimate))
            .collect()
    };
    assert_eq!(off(&NominalError::None), []);

    let half = 0.5_f64.to_radians();
    let names = walk.names();
    for (k, name) in names.iter().enumerate() {
        let mut turn = [0.0; 3];
        turn[k] = half;
        let rotated = off(&NominalError::CameraRotation(k, turn));
        assert!(
            rotated
                .iter()
                .any(|(what, camera, or, _)| *what == Parameter::Camera
                    && (camera == name || or.contains(&(*name).to_owned()))),
            "{name}: {rotated:?}"
        );
        let late = off(&NominalError::ImageTime(k, 3e-3));
        let [(Parameter::ImageTime, camera, _, by)] = &late[..] else {
            panic!("{name}: {late:?}");
        };
        assert_eq!(camera, name);
        assert!((by[0] - 3e-3).abs() < 1e-3, "{name}: {by:?}");
    }
}
