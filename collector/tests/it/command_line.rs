//! The program itself: arguments, exit codes, output.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use crate::support::{ID, Session, install, script};

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
fn import_validate_and_hand_off_work() {
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
    check(at, &["show", ""], 1, "name is empty");
    check(at, &["prune", "--session", ID, "--yes"], 0, "removed");
    check(at, &["list"], 0, "no sessions");
}

#[test]
fn exit_codes_distinguish_loss_failure_and_invalid_arguments() {
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
fn unknown_command_is_a_program_or_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    check(at, &["validat"], 2, "did you mean validate?");
    check(at, &["frobnicate"], 2, "`paws --help` lists the verbs");
    let program = at.join("paws-hello");
    script(&program, "echo hello $1; exit 7");
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
fn metrics_are_listed_in_the_form_of_limits() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let text = check(at, &["validate", "--metrics"], 0, "METRIC");
    for row in session_health::TABLE {
        let line = text.lines().find(|line| line.starts_with(row.metric));
        let words: Vec<&str> = line.unwrap().split_whitespace().collect();
        assert!(line.unwrap().contains(row.title), "{line:?}");
        // Listed limits can be set in the same form.
        let mut limits = session_health::Limits::default();
        let limit = format!("{}={},{}", words[0], words[2], words[3]);
        limits.set(&limit).unwrap();
        let set = limits.of(row.metric).unwrap();
        assert_eq!((set.warn, set.fail), (row.warn, row.fail), "{limit}");
    }
    let text = check(at, &["validate", "--metrics", "--json"], 0, "[");
    let rows: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
    assert_eq!(rows.len(), session_health::TABLE.len());
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
fn failed_session_is_handed_over_only_with_accept() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut session = Session::good(4.0);
    session.drop_frames(0, 120, 122, true);
    session.write(&at.join("walk-8"));
    let imported = check(at, &["import", "walk-8"], 0, "imported");
    assert!(imported.contains(" % of the frames missing"), "{imported}");
    let lost = |camera: &&str| imported.contains(&format!("; {camera}: "));
    let camera = ["left_shoulder", "right_shoulder", "feet"]
        .into_iter()
        .find(lost);
    let camera = camera.expect("the camera that lost frames");
    check(at, &["list"], 0, &format!("% of {camera}"));
    let dropped = "camera.dropped=never";
    check(at, &["validate", ID, "--limit", dropped], 0, "PASS");
    check(at, &["list"], 0, &format!("% of {camera}"));
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
/// Standard output alone, which must be JSON.
fn json(folder: &Path, arguments: &[&str], code: i32) -> Vec<serde_json::Value> {
    let output = paws(folder, arguments);
    assert_eq!(
        output.status.code(),
        Some(code),
        "{arguments:?}: {output:?}"
    );
    let text = String::from_utf8(output.stdout).unwrap();
    let documents = serde_json::Deserializer::from_str(&text).into_iter();
    documents.collect::<Result<_, _>>().unwrap()
}

#[test]
fn json_documents_agree_with_the_tables() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut session = Session::good(4.0);
    session.drop_frames(0, 100, 102, true);
    session.write(&at.join("walk-7"));
    let mut cut = Session::good(2.0);
    cut.closed = false;
    cut.spec.session_id = "0192aa00-0000-7000-8000-000000000002".to_owned();
    cut.spec.started_civil.0 += 1;
    cut.write(&at.join("cut"));

    let lines = json(at, &["import", "--json", "walk-7", "cut", "nowhere"], 1);
    assert_eq!(lines.len(), 3, "{lines:?}");
    let of = |part: &str| {
        let mut lines = lines.iter();
        let source = |l: &&serde_json::Value| l["source"].as_str().unwrap().ends_with(part);
        lines.find(source).unwrap()
    };
    let lost = |line: &serde_json::Value, name: &str| {
        let streams = line["streams"].as_array().unwrap();
        let stream = streams.iter().find(|s| s["name"] == name).unwrap().clone();
        let [missing, expected] = ["missing", "expected"].map(|key| stream[key].as_u64().unwrap());
        let share = missing as f64 / expected as f64;
        assert!((stream["share"].as_f64().unwrap() - share).abs() < 1e-12);
        (missing, expected)
    };
    assert_eq!(lost(of("walk-7"), "left_shoulder"), (3, 121));
    assert_eq!(lost(of("walk-7"), "feet/imu"), (0, 800));
    assert!(of("nowhere")["streams"].as_array().unwrap().is_empty());
    for line in &lines {
        assert_eq!(
            (&line["format"], &line["version"]),
            (&"paws-import-line".into(), &1.into())
        );
    }
    assert_eq!(
        (&of("walk-7")["result"], &of("walk-7")["key"]),
        (&"imported".into(), &ID.into())
    );
    assert_eq!(of("cut")["condition"], "unclosed");
    assert_eq!(of("nowhere")["result"], "failed");
    assert!(of("nowhere")["key"].is_null() && of("nowhere")["error"].is_string());
    let again = json(at, &["import", "walk-7", "--json"], 0);
    assert_eq!(
        (&again[0]["result"], &again[0]["copied_bytes"]),
        (&"already".into(), &0.into())
    );

    let list = json(at, &["list", "--json"], 0);
    let [list] = &list[..] else {
        panic!("one document: {list:?}");
    };
    assert_eq!(
        (&list["format"], &list["version"]),
        (&"paws-list".into(), &1.into())
    );
    let sessions = list["sessions"].as_array().unwrap();
    let keys: Vec<_> = sessions
        .iter()
        .map(|s| s["key"].as_str().unwrap())
        .collect();
    assert_eq!(keys, [ID, &cut.spec.session_id]);
    assert_eq!(sessions[0]["cameras"].as_array().unwrap().len(), 3);
    assert_eq!(sessions[0]["imus"], serde_json::json!(["feet/imu"]));
    assert_eq!(sessions[0]["missing"], 3);
    assert_eq!(lost(&sessions[0], "left_shoulder"), (3, 121));
    assert_eq!(lost(&sessions[0], "feet").0, 0);
    assert_eq!(sessions[0]["streams"].as_array().unwrap().len(), 4);
    assert!(sessions[0]["verdict"].is_null());
    assert!(
        sessions[0]["started"]["text"]
            .as_str()
            .unwrap()
            .starts_with("2026-09-21T")
    );

    check(at, &["validate", ID], 1, "FAIL");
    let show = &json(at, &["show", ID, "--json"], 0)[0];
    assert_eq!(
        (&show["format"], &show["version"]),
        (&"paws-show".into(), &1.into())
    );
    assert_eq!(show["session"]["verdict"], "FAIL");
    assert_eq!(show["validation"]["losses"][0]["samples"], 3);
    assert_eq!(show["validation"]["fresh"], true);
    assert_eq!(
        show["cameras"][0]["measured_hz"].as_f64().unwrap().round(),
        30.0
    );
    assert_eq!(show["handoff"]["state"], "none");
    assert_eq!(show["stopped_by"], "duration");

    fs::write(at.join("rig.toml"), "format = 1\n").unwrap();
    let rig = &json(at, &["rig", "check", "rig.toml", "--json"], 1)[0];
    assert_eq!(rig["format"], "paws-rig-check");
    assert_eq!(rig["findings"][0]["level"], "error");
    assert!(rig["errors"].as_u64().unwrap() > 0);
}

