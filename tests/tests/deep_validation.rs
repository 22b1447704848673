//! `paws validate --deep` with the real `paws-calib`, on simulated walks: with the rig as its file
//! states, and with a camera that was rotated since.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use cad_transforms::Rig;
use harness::program;
use nalgebra::Vector3;
use rig_sim::calibration_error::CalibrationError;
use rig_sim::camera::Quality;
use rig_sim::faults::Faults;
use rig_sim::render::{Job, render_session};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};
use serde_json::Value;

const RIG: &str = include_str!("../../cad-transforms/rigs/example.toml");
const ROTATION: &str = "calib.camera_rotation";

/// Writes a session of a simulated walk, with the left shoulder rotated by this rotation vector,
/// rad.
fn render(simulation: &Simulation, rig: &Rig, turned: Vector3<f64>, folder: &Path) {
    let mut deviation = CalibrationError::default();
    deviation.of_mut("left_shoulder").rotation = turned;
    let simulation = simulation.clone().with_calibration_error(rig, &deviation);
    let job = Job {
        rig,
        rig_text: RIG,
        session: true,
        faults: &Faults::default(),
        truth: false,
        threads: 2,
    };
    let simulation = Arc::new(simulation.expect("a deviation of the rig"));
    render_session(&simulation, &job, folder, &|| {}).expect("a session");
}

/// Exit code of a deep validation, what it printed, and the verdict of every metric of calibration,
/// as (metric, stream, verdict).
fn validate(session: &Path) -> (Option<i32>, String, Vec<[String; 3]>) {
    // `paws` finds it in its own folder.
    program::calib().expect("paws-calib");
    let json = session.with_extension("json");
    let mut paws = Command::new(program::paws().expect("paws"));
    paws.args(["validate", "--deep", "--json"]);
    let output = paws.args([&json, session]).output().expect("run");
    let text = [output.stdout, output.stderr].map(|b| String::from_utf8(b).expect("UTF-8"));
    let text = text.concat();
    let document = fs::read(&json).unwrap_or_else(|e| panic!("{e}: {text}"));
    let document: Value = serde_json::from_slice(&document).expect("JSON");
    let field = |finding: &Value, key: &str| finding[key].as_str().expect("a text").to_owned();
    let findings = document["findings"].as_array().expect("a list").iter();
    let findings = findings.map(|f| ["metric", "of", "verdict"].map(|key| field(f, key)));
    let calibration = findings.filter(|[metric, ..]| metric.starts_with("calib."));
    (output.status.code(), text, calibration.collect())
}

#[test]
fn deep_validation_passes_the_nominal_rig_and_fails_a_rotated_camera() {
    let folder = tempfile::tempdir().expect("a folder");
    let [good, turned] = ["good", "turned"].map(|name| folder.path().join(name));
    let rig = Rig::parse(RIG).expect("a rig file");
    // As short and small as determines the rotation of a camera.
    let settings = Settings {
        kind: Kind::Stairs,
        lighting: Lighting::Day,
        seed: 3,
        seconds: 8.0,
        rate_hz: 15.0,
        width: 256,
        height: 144,
        quality: Quality::FAST,
    };
    let simulation = Simulation::new(&settings, &rig).expect("a simulation");
    // Built once, for both.
    simulation.scene();
    render(&simulation, &rig, Vector3::zeros(), &good);
    render(&simulation, &rig, Vector3::new(0.0, 0.04, 0.0), &turned);
    let shoulder = |verdict: &str| [ROTATION, "left_shoulder", verdict].map(str::to_owned);

    let (code, text, found) = validate(&good);
    assert_eq!(code, Some(0), "{text}");
    assert!(found.contains(&shoulder("PASS")), "{found:?}");
    let passes = |[_, _, verdict]: &[String; 3]| verdict == "PASS";
    assert!(found.iter().all(passes), "{found:?}");

    let (code, text, mut found) = validate(&turned);
    assert_eq!(code, Some(1), "{text}");
    found.retain(|finding| !passes(finding));
    assert_eq!(found, [shoulder("FAIL")]);
    let expected = "left_shoulder on the plate: rotated by 2.";
    assert!(text.contains(expected), "{text}");
}
