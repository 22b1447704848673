//! Trajectories against ground truth, by the program, and by evo where it is installed.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use cad_transforms::RigidTransform;
use reconstruction::evaluate::{Alignment, Delta, Settings, Statistics, evaluate};
use scene_bundle::formats::{kitti, tum};
use scene_bundle::outputs::{TRAJECTORY, trajectory};
use scene_bundle::{Bundle, Pose, Provenance, Record, RigRevision, Status, Trajectory};
use serde_json::Value;

fn run(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws-reconstruct"));
    command
        .arg("evaluate")
        .args(arguments)
        .output()
        .expect("run")
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).expect("UTF-8")
}

/// Numbers that look random, from 0 to 1.
fn uniform(state: &mut u64) -> f64 {
    *state = state
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1);
    (*state >> 11) as f64 / (1_u64 << 53) as f64
}

/// Some 40 m of a path with rotations, at 20 Hz.
fn truth() -> Trajectory {
    let poses = (0..600).map(|i| {
        let s = f64::from(i) * 0.05;
        let turn = [0.1 * (2.0 * s).sin(), 0.05 * s.cos(), 0.25 * s];
        let place = [
            5.0 * (0.25 * s).sin(),
            1.3 * s * 0.5,
            1.3 + 0.2 * (1.7 * s).sin(),
        ];
        let pose = RigidTransform::from_rotation_vector(turn, place).expect("finite");
        Pose::new(1_700_000_000_000_000_000 + i64::from(i) * 50_000_000, pose)
    });
    Trajectory::new(poses.collect()).expect("rising")
}

/// An estimate of the path: in another world, with drift, jitter, other times and missing poses.
fn estimated(seed: u64) -> Trajectory {
    let mut state = seed;
    let away = RigidTransform::from_rotation_vector([0.4, -0.2, 1.9], [3.0, -8.0, 0.5]);
    let away = away.expect("finite");
    let mut drift = RigidTransform::identity();
    let mut poses = Vec::new();
    for pose in truth().poses() {
        let mut around = || uniform(&mut state) - 0.5;
        let motion = |w: f64, v: f64, around: &mut dyn FnMut() -> f64| {
            let w = [w * around(), w * around(), w * around()];
            RigidTransform::from_rotation_vector(w, [v * around(), v * around(), v * around()])
                .expect("finite")
        };
        drift = drift * motion(2e-3, 5e-3, &mut around);
        let shake = motion(1e-2, 2e-2, &mut around);
        let late_ns = (2.4e7 * around()) as i64;
        if around() < -0.4 {
            continue;
        }
        let found = away * pose.world_from_rig * drift * shake;
        let mut found = Pose::new(pose.time_ns + late_ns, found);
        let [x, y, z] = found.world_from_rig.translation_m().map(|v| 0.9 * v);
        let turn = found.world_from_rig.rotation_wxyz();
        found.world_from_rig = RigidTransform::from_wxyz(turn, [x, y, z]).expect("finite");
        poses.push(found);
    }
    Trajectory::new(poses).expect("rising")
}

