//! Stages by the program: their outputs, messages, skips and refusals; and the state after a kill.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use cad_transforms::Rig;
use cad_transforms::frame::{Frame, FramePart};
use calibration_files::{Format, contents};
use camera_models::CameraSet;
use reconstruction::input::Input;
use reconstruction::pipeline::stages::rig;
use reconstruction::pipeline::{
    Meter, Pipeline, Selection, Sources, Stage, StageError, State, Work, observer,
};
use scene_bundle::{Bundle, Provenance, RigRevision, Scene, outputs};
use serde_json::{Value, json};

use crate::frame_set_reader::{RIG, rig_overrides};
use crate::session::{hand_over, lens};

fn run(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command.arg("run").args(arguments).output().expect("run")
}

fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn an_unknown_rig_is_an_error_that_names_what_is_missing() {
    let folder = tempfile::tempdir().expect("folder");
    hand_over(folder.path());
    let out = folder.path().join("bundle");
    let session = folder.path().to_str().expect("UTF-8");
    let output = run(&[
        session,
        "--out",
        out.to_str().expect("UTF-8"),
        "--to",
        "rig",
    ]);
    assert_eq!(output.status.code(), Some(1));
    let errors = errors(&output);
    assert!(
        errors.contains("camera feet: its intrinsics are not known"),
        "{errors}"
    );
    assert!(
        errors.contains("camera left_shoulder: its pose on the rig is not known"),
        "{errors}"
    );
    for mends in [
        "`paws calib cameras BOARDS --target board.toml --out calibration`",
        "`paws reconstruct run SESSION --calibration calibration --out SCENE`",
    ] {
        assert!(errors.contains(mends), "no {mends} in {errors}");
    }
    // The bundle is there, and empty.
    assert!(
        Scene::open(&out)
            .expect("a bundle")
            .manifest()
            .outputs
            .is_empty()
    );
}

