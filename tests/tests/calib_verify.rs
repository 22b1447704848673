//! A slice of `cargo xtask bench calib_verify`: one walk of a minute, evaluated with the correct
//! nominal calibration and with errors of it.

use calib::verify::{Finding, Parameter, Status};
use harness::walks::{NominalError, Plan, Walk};
use rig_sim::scene::{Kind, Lighting};

#[test]
fn errors_of_the_nominal_calibration_are_detected_without_false_alarms() {
    let walk = Walk::make(Kind::Stairs, Lighting::Day, 9, &Plan::MINUTE).expect("a walk");
    let found = walk.compare();
    let off = |wrong: &NominalError| -> Vec<Finding> {
        let all = walk.verify(wrong, &found).findings.into_iter();
        all.filter(|f| f.status == Status::Inconsistent).collect()
    };
    assert_eq!(off(&NominalError::None), []);

    let half = 0.5_f64.to_radians();
    let names = walk.names();
    for (k, name) in names.iter().enumerate() {
        let mut turn = [0.0; 3];
        turn[k] = half;
        let rotated = off(&NominalError::CameraRotation(k, turn));
        assert!(
            rotated.iter().any(|f| f.parameter == Parameter::Camera
                && (f.camera == *name || f.alternatives.contains(&(*name).to_owned()))),
            "{name}: {rotated:?}"
        );
        let detected = |late_s: f64| {
            let late = off(&NominalError::ImageTime(k, late_s));
            let [finding] = &late[..] else {
                return false;
            };
            if finding.parameter != Parameter::ImageTime {
                return false;
            }
            assert_eq!(finding.camera, *name);
            let error_s = (finding.estimate[0] - late_s).abs();
            let sigma_s = finding.sigma;
            assert!(error_s < 3.0 * sigma_s && sigma_s < 1e-3, "{finding:?}");
            true
        };
        // The camera that looks down sees too little rotation in a minute for 3 ms, and has to say
        // so; what it states to be detectable has to be detected.
        let late_s = 3e-3;
        if *name != "feet" {
            assert!(detected(late_s), "{name}");
            continue;
        }
        let findings = walk.verify(&NominalError::ImageTime(k, late_s), &found);
        let mut own = findings.findings.iter();
        let own = own.find(|f| f.parameter == Parameter::ImageTime && f.camera == *name);
        let own = own.expect("a finding for each camera");
        assert_ne!(own.status, Status::Consistent, "{own:?}");
        assert!(own.min_detectable < 5e-3, "{own:?}");
        assert!(detected(5e-3), "{name}");
    }
}