#[test]
fn the_table_has_the_errors_and_names_the_worst_run() {
    let folder = tempfile::tempdir().expect("folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).expect("a file");
        path.to_str().expect("UTF-8").to_owned()
    };
    let truth_file = write("truth.tum", &tum::to_text(&truth()));
    let good = write("good.tum", &tum::to_text(&truth()));
    let bad = write("bad.tum", &tum::to_text(&estimated(1)));
    let half = truth().into_poses();
    let half = Trajectory::new(half[..300].to_vec()).expect("rising");
    let half = write("half.tum", &tum::to_text(&half));

    let output = run(&[&good, &bad, "--truth", &truth_file]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let text = stdout(&output);
    let last = text.lines().last().expect("a summary");
    assert!(
        last.starts_with("worst: bad.tum; mean of 2: ATE "),
        "{text}"
    );

    assert!(
        text.contains(
            "over segments from every pose; evo_rpe's default is --over 1f --consecutive"
        ),
        "{text}"
    );
    let consecutive = ["--over", "1f", "--consecutive"];
    let output = run(&[&[&bad[..], "--truth", &truth_file], &consecutive[..]].concat());
    let text = stdout(&output);
    assert!(
        text.contains("1 poses: m") && text.contains("over consecutive segments"),
        "{text}"
    );

    let output = run(&[&good, &half, &bad, "--truth", &truth_file]);
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    let text = stdout(&output);
    let last = text.lines().last().expect("a summary");
    assert_eq!(last, "worst: half.tum; mean: none, lost 1 of 3");
    let twice = stdout(&run(&[&good, &good, "--truth", &truth_file]));
    assert!(twice.contains(&format!("worst: {good}; ")), "{twice}");

    let cost = write(
        "cost.jsonl",
        "{\"stage\":\"rig\",\"state\":\"ran\",\"seconds\":9.0,\"peak_bytes\":9}\n\
         {\"stage\":\"odometry\",\"state\":\"ran\",\"seconds\":12.5,\"peak_bytes\":1000000}\n\
         {\"stage\":\"bundle-adjustment\",\"state\":\"ran\",\"seconds\":2.5,\"peak_bytes\":3000000}\n",
    );
    let arguments = [
        &good,
        "--truth",
        &truth_file,
        "--cost",
        &cost,
        "--json",
        "--over",
        "3m",
    ];
    let json: Value = serde_json::from_slice(&run(&arguments).stdout).expect("JSON");
    let only = &json["runs"][0];
    assert_eq!(only["cost"]["seconds"], 15.0);
    assert_eq!(only["cost"]["peak_bytes"], 3_000_000);
    assert_eq!(only["matched"], 600);
    assert_eq!(only["relative"][0]["delta"]["metres"], 3.0);
    assert!(
        only["absolute"]["translation_m"]["rmse"]
            .as_f64()
            .expect("a number")
            < 1e-9
    );

    let rows = write("rows.txt", &kitti::to_text(&truth()).0);
    let output = run(&[&rows, "--truth", &truth_file]);
    assert_eq!(output.status.code(), Some(1));
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        errors.contains("found KITTI poses without a times.txt"),
        "{errors}"
    );
    assert_eq!(run(&[&rows, "--truth", &rows]).status.code(), Some(0));
    for wrong in [
        vec!["--truth", &truth_file],
        vec![&good, "--truth", &truth_file, "--over", "3"],
        vec![
            &good,
            "--truth",
            &truth_file,
            "--cost",
            &cost,
            "--cost",
            &cost,
        ],
        vec![&good, "--truth", &truth_file, "--align", "best"],
    ] {
        assert_eq!(run(&wrong).status.code(), Some(2), "{wrong:?}");
    }
}

/// A simulated walk continues after its recording has stopped; a recording without poses is still a
/// gap.
#[test]
fn a_bundle_is_complete_where_it_was_recorded() {
    let folder = tempfile::tempdir().expect("folder");
    let truth_file = folder.path().join("truth.tum");
    fs::write(&truth_file, tum::to_text(&truth())).expect("a file");
    let truth_file = truth_file.to_str().expect("UTF-8");
    let mut recorded = truth().into_poses();
    recorded.truncate(300);
    for pose in &mut recorded[200..220] {
        pose.status = Status::Lost;
    }
    let recorded = Trajectory::new(recorded).expect("rising");

    let scene = folder.path().join("walk.scene");
    let provenance = Provenance {
        session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
        handoff_blake3: "ab".repeat(32),
        judgement: None,
        rig: RigRevision {
            name: "chest".to_owned(),
            revision: "B".to_owned(),
        },
        program: "paws-reconstruct".to_owned(),
        program_version: "0.1.0".to_owned(),
        started_civil_ns: 1_700_000_000_000_000_000,
        ended_civil_ns: None,
    };
    let bundle = Bundle::create_or_open(&scene, provenance).expect("a new bundle");
    let draft = bundle.begin(TRAJECTORY).expect("a draft");
    trajectory::write(&draft, &recorded).expect("written");
    let record = Record {
        stage: "bundle-adjustment".to_owned(),
        stage_version: 1,
        settings: serde_json::json!({}),
        inputs: BTreeMap::from([("handoff".to_owned(), "ab".repeat(32))]),
    };
    draft.commit(record).expect("committed");

    let scene = scene.to_str().expect("UTF-8");
    let completion = |arguments: &[&str]| {
        let output = run(&[arguments, &["--truth", truth_file, "--json"]].concat());
        let runs: Value = serde_json::from_str(&stdout(&output)).expect("JSON");
        let found = runs["runs"][0]["completion"]["share"].as_f64();
        (output.status.code(), found.expect("a number"))
    };
    // From pose 199 to 220 there is none, of 299 steps.
    let (code, share) = completion(&[scene, "--least-completion", "90"]);
    assert_eq!(code, Some(0));
    assert!((share - (1.0 - 21.0 / 299.0)).abs() < 1e-9, "{share}");

    // A file does not contain the end of the recording.
    let file = folder.path().join("walk.tum");
    fs::write(&file, tum::to_text(&recorded)).expect("a file");
    let (code, share) = completion(&[file.to_str().expect("UTF-8")]);
    assert_eq!(code, Some(3));
    assert!(share < 0.5, "{share}");
}