#[test]
fn the_rig_combines_overrides_and_recorded_values_and_runs_once() {
    let folder = tempfile::tempdir().expect("folder");
    hand_over(folder.path());
    let rig_overrides = rig_overrides(folder.path());
    let place = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    fs::write(place("given.toml"), RIG).expect("a file");
    let (session, out, rig_file) = (place("."), place("bundle"), place("given.toml"));
    let calibration = format!("feet={}", place("K.txt"));
    let arguments = [
        &*session,
        "--out",
        &out,
        "--to",
        "rig",
        "--rig",
        &rig_file,
        "--calibration",
        &calibration,
        "--json",
    ];
    let stage = |arguments: &[&str]| -> Value {
        let output = run(arguments);
        assert_eq!(output.status.code(), Some(0), "{}", errors(&output));
        let text = String::from_utf8(output.stdout).expect("UTF-8");
        let [line] = text.lines().collect::<Vec<_>>()[..] else {
            panic!("{text}");
        };
        serde_json::from_str(line).expect("JSON")
    };
    let first = stage(&arguments);
    assert_eq!(
        (&first["stage"], &first["state"]),
        (&json!("rig"), &json!("ran"))
    );
    assert!(
        first["peak_bytes"]
            .as_u64()
            .is_some_and(|bytes| bytes > 1_000_000)
    );
    let notes: Vec<&str> = first["notes"]
        .as_array()
        .expect("notes")
        .iter()
        .flat_map(Value::as_str)
        .collect();
    assert!(
        notes.contains(
            &"IMU feet/imu: its noise is assumed to be that of data sheets of parts in ZED cameras"
        ),
        "{notes:?}"
    );

    let scene = Scene::open(out.as_ref()).expect("a bundle");
    let manifest = scene.manifest();
    assert_eq!(manifest.provenance.rig.revision, "nominal-1");
    assert!(manifest.provenance.ended_civil_ns.is_some());
    let reader = scene.output("rig").expect("an output");
    let model = outputs::rig::read(&reader).expect("a rig");
    let example = Rig::parse(RIG).expect("a rig file");
    let names: Vec<&str> = model.cameras.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["left_shoulder", "feet"]);
    for camera in &model.cameras {
        let part = Frame::of_camera(&camera.name, FramePart::Left).expect("a frame");
        let left = example.transform(&Frame::rig(), &part).expect("a place");
        assert_eq!(camera.rig_from_left, left);
    }
    // Recorded intrinsics of one camera, given ones of the other, with the given baseline.
    assert_eq!(model.cameras[0].left.fx, lens("left_shoulder/left").k[0]);
    assert_eq!(
        model.cameras[1].left,
        rig_overrides.calibrations["feet"].left
    );
    assert_eq!(
        model.cameras[1].right_from_left.translation_m(),
        [-0.063, 0.0, 0.0]
    );
    assert_eq!(model.imus[0].rate_hz, Some(200.0));
    assert!(model.imus[0].noise.is_some() && model.imus[0].range.is_some());
    let input = Input::open(folder.path()).expect("open");
    assert_eq!(rig::model(&input, &rig_overrides).expect("a rig").0, model);
    let odometry_rig = rig::odometry_rig(&model);
    assert_eq!(odometry_rig.cameras[1].name, "feet");

    let second = stage(&arguments);
    assert_eq!(second["state"], "up_to_date");
    assert_eq!(second["outputs"], first["outputs"]);
    assert_eq!(second["notes"], first["notes"]);
    let mut more = arguments.to_vec();
    more.push("--force");
    // Camera images are not part of the bundle: it is written although they cannot be.
    let seen = Path::new(&out).join("seen.jsonl");
    fs::remove_file(&seen).expect("it was written");
    fs::create_dir(&seen).expect("a folder");
    assert_eq!(stage(&more)["state"], "ran");
    assert!(!Path::new(&out).join("seen.jsonl.new").exists());
    fs::remove_dir(&seen).expect("empty");
    more.truncate(arguments.len());
    more.extend(["--line-us", "feet=22.5"]);
    let third = stage(&more);
    assert_eq!(third["state"], "ran");
    assert_ne!(third["outputs"], first["outputs"]);
    let scene = Scene::open(out.as_ref()).expect("a bundle");
    let reader = scene.output("rig").expect("an output");
    let line_s = outputs::rig::read(&reader).expect("a rig").cameras[1].line_s;
    assert!((line_s - 22.5e-6).abs() < 1e-15);

    // Wrong arguments, and a bundle of another session.
    for wrong in [
        vec![&*session, "--out", &out, "--to", "rigs"],
        vec![&*session, "--out", &out, "--line-us", "feet"],
        vec![&*session, "--out", &out, "--preset", "best"],
        vec![
            &*session,
            "--out",
            &out,
            "--from",
            "depth",
            "--line-us",
            "feet=2",
        ],
        vec![&*session],
    ] {
        assert_eq!(run(&wrong).status.code(), Some(2), "{wrong:?}");
    }
    let output = run(&[&session, "--out", &out, "--line-us", "head=2"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(errors(&output).contains("no camera \"head\", expected one of left_shoulder, feet"));
}

#[test]
fn the_folder_of_a_calibration_gives_a_session_intrinsics_and_extrinsics() {
    let folder = tempfile::tempdir().expect("folder");
    hand_over(folder.path());
    let before = fs::read(folder.path().join("handoff.json")).expect("a hand-off");
    let rig_overrides = rig_overrides(folder.path());
    let set = CameraSet::of_stereo(&rig_overrides.calibrations["feet"]);
    let [(_, feet)] = &contents(&set, Format::OpenCv).expect("a file")[..] else {
        panic!("several files");
    };
    let outside = tempfile::tempdir().expect("folder");
    let calibration = outside.path().join("calibration");
    fs::create_dir(&calibration).expect("a folder");
    let place = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let (session, out, given) = (
        place(folder.path()),
        place(&outside.path().join("bundle")),
        place(&calibration),
    );
    let mended = [
        &*session,
        "--out",
        &out,
        "--to",
        "rig",
        "--calibration",
        &given,
    ];

    // It has no calibration yet.
    let output = run(&mended);
    assert_eq!(output.status.code(), Some(1));
    let said = errors(&output);
    assert!(
        said.contains(
            "found neither rig.toml nor rig-imu.toml nor left_shoulder.yaml nor feet.yaml"
        ) && said.contains("`paws calib cameras "),
        "{said}"
    );
    fs::write(calibration.join("rig.toml"), RIG).expect("a file");
    fs::write(calibration.join("feet.yaml"), feet).expect("a file");
    let output = run(&mended);
    assert_eq!(output.status.code(), Some(0), "{}", errors(&output));
    let said = errors(&output);
    let hash = blake3::hash(feet).to_hex();
    let note = format!("with precedence over its content: feet.yaml, blake3 {hash}");
    assert!(said.contains(&note), "{said}");
    let scene = Scene::open(out.as_ref()).expect("a bundle");
    let settings = &scene.manifest().outputs["rig"].settings;
    assert_eq!(settings["given"][0]["file"], "rig.toml");
    assert_eq!(settings["given"][1]["blake3"], hash.as_str());
    let reader = scene.output("rig").expect("an output");
    let model = outputs::rig::read(&reader).expect("a rig");
    let feet = model.cameras.iter().find(|c| c.name == "feet");
    let fx = feet.expect("feet").left.fx;
    assert!((fx - rig_overrides.calibrations["feet"].left.fx).abs() < 1e-9);
    // The session is unchanged.
    let after = fs::read(folder.path().join("handoff.json")).expect("a hand-off");
    assert_eq!(after, before);

    // With IMUs the other rig file is taken, unless it is of other cameras than the first.
    let other = RIG.replace("nominal-1", "nominal-1-imu");
    fs::write(calibration.join("rig-imu.toml"), &other).expect("a file");
    let output = run(&mended);
    assert_eq!(output.status.code(), Some(0), "{}", errors(&output));
    let scene = Scene::open(out.as_ref()).expect("a bundle");
    assert_eq!(
        scene.manifest().outputs["rig"].settings["given"][0]["file"],
        "rig-imu.toml"
    );
    let stale = other.replace("[0.08, 0.0315, -0.12]", "[0.08, 0.0315, -0.11]");
    fs::write(calibration.join("rig-imu.toml"), stale).expect("a file");
    let output = run(&mended);
    assert_eq!(output.status.code(), Some(1));
    let said = errors(&output);
    assert!(
        said.contains("different poses of feet") && said.contains("`paws calib camera-imu "),
        "{said}"
    );
}

/// Where a toy stage aborts.
const DIES: &str = "PAWS_TEST_DIES";
const FOLDER: &str = "PAWS_TEST_FOLDER";

/// Writes many files, and aborts before the given one.
struct Toy {
    name: &'static str,
    inputs: &'static [&'static str],
    outputs: &'static [&'static str],
}

