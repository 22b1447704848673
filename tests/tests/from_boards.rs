//! From an uncalibrated rig to a scene: boards, calibration, a walk, a scene. As in
//! docs/guides/calibration.md, with the programs as a user starts them.

use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;

use cad_transforms::{Frame, FramePart, Rig, RigidTransform};
use harness::program;
use rig_sim::camera::Quality;
use rig_sim::faults::Faults;
use rig_sim::render::{Job, render_session};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};
use scene_bundle::Scene;

const RIG: &str = include_str!("../../cad-transforms/rigs/example.toml");
const CALIBRATE: &str = "`paws calib cameras BOARDS --target board.toml --out calibration`";

/// A session without intrinsics and extrinsics; returns the true rig.
fn render(kind: Kind, seconds: f64, rate_hz: f64, folder: &Path) -> Rig {
    let settings = Settings {
        kind,
        lighting: Lighting::Day,
        seed: 5,
        seconds,
        rate_hz,
        width: 672,
        height: 376,
        quality: Quality::FAST,
    };
    let rig = Rig::parse(RIG).expect("a rig file");
    let simulation = Simulation::new(&settings, &rig).expect("a simulation");
    let truth = Rig::parse(&simulation.true_rig_toml(&rig)).expect("the truth");
    let job = Job {
        rig: &rig,
        rig_text: RIG,
        session: true,
        faults: &Faults::default(),
        truth: false,
        threads: 2,
    };
    render_session(
        &Arc::new(simulation.without_calibration()),
        &job,
        folder,
        &|| {},
    )
    .expect("a session");
    truth
}

/// Output of a program, which must exit with this code.
fn run_program(program: &Path, folder: &Path, arguments: &[&str], code: i32) -> String {
    let mut command = Command::new(program);
    let Output {
        status,
        stdout,
        stderr,
    } = command
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("run");
    let text = [stdout, stderr].map(|bytes| String::from_utf8(bytes).expect("UTF-8"));
    let text = text.concat();
    assert_eq!(status.code(), Some(code), "{arguments:?}\n{text}");
    text
}

