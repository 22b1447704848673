//! Non-files, and a file without end, wherever `pawsd` takes a file: rejected immediately, by name.

use std::fs::{self, File, Permissions};
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{CWD, FileType, Mode, mknodat};
use rustix::process::{Pid, PidfdFlags, pidfd_open};

/// Maximum memory of the program, KiB: far more than it needs, far less than it would read.
const MEMORY_KIB: u32 = 16 << 20;

/// Maximum time of the program; a tenth of a second is usual.
const MAX_RUN_TIME: Duration = Duration::from_secs(120);

/// An object in place of a file.
struct NonFile {
    make: fn(&Path),
    /// Expected message.
    message: &'static str,
}

/// Size of a file without end, bytes: more than any limit, and more than the memory.
const ENDLESS: u64 = 4 << 40;

const ENDLESS_MESSAGE: &str = "found 4398046511104 bytes, expected at most";

const NON_FILES: [NonFile; 4] = [
    NonFile {
        make: |path| {
            let mode = Mode::from_raw_mode(0o600);
            mknodat(CWD, path, FileType::Fifo, mode, 0).expect("a FIFO");
        },
        message: "found a FIFO (named pipe)",
    },
    NonFile {
        make: |path| drop(UnixListener::bind(path).expect("a socket")),
        message: "found a socket",
    },
    NonFile {
        make: |path| symlink("/dev/zero", path).expect("a link"),
        message: "found a character device",
    },
    NonFile {
        make: |path| {
            let file = File::create(path).expect("a file");
            file.set_permissions(Permissions::from_mode(0o600))
                .expect("a mode");
            file.set_len(ENDLESS).expect("a file with holes");
        },
        message: ENDLESS_MESSAGE,
    },
];

/// Exit code, standard output and standard error.
fn pawsd(args: &[&str], folder: &Path) -> (Option<i32>, String, String) {
    let into = |name: &str| File::create(folder.join(name)).expect("a file");
    let mut child = Command::new("sh")
        .arg("-c")
        .arg(format!("ulimit -v {MEMORY_KIB}; exec \"$0\" \"$@\""))
        .arg(env!("CARGO_BIN_EXE_pawsd"))
        .args(args)
        .current_dir(folder)
        .env_remove("RUST_LOG")
        .stdin(Stdio::null())
        .stdout(into("stdout"))
        .stderr(into("stderr"))
        .spawn()
        .expect("a program");
    let limit = MAX_RUN_TIME.try_into().expect("a time");
    let pid = Pid::from_child(&child);
    let process = pidfd_open(pid, PidfdFlags::empty()).expect("a program");
    let mut end = [PollFd::new(&process, PollFlags::IN)];
    if poll(&mut end, Some(&limit)).expect("a program") == 0 {
        child.kill().expect("killed");
        child.wait().expect("killed");
        panic!("{args:?} does not end");
    }
    let ended = child.wait().expect("a program");
    let message = |name: &str| fs::read_to_string(folder.join(name)).expect("text");
    (ended.code(), message("stdout"), message("stderr"))
}

/// The findings of a check as JSON; it must find errors.
fn findings(folder: &Path, config: &str) -> Vec<serde_json::Value> {
    fs::write(folder.join("pawsd.toml"), config).expect("a configuration");
    let (code, out, err) = pawsd(&["check", "--config", "pawsd.toml", "--json"], folder);
    assert_eq!(code, Some(1), "{out}\n{err}");
    let report: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    report["findings"].as_array().expect("findings").clone()
}

/// One error about this must contain that.
fn expect(findings: &[serde_json::Value], about: &str, message: &str) {
    let says = |finding: &&serde_json::Value| {
        finding["level"] == "error"
            && finding["about"] == about
            && finding["message"]
                .as_str()
                .is_some_and(|text| text.contains(message))
    };
    assert!(
        findings.iter().any(|finding| says(&finding)),
        "{about} does not say {message:?}: {findings:#?}"
    );
}