/// Files of a toy stage in each of its outputs.
const FILES: usize = 3;

impl Stage<str> for Toy {
    fn name(&self) -> &'static str {
        self.name
    }
    fn version(&self) -> u32 {
        1
    }
    fn inputs(&self) -> &'static [&'static str] {
        self.inputs
    }
    fn outputs(&self) -> &'static [&'static str] {
        self.outputs
    }
    fn settings(&self) -> Value {
        json!({})
    }
    fn run(&self, work: &Work<'_, str>) -> Result<(), StageError> {
        let dies = std::env::var(DIES).unwrap_or_default();
        let mut step = 0;
        let mut may_die = || {
            if dies == format!("{}{step}", self.name) {
                std::process::abort();
            }
            step += 1;
        };
        let mut text = work.source().to_owned();
        for input in self.inputs.iter().filter(|i| **i != "handoff") {
            let bytes = work.read(input)?.read("2")?;
            text += std::str::from_utf8(&bytes)?;
        }
        for output in self.outputs {
            for file in 0..FILES {
                may_die();
                let line = format!("{output} {file} of {text}");
                work.draft(output)
                    .write(&file.to_string(), line.as_bytes())?;
            }
        }
        may_die();
        Ok(())
    }
}

fn run_toys(folder: &Path) -> Vec<State> {
    let toy = |name, inputs, outputs| -> Box<dyn Stage<str>> {
        Box::new(Toy {
            name,
            inputs,
            outputs,
        })
    };
    let stages = vec![
        toy("a", &["handoff"], &["a"]),
        toy("b", &["handoff", "a"], &["b", "c"]),
        toy("d", &["c"], &["d"]),
    ];
    let pipeline = Pipeline::new(stages, &["handoff"]).expect("a good table");
    let provenance = Provenance {
        session_id: "s".to_owned(),
        handoff_blake3: "0".repeat(64),
        judgement: None,
        rig: RigRevision {
            name: "rig".to_owned(),
            revision: "1".to_owned(),
        },
        program: "test".to_owned(),
        program_version: "0".to_owned(),
        started_civil_ns: 0,
        ended_civil_ns: None,
    };
    let bundle = Bundle::create_or_open(folder, provenance).expect("a bundle");
    let sources = Sources {
        source: "walk",
        hashes: BTreeMap::from([("handoff".to_owned(), "0".repeat(64))]),
    };
    let selection = Selection::default();
    let outcomes = pipeline.run(
        &sources,
        &bundle,
        &selection,
        &observer::NoObserver,
        &Meter::STILL,
    );
    outcomes.expect("toys").iter().map(|o| o.state).collect()
}