/// Script with evo's results for two TUM files: for each alignment RMSE, mean, median and maximum
/// of the absolute errors of positions and rotations, and number, RMSE and maximum of the relative
/// ones, of positions and rotations, over 2 m and over 7 poses.
const EVO: &str = "
import copy, json, sys
import numpy as np
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from evo.core.units import Unit

def read(path):
    m = np.loadtxt(path, comments='#')
    return PoseTrajectory3D(m[:, 1:4], m[:, [7, 4, 5, 6]], m[:, 0])

truth, estimate = sync.associate_trajectories(read(sys.argv[1]), read(sys.argv[2]))
found = {'matched': truth.num_poses}
for name in ('none', 'se3', 'sim3', 'first'):
    aligned = copy.deepcopy(estimate)
    if name == 'first':
        aligned.align_origin(truth)
    elif name != 'none':
        aligned.align(truth, correct_scale=name == 'sim3')
    values = []
    for part in ('translation_part', 'rotation_angle_rad'):
        part = metrics.PoseRelation[part]
        ape = metrics.APE(part)
        ape.process_data((truth, aligned))
        s = ape.get_all_statistics()
        values += [s['rmse'], s['mean'], s['median'], s['max']]
        for delta, unit in ((2.0, Unit.meters), (7, Unit.frames)):
            rpe = metrics.RPE(part, delta, unit, pairs_from_reference=True)
            rpe.process_data((truth, aligned))
            s = rpe.get_all_statistics()
            values += [len(rpe.error), s['rmse'], s['max']]
    found[name] = [float(v) for v in values]
json.dump(found, sys.stdout)
";

fn evo(interpreter: &Path, truth: &Path, estimate: &Path) -> Value {
    let mut command = Command::new(interpreter);
    let output = command.arg("-c").arg(EVO).arg(truth).arg(estimate).output();
    let output = output.expect("start python");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "evo says: {errors}");
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// evo needs Python 3.11, which not every machine that runs the other Python readers has, so it is
/// not among them.
#[test]
fn evo_finds_the_same() {
    let named = ["PAWS_EVO_PYTHON", "PAWS_PYTHON"];
    let interpreters = named.iter().filter_map(std::env::var_os).map(PathBuf::from);
    let has_evo = |python: &PathBuf| {
        let mut command = Command::new(python);
        let output = command.args(["-c", "import evo.core.metrics"]).output();
        output.is_ok_and(|o| o.status.success())
    };
    let Some(interpreter) = interpreters.into_iter().find(has_evo) else {
        eprintln!("skipped: neither PAWS_EVO_PYTHON nor PAWS_PYTHON names an interpreter with evo");
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let write = |name: &str, trajectory: &Trajectory| {
        let path = folder.path().join(name);
        fs::write(&path, tum::to_text(trajectory)).expect("a file");
        path
    };
    let truth_file = write("truth.tum", &truth());
    for seed in 1..4 {
        let estimate = estimated(seed);
        let theirs = evo(&interpreter, &truth_file, &write("estimate.tum", &estimate));
        for alignment in Alignment::ALL {
            let settings = Settings {
                alignment,
                deltas: vec![Delta::Meters(2.0), Delta::Poses(7)],
                overlapping: false,
                ..Settings::default()
            };
            let ours = evaluate(&estimate, &truth(), &settings);
            assert_eq!(theirs["matched"], ours.matched);
            assert!(ours.matched > 300 && ours.matched < 599, "{}", ours.matched);
            let absolute = ours.absolute.expect("enough");
            let mut values = Vec::new();
            let parts: [fn(&reconstruction::evaluate::Relative) -> Option<Statistics>; 2] =
                [|r| r.translation_m, |r| r.rotation_rad];
            let rotation = absolute.rotation_rad.expect("turns");
            for (of, part) in [absolute.translation_m, rotation].into_iter().zip(parts) {
                values.extend([of.rmse, of.mean, of.median, of.max]);
                for relative in &ours.relative {
                    let of = part(relative).expect("stretches");
                    values.extend([of.count as f64, of.rmse, of.max]);
                }
            }
            let theirs = theirs[alignment.name()].as_array().expect("numbers");
            assert_eq!(theirs.len(), values.len());
            for (k, (ours, theirs)) in values.iter().zip(theirs).enumerate() {
                let theirs = theirs.as_f64().expect("a number");
                // Their seconds are floating point, ours are not; poses are the same.
                let apart = (ours - theirs).abs();
                assert!(
                    apart < 1e-6,
                    "{alignment:?}, value {k}: {ours} and {theirs}"
                );
            }
        }
    }
}
