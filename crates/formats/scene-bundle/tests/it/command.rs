//! The command line: its output and exit codes.

use std::path::Path;
use std::process::{Command, Output};

use scene_bundle::judgement::{Acceptance, ExceededLimit};
use scene_bundle::{Bundle, Judgement, Provenance};
use serde_json::Value;

use crate::sample::{START_NS, Sample, provenance};

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
fn show_lists_the_content() {
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
        "simplified triangles: 6\n",
        "cells: 12x8, 3x2\n",
        "free m2: 5.8125\n",
        "parts: 2 ground, 1 wall, 1 obstacle\n",
        "height error p95 m: 0.0125\n",
        "gaussians: 10\n",
        "held out psnr db: 24.5\n",
    ] {
        assert!(shown.contains(expected), "{expected:?} in\n{shown}");
    }
    assert!(shown.lines().all(|line| line.trim_end() == line));
    assert!(shown.ends_with("\n11 outputs, 0 problems\n"), "{shown}");

    let json = run(&["show", "--json", text(&sample.path.join("scene.json"))]);
    let json: Value = serde_json::from_slice(&json.stdout).expect("JSON");
    assert_eq!(json["facts"]["trajectory"]["poses"], 40);
    assert_eq!(
        json["manifest"]["provenance"]["session_id"],
        "01890a5d-ac96-774b-bcce-b302099a8057"
    );
}

#[test]
fn show_reports_an_accepted_failure_and_its_cause() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("walk.scene");
    let what = "feet: 3 of 60 frames lost (5 %): encoder overload";
    let beyond = ExceededLimit {
        metric: "camera.dropped".to_owned(),
        of: "feet".to_owned(),
        verdict: "FAIL".to_owned(),
        value: Some(0.05),
        warn: Some(0.0),
        fail: Some(0.01),
        unit: "ratio".to_owned(),
        text: what.to_owned(),
    };
    let judgement = Judgement {
        verdict: "FAIL".to_owned(),
        limits: vec!["imu.rate=0.05,never".to_owned()],
        acceptance: Some(Acceptance {
            level: "FAIL".to_owned(),
            accepted_civil_ns: START_NS,
            verdict: "FAIL".to_owned(),
            metrics: vec![beyond],
            limits: Vec::new(),
        }),
    };
    let provenance = Provenance {
        judgement: Some(judgement),
        ..provenance()
    };
    let bundle = Bundle::create_or_open(&path, provenance).unwrap();
    bundle.finish(START_NS).unwrap();

    let shown = run(&["show", text(&path)]);
    assert_eq!(code(&shown), 0, "{}", error_text(&shown));
    let shown = out_text(&shown);
    for expected in [
        "verdict            FAIL, accepted 2014-06-25T16:54:33Z (--accept FAIL), ",
        "(--accept FAIL), with limits imu.rate=0.05,never\n",
        &format!("\n{:18} FAIL  {what}\n", ""),
    ] {
        assert!(shown.contains(expected), "{expected:?} in\n{shown}");
    }
    let json = run(&["show", "--json", text(&path)]);
    let json: Value = serde_json::from_slice(&json.stdout).expect("JSON");
    let judgement = &json["manifest"]["provenance"]["judgement"];
    assert_eq!(judgement["acceptance"]["level"], "FAIL");
    assert_eq!(judgement["acceptance"]["metrics"][0]["text"], what);
}

/// Nothing on standard error where nothing failed, even where notes would be printed.
#[test]
fn quiet_prints_nothing_and_verbose_keeps_results_separate() {
    let sample = Sample::new();
    std::fs::write(sample.path.join("notes.txt"), "mine").unwrap();
    let bundle = text(&sample.path);
    let usual = run(&["show", bundle]);
    for (verb, options) in [
        ("show", &["-q"][..]),
        ("show", &["-v"]),
        ("show", &["-vv"]),
        ("verify", &["-q"]),
    ] {
        for arguments in [
            [options, &[verb, bundle]].concat(),
            [&[verb, bundle], options].concat(),
        ] {
            let output = run(&arguments);
            assert_eq!(code(&output), 0, "{arguments:?}: {}", error_text(&output));
            if options == ["-q"] {
                assert_eq!(error_text(&output), "", "{arguments:?}");
            }
            if verb == "show" {
                assert_eq!(output.stdout, usual.stdout, "{arguments:?}");
            }
        }
    }
    // Errors are printed nevertheless.
    let missing = run(&["-q", "show", text(&sample.out("nowhere"))]);
    assert_eq!(code(&missing), 1);
    assert!(error_text(&missing).contains("found no scene.json"));
    assert_eq!(code(&run(&["-q", "-v", "show", bundle])), 2);
}

#[test]
fn verify_ends_with_1_when_a_byte_changed() {
    let sample = Sample::new();
    let fine = run(&["verify", text(&sample.path)]);
    assert_eq!(code(&fine), 0, "{}", error_text(&fine));
    assert!(
        out_text(&fine).contains("11 outputs, 61 files, every byte is as it was written"),
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
        .file_path("trajectory.npy");
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
fn export_exit_code_reports_losses() {
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

    let images = sample.images("feet/left/1000010.png");
    let out = sample.out("model");
    let lossy = run(&[
        "export",
        "--format",
        "colmap-binary",
        &bundle,
        "--out",
        text(&out),
        "--images",
        text(&images),
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
