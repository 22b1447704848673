//! The commands of `pawsd` as a user types them.

use std::fs;
use std::io::{BufRead, BufReader, Write as _};
use std::os::unix::net::UnixListener;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use capture_daemon::status::{Progress, State, Status};
use session_archive::text::is_plain;

/// One camera that a single slow core encodes in real time.
const CAMERA: &str = "[[camera]]\nname = \"feet\"\n\
    source = { kind = \"synthetic\", width = 128, height = 64, rate_hz = 20, imu_rate_hz = 100 }\n";

/// Remedy for a camera without intrinsics.
const REMEDY: &str = "`paws calib cameras BOARDS --target board.toml --out calibration`";

fn pawsd(args: &[&str], folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pawsd"));
    command
        .args(args)
        .current_dir(folder)
        .env_remove("RUST_LOG")
        .env_remove("NOTIFY_SOCKET");
    command
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Runs to the end; the exit code must be `code`.
fn run(args: &[&str], folder: &Path, code: i32) -> Output {
    let output = pawsd(args, folder).output().unwrap();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(
        output.status.code(),
        Some(code),
        "{args:?}\nstdout: {out}\nstderr: {err}"
    );
    output
}

/// A folder with a configuration in it.
fn folder_with(config: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("pawsd.toml"), config).unwrap();
    folder
}

/// A daemon that ends with a failing test: otherwise it would hold the test runner's output open.
struct Daemon(Child);

impl Daemon {
    fn start(command: &mut Command) -> Self {
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).spawn();
        Self(child.unwrap())
    }

    /// Ends it with a signal; gives its exit code.
    fn end(mut self) -> Option<i32> {
        signal(&self.0, "TERM");
        self.0.wait().unwrap().code()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn signal(child: &Child, name: &str) {
    let sent = Command::new("kill")
        .args([format!("-{name}"), child.id().to_string()])
        .status()
        .unwrap();
    assert!(sent.success());
}

#[test]
fn help_names_the_three_first_commands() {
    let help = text(&run(&["--help"], Path::new("."), 0).stdout);
    for command in [
        "pawsd check",
        "pawsd record",
        "pawsd run",
        "--seconds",
        "deploy/pawsd.toml",
        "Exit codes",
    ] {
        assert!(help.contains(command), "no {command:?} in:\n{help}");
    }
}

#[test]
fn wrong_arguments_end_with_2() {
    let folder = folder_with(CAMERA);
    let check = |args: &[&str], expected: &str| {
        let error = text(&run(args, folder.path(), 2).stderr);
        assert!(error.contains(expected), "no {expected:?} in:\n{error}");
    };
    check(&[], "Usage: pawsd [OPTIONS] <COMMAND>");
    check(&["recrod"], "record");
    check(&["record", "--config", "pawsd.toml"], "--seconds <SECONDS>");
    for seconds in ["0", "-1", "nan", "1e9", "ten"] {
        let seconds = format!("--seconds={seconds}");
        check(
            &["record", "--config", "pawsd.toml", &seconds],
            "expected a number above 0 and at most 604800",
        );
    }
    check(
        &["record", "--config", "pawsd.toml", "--seconds", "1"],
        "Give --out DIR, or set out in [session]",
    );
    check(&["run", "--config", "pawsd.toml"], "Set out in [session]");
    check(
        &["encoders", "--size", "1344"],
        "expected a width and a height",
    );
}

#[test]
fn invalid_configuration_ends_with_2_and_reports_every_problem() {
    let folder = folder_with("[session]\nchunk_sm = 500\n[disk]\nreserve_gb = -1\n");
    for command in [
        vec!["check"],
        vec!["run"],
        vec!["record", "--seconds", "1", "--out", "out"],
    ] {
        let mut args = command.clone();
        args.extend(["--config", "pawsd.toml"]);
        let error = text(&run(&args, folder.path(), 2).stderr);
        for expected in [
            "3 problems",
            "line 1: camera is missing",
            "line 2: unknown key chunk_sm in [session]; did you mean chunk_ms?",
            "line 4: reserve_gb in [disk] is -1, expected a number from 0",
            "in pawsd.toml",
        ] {
            assert!(
                error.contains(expected),
                "{command:?}: no {expected:?} in:\n{error}"
            );
        }
    }
    let absent = text(&run(&["check", "--config", "absent.toml"], folder.path(), 2).stderr);
    assert!(
        absent.contains("reading the configuration: absent.toml: No such file"),
        "{absent}"
    );
}

#[test]
fn check_finds_errors_of_the_machine() {
    let good = folder_with(&format!(
        "session.out = \"out\"\ncontrol.socket = \"s\"\ndisk.reserve_gb = 0\n{CAMERA}"
    ));
    let report = text(&run(&["check", "--config", "pawsd.toml"], good.path(), 0).stdout);
    assert!(
        report.contains("ok       camera feet: ") && report.contains("0 errors, 2 warnings:"),
        "{report}"
    );
    assert!(
        report.contains("warning  camera feet: a synthetic camera has no lenses"),
        "{report}"
    );
    let output = run(
        &["check", "--config", "pawsd.toml", "--json"],
        good.path(),
        0,
    );
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(document["format"], "pawsd-check");
    assert_eq!(
        (&document["errors"], &document["warnings"]),
        (&0.into(), &2.into())
    );
    let findings = document["findings"].as_array().unwrap();
    let camera = findings
        .iter()
        .find(|f| f["about"] == "camera feet")
        .unwrap();
    assert_eq!(camera["level"], "ok", "{camera}");
    // Slow steps are announced before, unless `-q` is given.
    let messages = text(&output.stderr);
    assert!(
        messages.contains("checking camera feet") && messages.contains("trying encoders"),
        "{messages}"
    );
    let quiet = run(&["-q", "check", "--config", "pawsd.toml"], good.path(), 0);
    assert_eq!(text(&quiet.stderr), "");
    let bad =
        folder_with("[[camera]]\nname = \"feet\"\nsource = { kind = \"replay\", path = \"gone\" }");
    let report = text(&run(&["check", "--config", "pawsd.toml"], bad.path(), 1).stdout);
    assert!(
        report.contains("error    camera feet: ") && report.contains("1 error,"),
        "{report}"
    );
}

#[test]
fn control_without_a_daemon_reports_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(
        folder.path().join("pawsd.toml"),
        format!("control.socket = \"none.sock\"\n{CAMERA}"),
    )
    .unwrap();
    for command in ["start", "stop", "mark", "discard", "status"] {
        for named in [["--socket", "none.sock"], ["--config", "pawsd.toml"]] {
            let args = [&[command], &named[..]].concat();
            let error = text(&run(&args, folder.path(), 1).stderr);
            assert!(
                error.contains("pawsd run --config FILE") && error.contains("none.sock"),
                "{error}"
            );
        }
        let args = [command, "--config", "absent.toml"];
        let error = text(&run(&args, folder.path(), 2).stderr);
        assert!(error.contains("absent.toml"), "{error}");
        let args = [command, "--config", "pawsd.toml", "--socket", "s"];
        run(&args, folder.path(), 2);
    }
}