/// `latest` is accepted wherever a session is named.
#[test]
fn latest_and_paths_are_accepted_by_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    check(at, &["import", "."], 1, "no session here");
    check(at, &["show", "latest"], 1, "there is none");
    let late = "0192aa00-0000-7000-8000-000000000002";
    for (id, later, name) in [(late, 1_000, "b"), (ID, 0, "a")] {
        let mut session = Session::good(2.0);
        session.spec.session_id = id.to_owned();
        session.spec.started_civil.0 += later;
        session.write(&at.join(name));
        check(at, &["import", name], 0, id);
    }
    for (verb, expected) in [
        (&["show", "latest"][..], late),
        (&["validate", "latest"], late),
        (&["index", "latest"], late),
        (&["handoff", "latest"], late),
        (&["report", "latest"], late),
        (&["recover", "latest"], late),
        (
            &["export", "latest", "--format", "csv", "--out", "csv"],
            "feet_imu.csv",
        ),
    ] {
        check(at, verb, 0, expected);
    }
    // Removing a recording takes its whole identifier.
    check(
        at,
        &["prune", "--session", "latest", "--yes"],
        1,
        "whole identifier",
    );
    // A folder, or a file in it.
    let inside = format!("library/sessions/{late}/handoff.json");
    let listed = format!("library/sessions/{late}/");
    for (path, expected) in [
        (&inside[..], late),
        (&listed, late),
        ("b", "/b\n"),
        ("b/session.json", "/b\n"),
    ] {
        check(at, &["show", path], 0, expected);
    }
}

