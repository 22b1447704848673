//! The program itself: arguments, exit codes, output.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

use crate::support::{ID, Session};

fn paws(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_paws"))
        .args(arguments)
        .current_dir(folder)
        .env("PAWS_LIBRARY", folder.join("library"))
        .output()
        .unwrap()
}

fn check(folder: &Path, arguments: &[&str], code: i32, part: &str) -> String {
    let output = paws(folder, arguments);
    let text = format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
    assert!(
        text.contains(part),
        "{arguments:?}: {part:?} is not in {text}"
    );
    text
}

#[test]
fn the_main_job() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    Session::good(2.0).write(&at.join("disk/day/walk-7"));
    check(at, &["import", "disk"], 0, ": imported, 2.0 s");
    check(at, &["import", "disk"], 0, ": imported already");
    let text = check(
        at,
        &["validate", "walk-7", "--html", "r.html", "--json", "r.json"],
        0,
        "PASS",
    );
    let last = text.lines().last().unwrap();
    assert!(last.starts_with(&format!("PASS  {ID}: all of ")), "{last}");
    let json = fs::read(at.join("r.json")).unwrap();
    let kept = fs::read(at.join(format!("library/sessions/{ID}/validation.json"))).unwrap();
    assert_eq!(json, kept);
    assert!(
        fs::read_to_string(at.join("r.html"))
            .unwrap()
            .starts_with("<!DOCTYPE html>")
    );
    check(at, &["index", "walk"], 0, "3 cameras");
    let path = check(at, &["handoff", ID], 0, "handoff.json");
    assert!(Path::new(path.trim_end()).is_file());
    check(at, &["list"], 0, "PASS");
    check(at, &["show", "walk"], 0, "sealed");
    check(at, &["report", "walk"], 0, "report.html");
    check(at, &["rebuild"], 0, "1 session listed");
    check(
        at,
        &["export", "walk", "--format", "csv", "--out", "csv"],
        0,
        "feet_imu.csv: 400 rows",
    );
    check(at, &["prune"], 0, "removed 4 derived files");
    check(at, &["prune", "--session", ID], 1, "repeat it with --yes");
    // A name, a beginning or an empty variable is not enough to remove a recording.
    for text in ["walk", "0", ""] {
        check(at, &["prune", "--session", text, "--yes"], 1, "session");
        assert!(at.join(format!("library/sessions/{ID}")).is_dir());
    }
    check(at, &["show", ""], 1, "its name is empty");
    check(at, &["prune", "--session", ID, "--yes"], 0, "removed");
    check(at, &["list"], 0, "no sessions");
}

#[test]
fn exit_codes_tell_loss_from_failure_from_slips() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut session = Session::good(10.0);
    session.drop_frames(0, 200, 200, true);
    session.write(&at.join("lossy"));
    let mut session = Session::good(2.0);
    session.transforms = None;
    session.write(&at.join("unplaced"));
    let mut session = Session::good(2.0);
    session.closed = false;
    session.write(&at.join("cut"));
    // A warning with loss, one without, a failure.
    check(at, &["validate", "lossy"], 3, "WARN");
    check(at, &["validate", "unplaced"], 0, "WARN");
    check(
        at,
        &["validate", "lossy", "--limit", "camera.dropped=0,0.001"],
        1,
        "FAIL",
    );
    check(at, &["validate", "lossy", "unplaced"], 3, "WARN");
    check(at, &["import", "cut"], 3, "unclosed");
    check(at, &["import", "nowhere"], 1, "nowhere");
    check(at, &["import", "."], 1, "differs");

    check(at, &[], 2, "Usage");
    check(at, &["--help"], 0, "Usage");
    check(at, &["import"], 2, "SRC");
    check(
        at,
        &["validate", "lossy", "--limit", "camera.droped=1,2"],
        2,
        "did you mean camera.dropped?",
    );
    check(
        at,
        &["validate", "lossy", "cut", "--json", "x"],
        2,
        "one session at a time",
    );
    check(
        at,
        &["validate", "nonsense"],
        1,
        "looking for session \"nonsense\"",
    );
    check(
        at,
        &["export", "lossy", "--format", "avi", "--out", "x"],
        2,
        "euroc",
    );
    let output = Command::new(env!("CARGO_BIN_EXE_paws"))
        .arg("list")
        .env_remove("PAWS_LIBRARY")
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(
        text.contains("--library DIR, or set PAWS_LIBRARY"),
        "{text}"
    );
}