#[test]
fn uncalibrated_rig_is_calibrated_and_reconstructed() {
    let (paws, reconstruct) = (
        program::paws().expect("paws"),
        program::reconstruct().expect("paws-reconstruct"),
    );
    // `paws calib` finds it beside `paws`.
    program::calib().expect("paws-calib");
    let folder = tempfile::tempdir().expect("folder");
    let here = folder.path();
    let truth = render(Kind::Targets, 45.0, 5.0, &here.join("boards"));
    assert!(!here.join("boards/rig/rig.toml").exists());

    // The rig file is estimated from boards only, and the results are printed.
    let output = run_program(
        &paws,
        here,
        &["calib", "cameras", "boards", "--out", "calibration"],
        0,
    );
    assert!(
        output.contains("the origin is the left lens of feet"),
        "{output}"
    );
    assert!(
        output.contains("pitch\u{b0}") && output.contains("sigma mm"),
        "{output}"
    );
    let page = std::fs::read_to_string(here.join("calibration/cameras.html")).expect("a page");
    assert!(page.contains("Poses of cameras and IMUs") && page.contains("left_shoulder/right"));
    let found = Rig::read(&here.join("calibration/rig.toml")).expect("a rig file");
    assert_eq!(found.origin_camera(), Some("feet"));
    assert!(found.provenance().note.contains("from boards alone"));
    let left = |camera: &str| Frame::of_camera(camera, FramePart::Left).expect("a frame");
    let between = |rig: &Rig, a: &Frame, b: &Frame| rig.transform(a, b).expect("frames");
    let off = |a: &Frame, b: &Frame, found: &Rig| -> (f64, f64) {
        let off: RigidTransform = between(&truth, a, b).inverse() * between(found, a, b);
        (1e3 * off.distance_m(), off.angle_rad().to_degrees())
    };
    let origin = left("feet");
    for camera in ["left_shoulder", "right_shoulder"] {
        let (mm, degrees) = off(&origin, &left(camera), &found);
        assert!(
            mm < 3.0 && degrees < 0.15,
            "{camera}: {mm} mm, {degrees} degrees\n{output}"
        );
        let sigmas = found.covariance(&Frame::rig(), &left(camera));
        let sigmas = sigmas.expect("frames").expect("a tolerance").sigmas();
        assert!(
            sigmas.iter().all(|s| (1e-6..5e-3).contains(s)),
            "{sigmas:?}"
        );
    }

    // The IMUs are added to it.
    let imus = [
        "calib",
        "camera-imu",
        "boards",
        "--calibration",
        "calibration",
    ];
    let imus = [
        &imus[..],
        &["--line-us", "feet=22.606", "--out", "calibration"],
    ]
    .concat();
    let output = run_program(&paws, here, &imus, 0);
    assert!(output.contains("feet/imu"), "{output}");
    let with_imus = Rig::read(&here.join("calibration/rig-imu.toml")).expect("a rig file");
    for camera in ["left_shoulder", "right_shoulder", "feet"] {
        let imu = Frame::of_camera(camera, FramePart::Imu).expect("a frame");
        let (mm, degrees) = off(&left(camera), &imu, &with_imus);
        assert!(
            mm < 4.0 && degrees < 0.3,
            "{camera}/imu: {mm} mm, {degrees} degrees\n{output}"
        );
    }
    for file in ["calibration/rig.toml", "calibration/rig-imu.toml"] {
        let mut check = vec!["rig".to_owned(), "check".to_owned(), file.to_owned()];
        for camera in ["left_shoulder", "right_shoulder", "feet"] {
            check.push("--calibration".to_owned());
            check.push(format!("{camera}=calibration/{camera}.yaml"));
        }
        let check: Vec<&str> = check.iter().map(String::as_str).collect();
        let output = run_program(&paws, here, &check, 0);
        assert!(
            output.contains("the rig's frame is that of feet"),
            "{output}"
        );
    }

    // A walk recorded before the calibration: import warns, reconstruction refuses it, and the
    // calibration folder resolves it.
    render(Kind::Plaza, 3.0, 15.0, &here.join("walk"));
    let library = ["--library", "library"];
    run_program(
        &paws,
        here,
        &[&library[..], &["import", "walk"]].concat(),
        0,
    );
    let mut sessions = std::fs::read_dir(here.join("library/sessions")).expect("sessions");
    let session = sessions
        .next()
        .expect("a session")
        .expect("an entry")
        .path();
    let session = session.to_str().expect("UTF-8");
    let output = run_program(
        &paws,
        here,
        &[&library[..], &["validate", session]].concat(),
        0,
    );
    assert!(
        output.contains("WARN") && output.contains(CALIBRATE),
        "{output}"
    );
    let output = run_program(
        &paws,
        here,
        &[&library[..], &["handoff", session]].concat(),
        0,
    );
    let handoff = output.lines().find(|line| line.ends_with("handoff.json"));
    let handoff = handoff.expect("a hand-off").to_owned();
    let run = [
        "run",
        &handoff,
        "--out",
        "walk.scene",
        "--preset",
        "fast",
        "--to",
        "maps",
    ];
    let output = run_program(&reconstruct, here, &run, 1);
    assert!(
        output.contains("its intrinsics are not known") && output.contains(CALIBRATE),
        "{output}"
    );
    let mended = [&run[..], &["--calibration", "calibration"]].concat();
    let output = run_program(&reconstruct, here, &mended, 0);
    assert!(
        output.contains("given in addition to the session"),
        "{output}"
    );
    let scene = Scene::open(&here.join("walk.scene")).expect("a bundle");
    let manifest = scene.manifest();
    assert_eq!(manifest.provenance.rig.name, "calibrated rig");
    assert_eq!(manifest.provenance.rig.revision, with_imus.revision());
    assert!(manifest.outputs.contains_key("cloud"));
}