/// Runs `paws` beside one program, which prints its arguments. No other program must be found
/// beside it.
fn with_program(
    at: &Path,
    name: &str,
) -> impl Fn(&[&str]) -> (Option<i32>, String, String) + use<> {
    let bin = at.join("bin");
    fs::create_dir(&bin).unwrap();
    script(&bin.join(name), "echo \"$@\"");
    let paws = bin.join("paws");
    install(Path::new(env!("CARGO_BIN_EXE_paws")), &paws);
    let at = at.to_owned();
    move |arguments| {
        let mut command = Command::new(&paws);
        command.args(arguments).current_dir(&at);
        let output = command
            .env("PAWS_LIBRARY", at.join("library"))
            .output()
            .unwrap();
        let [out, error] = [output.stdout, output.stderr].map(|b| String::from_utf8(b).unwrap());
        (output.status.code(), out, error)
    }
}

/// `paws-calib` does not depend on libraries either.
#[test]
fn calib_accepts_a_session_of_the_library() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    Session::good(2.0).write(&at.join("walk-7"));
    check(at, &["import", "walk-7"], 0, "imported");
    let run = with_program(at, "paws-calib");
    let original = at.canonicalize().unwrap().join("walk-7");
    let session = at.canonicalize().unwrap().join("library/sessions").join(ID);
    let session = session.display();
    let library = at.join("library");
    let library = library.to_str().unwrap();
    for verb in ["camera-imu", "cameras", "imu", "verify"] {
        let (code, out, error) = run(&["calib", verb, "latest", "--force"]);
        assert_eq!(code, Some(0), "{error}");
        assert_eq!(out, format!("{verb} {session} --force\n"));
    }
    for (arguments, expected) in [
        (
            &[
                "calib",
                "cameras",
                "--keep-model",
                "latest",
                "--library",
                library,
            ][..],
            format!("cameras --keep-model {session}\n"),
        ),
        (
            // A folder comes before a session of the library with its name.
            &["-q", "calib", "imu", "walk-7"],
            format!("-q imu {}\n", original.display()),
        ),
        (
            &["calib", "convert", "latest"],
            "convert latest\n".to_owned(),
        ),
        (&["help", "calib"], "--help\n".to_owned()),
        (&["help", "calib", "imu"], "imu --help\n".to_owned()),
    ] {
        let (code, out, error) = run(arguments);
        assert_eq!((code, out), (Some(0), expected), "{error}");
    }
    let (code, _, error) = run(&["calib", "imu", "nowhere"]);
    assert_eq!(code, Some(1), "{error}");
    assert!(error.starts_with("paws: "), "{error}");
    // A program of the toolkit that is missing is named.
    let (code, _, error) = run(&["scene", "show", "x"]);
    assert_eq!(code, Some(2));
    assert!(
        error.contains("the program paws-scene, which is neither beside paws nor on PATH"),
        "{error}"
    );
}