#[test]
fn an_unknown_verb_is_a_program_or_a_slip() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    check(at, &["validat"], 2, "did you mean validate?");
    check(at, &["frobnicate"], 2, "`paws --help` lists the verbs");
    let program = at.join("paws-hello");
    fs::write(&program, "#!/bin/sh\necho hello $1; exit 7\n").unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_paws"))
        .args(["hello", "world"])
        .env(
            "PATH",
            format!("{}:{}", at.display(), std::env::var("PATH").unwrap()),
        )
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(7));
    assert_eq!(output.stdout, b"hello world\n");
}

#[test]
fn metrics_are_listed_as_limits_take_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let text = check(at, &["validate", "--metrics"], 0, "METRIC");
    for row in collector::limits::TABLE {
        let line = text.lines().find(|line| line.starts_with(row.metric));
        let words: Vec<&str> = line.unwrap().split_whitespace().collect();
        assert!(line.unwrap().contains(row.title), "{line:?}");
        // What is listed can be set as it stands there.
        let mut limits = collector::limits::Limits::default();
        let limit = format!("{}={},{}", words[0], words[2], words[3]);
        limits.set(&limit).unwrap();
        let set = limits.of(row.metric).unwrap();
        assert_eq!((set.warn, set.fail), (row.warn, row.fail), "{limit}");
    }
    let text = check(at, &["validate", "--metrics", "--json"], 0, "[");
    let rows: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
    assert_eq!(rows.len(), collector::limits::TABLE.len());
    let row = rows.iter().find(|row| row["metric"] == "imu.rate").unwrap();
    assert_eq!(row["warn"], 0.05);
    assert!(row["fail"].is_null() && row["unit"] == "ratio");

    check(at, &["validate"], 2, "SESSION");
    check(
        at,
        &["validate", "walk", "--metrics"],
        2,
        "cannot be used with",
    );
    check(
        at,
        &["validate", "walk", "--json"],
        2,
        "--json needs a FILE",
    );
    check(
        at,
        &["validate", "--metrics", "--json", "x"],
        2,
        "takes no FILE",
    );
}

#[test]
fn a_failure_is_handed_over_only_if_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut session = Session::good(4.0);
    session.drop_frames(0, 120, 122, true);
    session.write(&at.join("walk-8"));
    check(at, &["import", "walk-8"], 0, "imported");
    let dropped = "camera.dropped=never";
    check(at, &["validate", ID, "--limit", dropped], 0, "PASS");
    check(at, &["validate", ID], 1, "PASS \u{2192} FAIL");
    check(at, &["handoff", ID], 1, "not handed over");
    check(
        at,
        &["handoff", ID, "--accept", "warn"],
        1,
        "not handed over",
    );
    let text = check(at, &["handoff", ID, "--accept", "fail"], 3, "accepted");
    assert!(text.trim_end().ends_with("/handoff.json"), "{text}");
    check(at, &["handoff", ID], 3, "accepted");
    let handed = check(
        at,
        &["handoff", ID, "--limit", dropped],
        0,
        "FAIL \u{2192} PASS",
    );
    assert!(handed.trim_end().ends_with("/handoff.json"), "{handed}");
    check(at, &["handoff", ID, "--accept", "PASS"], 2, "WARN, FAIL");
    check(
        at,
        &["handoff", ID, "--limit", "camera.droped=1,2"],
        2,
        "--metrics",
    );
}