#[test]
fn names_and_marks_with_control_characters_are_bad_arguments() {
    let folder = folder_with(CAMERA);
    let long = "x".repeat(201);
    for bad in ["a\u{1b}[2J", "a\u{9b}2J", "a\nb", "a\u{202e}b", &long] {
        let record = ["record", "--config", "pawsd.toml", "--out", "out"];
        let record = [&record[..], &["--seconds", "1", "--virtual", "--name", bad]].concat();
        for args in [
            &["start", "--socket", "none.sock", "--name", bad][..],
            &["mark", "--socket", "none.sock", bad],
            &record,
        ] {
            let error = text(&run(args, folder.path(), 2).stderr);
            assert!(error.contains("a name or a mark"), "{error}");
            assert!(error.lines().all(is_plain), "{error:?}");
        }
    }
    assert!(!folder.path().join("out").exists());
}

/// The server at the socket may be any program.
#[test]
fn control_characters_of_the_server_are_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let listener = UnixListener::bind(folder.path().join("s")).unwrap();
    let answer = r#"{"result":"error","message":"no\u001b[2J\u009b2J\u202e"}"#;
    let stranger = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut received = String::new();
        BufReader::new(&stream).read_line(&mut received).unwrap();
        writeln!(stream, "{answer}").unwrap();
    });
    let error = text(&run(&["status", "--socket", "s"], folder.path(), 1).stderr);
    stranger.join().unwrap();
    assert_eq!(error, "pawsd: no\\u001b[2J\\u009b2J\\u202e\n");
}