/// `paws-reconstruct` does not depend on libraries; `paws` replaces a session by its folder.
#[test]
fn reconstruct_accepts_a_session_of_the_library() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    Session::good(2.0).write(&at.join("walk-7"));
    check(at, &["import", "walk-7"], 0, "imported");
    let run = with_program(at, "paws-reconstruct");
    let (code, _, error) = run(&["reconstruct", "run", "latest", "--out", "scene"]);
    assert_eq!(code, Some(1));
    assert!(error.contains("`paws handoff latest` does so"), "{error}");
    check(at, &["handoff", "latest"], 0, "handoff.json");
    let (code, out, error) = run(&["reconstruct", "run", "latest", "--out", "scene"]);
    assert_eq!(code, Some(0), "{error}");
    let sealed = at.canonicalize().unwrap().join("library/sessions").join(ID);
    assert_eq!(out, format!("run {} --out scene\n", sealed.display()));
    for verb in ["info", "frames"] {
        let (code, out, error) = run(&["reconstruct", verb, "latest", "--out", "frames"]);
        assert_eq!(code, Some(0), "{error}");
        assert_eq!(out, format!("{verb} {} --out frames\n", sealed.display()));
    }
    let sealed = sealed.display();
    for (arguments, expected) in [
        (
            &["reconstruct", "run", "--out", "latest", "latest"][..],
            format!("run --out latest {sealed}\n"),
        ),
        (
            &["reconstruct", "-q", "run", "latest"],
            format!("-q run {sealed}\n"),
        ),
        (
            &["-q", "reconstruct", "run", "latest"],
            format!("-q run {sealed}\n"),
        ),
        (
            &["-vv", "reconstruct", "info", "latest"],
            format!("-v -v info {sealed}\n"),
        ),
    ] {
        let (code, out, error) = run(arguments);
        assert_eq!((code, out), (Some(0), expected), "{error}");
    }
    let (_, out, _) = run(&["reconstruct", "evaluate", "latest"]);
    assert_eq!(out, "evaluate latest\n");
    let (_, help, _) = run(&["--help"]);
    let line = help
        .lines()
        .find(|l| l.trim_start().starts_with("reconstruct "));
    assert!(line.is_some_and(|l| !l.contains("not found")), "{help}");
    assert!(
        help.lines().any(|l| l.trim_start().starts_with("scene ")),
        "{help}"
    );
}

/// A reader may close the pipe; this is not a failure or panic.
#[test]
fn closed_pipe_is_not_a_failure() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    Session::good(2.0).write(&at.join("walk-7"));
    check(at, &["import", "walk-7"], 0, "imported");
    for arguments in [
        &["list"][..],
        &["list", "--json"],
        &["completions", "zsh"],
        &["--help"],
    ] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_paws"))
            .args(arguments)
            .env("PAWS_LIBRARY", at.join("library"))
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {output:?}");
        assert_eq!(output.stderr, b"", "{arguments:?}");
    }
}

#[test]
fn quiet_prints_only_failures() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // Rejected before anything is sent: without encryption only this machine is allowed.
    let pull = |options: &[&str]| {
        let arguments = [&["pull", "http://192.0.2.1:1"], options].concat();
        let output = paws(at, &arguments);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    let output = pull(&[]);
    let first = "connecting to http://192.0.2.1:1 (gives up after 10 s)";
    assert_eq!(output.lines().next(), Some(first), "{output}");
    let output = pull(&["-q"]);
    assert!(
        output.starts_with("paws: http://192.0.2.1:1 is not on"),
        "{output}"
    );
    assert_eq!(output.lines().count(), 1, "{output}");
}