/// Not a test: the process that aborts, started by the test below.
#[test]
fn dying() {
    if let Some(folder) = std::env::var_os(FOLDER) {
        run_toys(folder.as_ref());
    }
}

#[test]
fn damaged_outputs_are_recomputed() {
    let folder = tempfile::tempdir().expect("folder");
    assert_eq!(run_toys(folder.path()), [State::Ran; 3]);
    let scene = Scene::open(folder.path()).expect("a bundle");
    let file = scene.output("c").expect("an output").file_path("1");
    let mut bytes = fs::read(&file).expect("a file");
    bytes[3] ^= 1;
    fs::write(&file, bytes).expect("damaged");
    // Later stages were computed from the same bytes.
    assert_eq!(
        run_toys(folder.path()),
        [State::UpToDate, State::Ran, State::UpToDate]
    );
    let scene = Scene::open(folder.path()).expect("a bundle");
    let checked = scene_bundle::verify::verify(&scene, |_| {}).expect("a bundle");
    assert!(checked.is_whole());
}

#[test]
fn after_a_kill_at_any_step_the_next_run_resumes_the_stage_in_progress() {
    let whole = tempfile::tempdir().expect("folder");
    assert_eq!(run_toys(whole.path()), [State::Ran; 3]);
    let hashes = |folder: &Path| -> BTreeMap<String, String> {
        let scene = Scene::open(folder).expect("a bundle");
        let outputs = scene.manifest().outputs.iter();
        outputs
            .map(|(name, output)| (name.clone(), output.hash.clone()))
            .collect()
    };
    let expected = hashes(whole.path());
    for (number, (name, outputs)) in [("a", 1), ("b", 2), ("d", 1)].into_iter().enumerate() {
        for step in 0..=outputs * FILES {
            let folder = tempfile::tempdir().expect("folder");
            let mut child = Command::new(std::env::current_exe().expect("this program"));
            let status = child
                .args(["--exact", "stages::dying"])
                .env(FOLDER, folder.path())
                .env(DIES, format!("{name}{step}"))
                .output()
                .expect("start")
                .status;
            assert!(!status.success(), "{name}{step} did not die");
            // Committed outputs are intact.
            let scene = Scene::open(folder.path()).expect("a bundle");
            let checked = scene_bundle::verify::verify(&scene, |_| {}).expect("a bundle");
            assert!(checked.is_whole());
            assert_eq!(checked.outputs.len(), [0, 1, 3][number]);
            let states = run_toys(folder.path());
            let made: Vec<bool> = states.iter().map(|s| *s == State::Ran).collect();
            let expected_made: Vec<bool> = (0..3).map(|k| k >= number).collect();
            assert_eq!(made, expected_made, "{name}{step}");
            assert_eq!(hashes(folder.path()), expected);
        }
    }
}
