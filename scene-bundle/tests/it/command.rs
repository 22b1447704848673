//! The command line: what it says and with which code it ends.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::sample::Sample;

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_paws-scene"))
        .args(arguments)
        .output()
        .expect("start paws-scene")
}

fn code(output: &Output) -> i32 {
    output.status.code().expect("an exit code")
}

fn out_text(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).expect("UTF-8")
}

fn error_text(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).expect("UTF-8")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

#[test]
fn show_says_what_is_there() {
    let sample = Sample::new();
    let shown = run(&["show", text(&sample.path)]);
    assert_eq!(code(&shown), 0, "{}", error_text(&shown));
    let shown = out_text(&shown);
    for expected in [
        "session            01890a5d-ac96-774b-bcce-b302099a8057\n",
        "rig                chest, revision B\n",
        "begun, ended       2014-06-25T16:54:33Z, 2014-06-25T16:54:42Z\n",
        "trajectory         make-trajectory 1, 2 files, ",
        "cameras: left_shoulder, feet\n",
        "statuses: 10 tracked, 10 dead reckoned, 10 relocalised, 10 lost\n",
        "points: 500\n",
        "views: feet 60x40\n",
    ] {
        assert!(shown.contains(expected), "{expected:?} in\n{shown}");
    }
    assert!(shown.lines().all(|line| line.trim_end() == line));
    assert!(shown.ends_with("\n7 outputs, 0 problems\n"), "{shown}");

    let json = run(&["show", "--json", text(&sample.path.join("scene.json"))]);
    let json: Value = serde_json::from_slice(&json.stdout).expect("JSON");
    assert_eq!(json["facts"]["trajectory"]["poses"], 40);
    assert_eq!(
        json["manifest"]["provenance"]["session_id"],
        "01890a5d-ac96-774b-bcce-b302099a8057"
    );
}

#[test]
fn verify_ends_with_1_when_a_byte_changed() {
    let sample = Sample::new();
    let fine = run(&["verify", text(&sample.path)]);
    assert_eq!(code(&fine), 0, "{}", error_text(&fine));
    assert!(
        out_text(&fine).contains("7 outputs, 18 files, every byte is as it was written"),
        "{}",
        out_text(&fine)
    );

    std::fs::write(sample.path.join("notes.txt"), "mine").unwrap();
    let noted = run(&["verify", text(&sample.path)]);
    assert_eq!(
        (code(&noted), error_text(&noted).as_str()),
        (0, "nothing names notes.txt\n")
    );

    let place = sample
        .scene()
        .output("trajectory")
        .unwrap()
        .place("trajectory.npy");
    let mut bytes = std::fs::read(&place).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&place, bytes).unwrap();
    let bad = run(&["verify", text(&sample.path)]);
    assert_eq!(code(&bad), 1);
    assert!(
        error_text(&bad)
            .contains("trajectory: reading a scene bundle: found content with the hash")
    );
    assert!(out_text(&bad).contains("1 problems"));
    // It can still be shown, with a loss.
    let shown = run(&["show", text(&sample.path)]);
    assert_eq!(code(&shown), 3);
    assert!(error_text(&shown).starts_with("lost: "));
}

#[test]
fn export_ends_with_what_happened() {
    let sample = Sample::new();
    let bundle = text(&sample.path).to_owned();
    let out = sample.out("walk.txt");
    let arguments = [
        "export",
        "--format",
        "tum",
        &bundle,
        "--out",
        text(&out),
        "--trajectory",
        "causal",
    ];
    let first = run(&arguments);
    assert_eq!(code(&first), 0, "{}", error_text(&first));
    assert_eq!(
        out_text(&first),
        format!("tum: 30 poses of the rig: {}\n", out.display())
    );
    let second = run(&arguments);
    assert_eq!(code(&second), 1);
    assert!(error_text(&second).contains("not overwritten"));

    let pictures = sample.pictures("feet/left/1000010.png");
    let out = sample.out("model");
    let lossy = run(&[
        "export",
        "--format",
        "colmap-binary",
        &bundle,
        "--out",
        text(&out),
        "--pictures",
        text(&pictures),
    ]);
    assert_eq!(code(&lossy), 3, "{}", error_text(&lossy));
    assert!(
        out_text(&lossy)
            .starts_with("colmap-binary: 5 images of 2 cameras, 500 points, 1 losses: ")
    );

    for arguments in [
        &["export", "--format", "docx", &bundle, "--out", "x"][..],
        &["export", "--format", "tum", &bundle],
        &["show"],
        &["paint"],
    ] {
        assert_eq!(code(&run(arguments)), 2, "{arguments:?}");
    }
    let missing = run(&["show", text(&sample.out("nowhere"))]);
    assert_eq!(code(&missing), 1);
    assert!(
        error_text(&missing).contains("found no scene.json"),
        "{}",
        error_text(&missing)
    );
}
