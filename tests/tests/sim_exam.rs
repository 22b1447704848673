//! Ground truth of the simulated rig, checked by independent tools: a short walk is rendered to
//! files, and OpenCV, the reference AprilTag detector and a ray caster in numpy recompute
//! everything from them.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use rig_sim::camera::Quality;
use rig_sim::faults::Faults;
use rig_sim::render::{Job, render};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};
use serde_json::Value;

const RIG: &str = include_str!("../../cad-transforms/rigs/example.toml");

/// The example rig without its right shoulder camera, which would add nothing.
fn two_cameras() -> String {
    let mut tables = RIG.split("\n[[");
    let head = tables.next().unwrap_or_default().to_owned();
    let kept = tables.filter(|table| !table.contains("\"right_shoulder"));
    kept.fold(head, |text, table| text + "\n[[" + table)
}

#[test]
fn rendered_ground_truth_agrees_with_independent_tools() {
    let Some(interpreter) = std::env::var_os("PAWS_PYTHON").map(PathBuf::from) else {
        eprintln!("skipped: PAWS_PYTHON names no interpreter with OpenCV and pupil-apriltags");
        return;
    };
    let rig_text = two_cameras();
    let rig = cad_transforms::rig::Rig::parse(&rig_text).expect("rig");
    // People cross the view, and the light is uniform: nothing white is overexposed, which would
    // shift its edges. At 10 Hz frames coincide with IMU samples, whose true pose is in the files.
    let settings = Settings {
        kind: Kind::Plaza,
        lighting: Lighting::Day,
        seed: 1,
        seconds: 2.5,
        rate_hz: 10.0,
        width: 672,
        height: 376,
        quality: Quality::ACCURATE,
    };
    let simulation = Arc::new(Simulation::new(&settings, &rig).expect("simulation"));
    let folder = tempfile::tempdir().expect("folder");
    let walk = folder.path().join("walk");
    let job = Job {
        rig: &rig,
        rig_text: &rig_text,
        session: false,
        faults: &Faults::default(),
        truth: true,
        threads: 2,
    };
    render(&simulation, &job, &walk, &|| {}).expect("render");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/sim_exam.py");
    let output = Command::new(interpreter)
        .args([&script, &walk])
        .output()
        .expect("start python");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "the reference script failed: {errors}"
    );
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    println!("{found:#}");

    let number = |pointer: &str| -> f64 {
        let value = found.pointer(pointer).and_then(Value::as_f64);
        value.unwrap_or_else(|| panic!("no number at {pointer} in {found:#}"))
    };
    let below = |pointer: &str, most: f64| {
        assert!(number(pointer) < most, "{pointer}: {}", number(pointer));
    };
    let above = |pointer: &str, least: f64| {
        assert!(number(pointer) > least, "{pointer}: {}", number(pointer));
    };

    // Tags: all that are visible by ground truth are detected, and no hidden one. With the tone
    // curve inverted corners agree. In delivered images they are shifted inwards, with zero mean:
    // in images drawn by numpy the curve alone causes 0.2 px, and with a blur of half a pixel 0.32
    // px.
    above("/tags/visible", 50.0);
    above("/tags/found", 0.95 * number("/tags/visible"));
    below("/tags/found though hidden", 3.0);
    below("/tags/linear/median", 0.1);
    below("/tags/linear/p95", 0.25);
    below("/tags/delivered/median", 0.4);
    for (kind, most) in [("linear", 0.03), ("delivered", 0.06)] {
        for axis in [0, 1] {
            below(&format!("/tags/{kind}/mean/{axis}"), most);
            above(&format!("/tags/{kind}/mean/{axis}"), -most);
        }
    }

    // Rows after rectification by OpenCV with the written calibration.
    above("/rows/count", 5000.0);
    below("/rows/median", 0.05);
    below("/rows/middle", 0.02);
    above("/rows/middle", -0.02);

    // Depth between the eyes, and compared with the written mesh.
    for camera in ["shoulder", "feet"] {
        above(&format!("/depth/{camera}/count"), 500_000.0);
        below(&format!("/depth/{camera}/median"), 3e-4);
        below(&format!("/depth/{camera}/p95"), 2e-3);
    }
    above("/mesh/count", 300.0);
    below("/mesh/p95", 1e-3);
    above("/mesh/same class", 0.99 * number("/mesh/count") - 1e-9);
    below("/mesh/at edges", 0.02 * number("/mesh/count"));

    // Flow: the residual after warping is noise, and texture that is blurred by resampling.
    for camera in ["shoulder", "feet"] {
        for eye in ["left", "right"] {
            let at = |what: &str| format!("/flow/{camera}/{eye}/{what}");
            above(&at("pixels"), 1e6);
            above(&at("moved/median"), 2.0);
            below(&at("warped"), 0.35 * number(&at("plain")));
            below(&at("warped median"), 4.0);
            above(&at("shown"), 0.75);
        }
    }
}