/// Cameras, each of which needs a file.
const CAMERAS: &str = "\
    [[camera]]\nname = \"lenses\"\ncalibration = \"lenses.yaml\"\n\
    source = { kind = \"synthetic\", width = 128, height = 64 }\n\
    [[camera]]\nname = \"folder\"\ncalibration = \"calibration\"\n\
    source = { kind = \"synthetic\", width = 128, height = 64 }\n\
    [[camera]]\nname = \"bag\"\nsource = { kind = \"bag\", path = \"walk.mcap\" }\n\
    [[camera]]\nname = \"bags\"\nsource = { kind = \"bag\", path = \"bag\" }\n\
    [[camera]]\nname = \"video\"\nsource = { kind = \"video\", path = \"walk.mp4\" }\n\
    [[camera]]\nname = \"set\"\nsource = { kind = \"replay\", path = \"set\" }\n\
    [[camera]]\nname = \"table\"\nsource = { kind = \"replay\", path = \"asl\" }\n\
    [[camera]]\nname = \"pair\"\nsource = { kind = \"replay\", path = \"pair\", rate_hz = 10 }\n\
    [[camera]]\nname = \"images\"\nsource = { kind = \"replay\", path = \"images\", rate_hz = 10 }\n";

/// The checked part, the path that the object replaces, and the message for a file without end if
/// that is not about its length.
const PLACES: [(&str, &str, Option<&str>); 11] = [
    ("rig", "rig", None),
    ("page", "token", None),
    ("camera lenses", "lenses.yaml", None),
    ("camera folder", "calibration/camchain.yaml", None),
    (
        "camera bag",
        "walk.mcap",
        Some("found a file of another kind"),
    ),
    (
        "camera bags",
        "bag/walk_0.mcap",
        Some("found a file of another kind"),
    ),
    ("camera video", "walk.mp4", Some("reading a video file")),
    ("camera set", "set", Some("found a file")),
    ("camera table", "asl/cam0/data.csv", None),
    (
        "camera pair",
        "pair/left.png",
        Some("expected a whole PNG file"),
    ),
    (
        "camera images",
        "images/left/0.png",
        Some("expected a whole PNG file"),
    ),
];

#[test]
fn non_file_in_a_configuration_is_rejected() {
    for non_file in &NON_FILES {
        let folder = tempfile::tempdir().expect("folder");
        let here = folder.path();
        for (_, place, _) in PLACES {
            let place = here.join(place);
            fs::create_dir_all(place.parent().expect("a folder")).expect("a folder");
            (non_file.make)(&place);
        }
        for other in ["pair/right.png", "images/right/0.png"] {
            let other = here.join(other);
            fs::create_dir_all(other.parent().expect("a folder")).expect("a folder");
            fs::write(other, "").expect("a file");
        }
        let config = format!(
            "control.socket = \"s\"\nencoder.element = \"x264enc\"\nrig.file = \"rig\"\n\
             page = {{ listen = \"127.0.0.1:0\", token_file = \"token\" }}\n{CAMERAS}"
        );
        let found = findings(here, &config);
        for (about, _, of_endless) in PLACES {
            let message = match of_endless {
                Some(other) if non_file.message == ENDLESS_MESSAGE => other,
                _ => non_file.message,
            };
            expect(&found, about, message);
        }
    }
}

#[cfg(feature = "simulator")]
#[test]
fn non_file_as_fault_list_is_rejected() {
    for non_file in &NON_FILES {
        let folder = tempfile::tempdir().expect("folder");
        let here = folder.path();
        let rig = include_str!("../../cad-transforms/rigs/example.toml");
        fs::write(here.join("rig.toml"), rig).expect("a rig");
        (non_file.make)(&here.join("faults.toml"));
        let config = "control.socket = \"s\"\nrig.file = \"rig.toml\"\n[[camera]]\nname = \"feet\"\n\
            source = { kind = \"sim\", faults = \"faults.toml\" }\n";
        expect(&findings(here, config), "camera feet", non_file.message);
    }
}

#[test]
fn non_file_as_configuration_is_rejected() {
    for non_file in &NON_FILES {
        let folder = tempfile::tempdir().expect("folder");
        (non_file.make)(&folder.path().join("pawsd.toml"));
        for command in [
            &["check"][..],
            &["record", "--seconds", "1", "--out", "out"],
            &["run"],
        ] {
            let args = [command, &["--config", "pawsd.toml"]].concat();
            let (code, _, message) = pawsd(&args, folder.path());
            assert_eq!(code, Some(2), "{args:?}: {message}");
            assert!(message.contains(non_file.message), "{args:?}: {message}");
        }
    }
}