#[test]
fn encoders_are_listed_with_their_results() {
    let list = text(&run(&["encoders", "--size", "128x64"], Path::new("."), 0).stdout);
    let lines: Vec<&str> = list.lines().collect();
    assert_eq!(
        lines.len(),
        1 + video::encoder::known_elements().count(),
        "{list}"
    );
    assert_eq!(
        lines
            .iter()
            .filter(|line| line.ends_with("preferred"))
            .count(),
        1,
        "{list}"
    );
}

#[test]
fn record_prints_the_session_last() {
    let folder = folder_with(CAMERA);
    let args = [
        "record",
        "--config",
        "pawsd.toml",
        "--out",
        "out",
        "--seconds",
        "2",
        "--virtual",
        "--name",
        "desk",
    ];
    let output = run(&args, folder.path(), 0);
    let out = text(&output.stdout);
    let session = Path::new(out.lines().last().unwrap());
    let manifest = fs::read_to_string(folder.path().join(session).join("session.json")).unwrap();
    assert!(manifest.contains("\"desk\""), "{manifest}");
    let messages = text(&output.stderr);
    let lines: Vec<&str> = messages.lines().collect();
    assert_eq!(lines[0], "opening feet", "{messages}");
    assert!(lines[1].starts_with("finding an encoder"), "{messages}");
    assert!(
        messages.contains("\nrecording: out/") && messages.contains("samples stored, 0 missing"),
        "{messages}"
    );
    let note = messages
        .lines()
        .find(|l| l.starts_with("note: "))
        .unwrap_or_default();
    assert!(
        note.starts_with("note: the lenses of feet are not known") && note.contains(REMEDY),
        "{messages}"
    );
    // The same once more elsewhere is the same session; under another name it is another one, and
    // none is a real one.
    let id = |name: &str, out: &str| {
        let mut args = args;
        (args[4], args[9]) = (out, name);
        let out = text(&run(&[&args[..], &["-q"]].concat(), folder.path(), 0).stdout);
        let manifest = folder.path().join(out.trim()).join("session.json");
        let manifest: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(manifest).unwrap()).unwrap();
        manifest["session_id"].as_str().unwrap().to_owned()
    };
    let same = id("desk", "elsewhere");
    assert!(manifest.contains(&same), "{same} is not in {manifest}");
    let other = id("table", "elsewhere");
    assert_ne!(other, same);
    for id in [same, other] {
        assert_eq!(&id[14..15], "8", "{id} is no UUID of version 8");
    }
}

#[test]
fn record_reports_progress_as_json() {
    let folder = folder_with(CAMERA);
    let args = [
        "record",
        "--config",
        "pawsd.toml",
        "--out",
        "out",
        "--seconds",
        "2",
        "--virtual",
        "--json",
    ];
    let out = text(&run(&args, folder.path(), 0).stdout);
    let events: Vec<Progress> = out
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert!(
        matches!(events.first(), Some(Progress::Started { .. })),
        "{events:?}"
    );
    assert!(
        events
            .iter()
            .any(|event| matches!(event, Progress::Durable { .. })),
        "{events:?}"
    );
    assert!(
        matches!(
            events.last(),
            Some(Progress::Finished {
                missing: 0,
                error: None,
                ..
            })
        ),
        "{events:?}"
    );
}

