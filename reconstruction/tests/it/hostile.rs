//! Files from strangers: FIFOs, sockets, devices and false lengths instead of regular files. Each
//! ends with an error that names what was found, and nothing blocks.

use std::fs::{self, File};
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::Command;

use rustix::fs::{CWD, FileType, Mode, mknodat};
use session_archive::layout;

use crate::session::hand_over;

/// Things at a path where links are followed, since the user named it.
const NAMED: [(Thing, &str); 4] = [
    (Thing::Fifo, "found a FIFO (named pipe)"),
    (Thing::Socket, "found a socket"),
    (Thing::Zero, "found a character device"),
    (
        Thing::Sparse,
        "found 4398046511104 bytes, expected at most ",
    ),
];

#[derive(Clone, Copy, Debug)]
enum Thing {
    Fifo,
    Socket,
    /// A link to a device that never ends.
    Zero,
    /// A sparse file of 4 TiB.
    Sparse,
}

impl Thing {
    /// Puts it to a path, runs something, and takes it away.
    fn at(self, path: &Path, run: impl FnOnce()) {
        let _listener = match self {
            Self::Fifo => {
                let mode = Mode::from_raw_mode(0o644);
                mknodat(CWD, path, FileType::Fifo, mode, 0).expect("a FIFO");
                None
            }
            Self::Socket => Some(UnixListener::bind(path).expect("a socket")),
            Self::Zero => {
                symlink("/dev/zero", path).expect("a link");
                None
            }
            Self::Sparse => {
                let file = File::create(path).expect("a file");
                file.set_len(1 << 42).expect("a long file");
                None
            }
        };
        run();
        fs::remove_file(path).expect("remove");
    }
}

/// The program fails promptly, with the cause.
fn fails(folder: &Path, arguments: &[&str], why: &str) {
    let output = Command::new("timeout")
        .args(["--kill-after=1", "120"])
        .arg(env!("CARGO_BIN_EXE_paws-reconstruct"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("run");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
    assert!(
        said.contains(why),
        "{arguments:?}: {why:?} is not in {said}"
    );
    assert!(!said.contains("panicked"), "{arguments:?}: {said}");
}

#[test]
fn a_hand_off_that_is_not_a_regular_file_is_refused_immediately() {
    let folder = tempfile::tempdir().expect("folder");
    let at = folder.path();
    hand_over(&at.join("s"));
    let path = at.join("s").join(layout::HANDOFF);
    fs::remove_file(&path).expect("remove");
    for (thing, why) in NAMED {
        // Links are not followed within a session.
        let why = match thing {
            Thing::Zero => "found a symbolic link",
            _ => why,
        };
        thing.at(&path, || {
            fails(at, &["info", "s"], why);
            fails(at, &["frames", "s", "--out", "out"], why);
            fails(at, &["run", "s", "--out", "scene"], why);
            assert!(!at.join("out").exists() && !at.join("scene").exists());
        });
    }
    fails(
        at,
        &["info", "/dev/zero"],
        "expected handoff.json or a session's folder",
    );
}

#[test]
fn a_calibration_that_is_not_a_regular_file_is_refused_immediately() {
    let folder = tempfile::tempdir().expect("folder");
    let at = folder.path();
    hand_over(&at.join("s"));
    fs::create_dir(at.join("c")).expect("folder");
    let run = |more: &[&str], why: &str| {
        let arguments = [&["run", "s", "--out", "scene", "--to", "rig"], more].concat();
        fails(at, &arguments, why);
        assert!(!at.join("scene").exists());
    };
    for (thing, why) in NAMED {
        thing.at(&at.join("c/feet.yaml"), || {
            run(&["--calibration", "c"], why);
            run(&["--calibration", "feet=c/feet.yaml"], why);
        });
        thing.at(&at.join("c/rig.toml"), || {
            run(&["--calibration", "c"], why);
            run(&["--rig", "c/rig.toml"], why);
        });
    }
}

#[test]
fn a_trajectory_that_is_not_a_regular_file_is_refused_immediately() {
    let folder = tempfile::tempdir().expect("folder");
    let at = folder.path();
    let poses = "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 2 0 0 0 0 0 1\n";
    fs::write(at.join("good.txt"), poses).expect("write");
    for (thing, why) in NAMED {
        thing.at(&at.join("x.txt"), || {
            for arguments in [
                &["evaluate", "x.txt", "--truth", "good.txt"][..],
                &["evaluate", "good.txt", "--truth", "x.txt"],
                &[
                    "evaluate", "good.txt", "--truth", "good.txt", "--cost", "x.txt",
                ],
            ] {
                fails(at, arguments, why);
            }
        });
        // The manifest of a bundle; links are not followed within one.
        fs::create_dir(at.join("b")).expect("folder");
        let why = match thing {
            Thing::Zero => "found a symbolic link",
            _ => why,
        };
        thing.at(&at.join("b/scene.json"), || {
            fails(at, &["evaluate", "b", "--truth", "good.txt"], why);
            fails(at, &["evaluate-depth", "b", "--truth", "."], why);
            fails(at, &["report", "b"], why);
        });
        fs::remove_dir(at.join("b")).expect("remove");
    }
}