/// More than a pipe holds is printed on standard output, and read when the recording is over.
#[test]
fn recording_does_not_wait_for_its_reader() {
    let folder = folder_with(&format!("session.chunk_ms = 100\n{CAMERA}"));
    let args = [
        "record",
        "--config",
        "pawsd.toml",
        "--out",
        "out",
        "--seconds",
        "200",
        "--virtual",
        "--json",
    ];
    let mut child = pawsd(&args, folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let messages = BufReader::new(child.stderr.take().unwrap()).lines();
    let finished = messages
        .map(|line| line.unwrap())
        .find(|line| line.starts_with("finished after"));
    assert!(finished.is_some());
    let said = text(&child.wait_with_output().unwrap().stdout);
    assert!(said.len() > 70_000, "{} bytes", said.len());
    assert!(said.lines().last().unwrap().contains("\"finished\""));
}

#[test]
fn a_signal_ends_a_recording_cleanly() {
    let folder = folder_with(CAMERA);
    for name in ["INT", "TERM", "HUP"] {
        let args = [
            "record",
            "--config",
            "pawsd.toml",
            "--out",
            "out",
            "--seconds",
            "600",
            "--json",
        ];
        let mut child = pawsd(&args, folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut events = BufReader::new(child.stdout.take().unwrap())
            .lines()
            .map(|line| line.unwrap());
        assert!(events.next().unwrap().contains("\"event\":\"started\""));
        // A busy machine may report other events in between.
        assert!(events.any(|event| event.contains("\"event\":\"durable\"")));
        signal(&child, name);
        let last: Progress = serde_json::from_str(&events.last().unwrap()).unwrap();
        let Progress::Finished {
            error: None,
            reason,
            missing,
            absent,
            ..
        } = last
        else {
            panic!("SIG{name}: {last:?}")
        };
        assert_eq!(reason, "signal", "SIG{name}");
        let code = if missing == 0 && absent.is_empty() {
            0
        } else {
            3
        };
        let ended = child.wait().unwrap();
        assert_eq!(
            (ended.code(), ended.signal()),
            (Some(code), None),
            "SIG{name}"
        );
    }
}

/// Open files remain usable after their folder is removed, and nothing would be left of them.
#[test]
fn recording_fails_when_its_folder_is_removed() {
    let folder = folder_with(CAMERA);
    let args = [
        "record",
        "--config",
        "pawsd.toml",
        "--out",
        "out",
        "--seconds",
        "600",
        "--json",
    ];
    let mut child = pawsd(&args, folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut events = BufReader::new(child.stdout.take().unwrap())
        .lines()
        .map(|line| serde_json::from_str::<Progress>(&line.unwrap()).unwrap());
    let Some(Progress::Started { session, .. }) = events.next() else {
        panic!("no session");
    };
    assert!(events.any(|event| matches!(event, Progress::Durable { .. })));
    fs::remove_dir_all(folder.path().join(session)).unwrap();
    let last = events.last();
    let output = child.wait_with_output().unwrap();
    let messages = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{messages}");
    let Some(Progress::Finished {
        error: Some(error), ..
    }) = &last
    else {
        panic!("{last:?}\n{messages}");
    };
    assert!(error.contains("folder was removed"), "{error}");
    assert!(
        messages.contains("FAILED: the session's folder was removed"),
        "{messages}"
    );
}

#[test]
fn the_daemon_is_controlled_through_its_socket() {
    let config =
        format!("session.out = \"out\"\ncontrol.socket = \"s\"\ndisk.reserve_gb = 0\n{CAMERA}");
    let folder = folder_with(&config);
    let here = folder.path();
    let notify = here.join("notify");
    let manager = std::os::unix::net::UnixDatagram::bind(&notify).unwrap();
    let mut command = pawsd(&["run", "--config", "pawsd.toml"], here);
    command.env("NOTIFY_SOCKET", &notify).stderr(Stdio::null());
    let daemon = Daemon::start(&mut command);
    let mut message = [0; 256];
    let length = manager.recv(&mut message).unwrap();
    assert_eq!(&message[..length], b"READY=1");

    let control = |args: &[&str], code: i32| run(&[args, &["--socket", "s"]].concat(), here, code);
    let status =
        || -> Status { serde_json::from_slice(&control(&["status", "--json"], 0).stdout).unwrap() };
    let error = text(&control(&["stop"], 1).stderr);
    assert!(error.contains("pawsd: "), "{error}");
    // Each query takes a new process, and fails if the daemon has ended.
    let wait = |is: fn(&Status) -> bool| while !is(&status()) {};
    wait(|status| status.state == State::Armed);
    let started = control(&["start", "--name", "walk"], 0);
    let session = text(&started.stdout);
    let note = text(&started.stderr);
    assert!(
        note.starts_with("note: the lenses of feet are not known") && note.contains(REMEDY),
        "{note}"
    );
    assert!(
        here.join(session.trim()).join("session.json").exists(),
        "{session:?}"
    );
    assert_eq!(status().state, State::Recording);
    assert!(text(&control(&["status"], 0).stdout).starts_with("pawsd is recording, "));
    control(&["start"], 1);
    control(&["mark", "stairs"], 0);
    wait(|status| status.streams.iter().all(|stream| stream.stored > 0));
    let stopped = pawsd(&["stop", "--socket", "s"], here).output().unwrap();
    assert_eq!(text(&stopped.stdout), session);
    wait(|status| status.state == State::Armed);
    // On a busy machine frames may be missing.
    let is_whole = status().streams.iter().all(|stream| stream.missing == 0);
    let code = if is_whole { 0 } else { 3 };
    assert_eq!(
        stopped.status.code(),
        Some(code),
        "{}",
        text(&stopped.stderr)
    );

    let second = text(&control(&["start"], 0).stdout);
    assert_ne!(second, session);
    control(&["discard"], 0);
    assert!(!here.join(second.trim()).exists());

    assert_eq!(daemon.end(), Some(0));
    assert!(!here.join("s").exists(), "the socket is left behind");
}

/// It would take the cameras from a recording, or find them in use.
#[test]
fn selftest_does_not_disturb_a_running_daemon() {
    let folder = folder_with(&format!(
        "session.out = \"out\"\ncontrol.socket = \"socket\"\n{CAMERA}"
    ));
    let _daemon = std::os::unix::net::UnixListener::bind(folder.path().join("socket")).unwrap();
    let args = ["selftest", "--config", "pawsd.toml"];
    let messages = text(&run(&args, folder.path(), 1).stderr);
    assert!(messages.contains("stop it first"), "{messages}");
    assert!(!folder.path().join("pawsd-selftest.txt").exists());
}

/// A user who starts it at a terminal need not query whether it is ready.
#[test]
fn daemon_reports_what_it_waits_for_and_when_it_is_armed() {
    let config =
        format!("session.out = \"out\"\ncontrol.socket = \"s\"\ndisk.reserve_gb = 0\n{CAMERA}");
    let folder = folder_with(&config);
    let mut command = pawsd(&["run", "--config", "pawsd.toml"], folder.path());
    let mut daemon = Daemon::start(command.stderr(Stdio::piped()));
    let lines = BufReader::new(daemon.0.stderr.take().unwrap()).lines();
    let mut messages = Vec::new();
    for line in lines.map(|line| line.unwrap()) {
        messages.push(line);
        if messages
            .last()
            .is_some_and(|line| line.starts_with("armed: "))
        {
            break;
        }
    }
    assert_eq!(daemon.end(), Some(0));
    let socket = folder.path().join("s");
    let start = format!("`pawsd start --socket {}`", socket.display());
    assert!(messages.last().unwrap().ends_with(&start), "{messages:#?}");
    for expected in [
        "opening feet",
        "waiting for the first frames of feet",
        "feet delivers",
    ] {
        assert!(
            messages.iter().any(|line| line == expected),
            "no {expected:?} in {messages:#?}"
        );
    }
}

/// The reader may have read enough.
#[test]
fn a_closed_pipe_is_no_failure() {
    for args in [&["--help"][..], &["completions", "bash"]] {
        let mut child = pawsd(args, Path::new("."))
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{args:?}: {output:?}");
        assert_eq!(text(&output.stderr), "", "{args:?}");
    }
}

/// Eight stereo images, without the one that was `lost`.
fn images(folder: &Path, lost: Option<u8>) {
    for eye in ["image_0", "image_1"] {
        let eye = folder.join(eye);
        fs::create_dir_all(&eye).unwrap();
        for number in (0..8).filter(|number| Some(*number) != lost) {
            let file = fs::File::create(eye.join(format!("{number:06}.png"))).unwrap();
            let mut encoder = png::Encoder::new(file, 64, 64);
            encoder.set_color(png::ColorType::Grayscale);
            encoder.set_depth(png::BitDepth::Eight);
            let mut writer = encoder.write_header().unwrap();
            writer.write_image_data(&[number * 20; 64 * 64]).unwrap();
        }
    }
}

/// The exit code reports lost samples, also without a reader of the messages.
#[test]
fn a_closed_pipe_hides_no_loss() {
    for (lost, code) in [(None, 0), (Some(3), 3)] {
        let folder = folder_with(
            "[[camera]]\nname = \"feet\"\nsource = { kind = \"replay\", path = \"walk\", rate_hz = 10 }\n",
        );
        images(&folder.path().join("walk"), lost);
        let args = [
            "record",
            "--config",
            "pawsd.toml",
            "--out",
            "out",
            "--seconds",
            "2",
            "--virtual",
        ];
        let mut child = pawsd(&args, folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(code), "{output:?}");
    }
}

#[test]
fn manual_pages_and_completions_come_from_the_program() {
    let folder = tempfile::tempdir().unwrap();
    run(&["man", "--out", "man"], folder.path(), 0);
    let page = fs::read_to_string(folder.path().join("man/pawsd-record.1")).unwrap();
    assert!(
        page.contains("\\-\\-seconds") && page.contains(".SH EXAMPLES"),
        "{page}"
    );
    let script = text(&run(&["completions", "fish"], folder.path(), 0).stdout);
    assert!(
        script.contains("record") && script.contains("virtual"),
        "{script}"
    );
}
