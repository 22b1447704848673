//! Malicious folders and files: FIFOs, sockets, devices and links in place of files, and false
//! sizes.

use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::{Command, Output};

use rustix::fs::{CWD, FileType, Mode, mknodat};

use crate::support::{ID, Session};

/// `paws` with a timeout, and with at most 512 MiB of address space.
fn paws(folder: &Path, arguments: &[&str]) -> Output {
    Command::new("timeout")
        .args(["--kill-after=1", "300", "sh", "-c"])
        .args([
            "ulimit -v 524288 && exec \"$0\" \"$@\"",
            env!("CARGO_BIN_EXE_paws"),
        ])
        .args(arguments)
        .current_dir(folder)
        .env("PAWS_LIBRARY", folder.join("library"))
        .env("RUST_BACKTRACE", "0")
        .output()
        .unwrap()
}

fn text(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|b| String::from_utf8_lossy(b));
    format!("{out}{err}")
}

/// Checks that it ends by itself with one of these codes; returns its output.
fn ends(folder: &Path, arguments: &[&str], codes: &[i32]) -> String {
    let output = paws(folder, arguments);
    let said = text(&output);
    let code = output.status.code();
    assert!(
        code.is_some_and(|code| codes.contains(&code)),
        "{arguments:?}: {:?}: {said}",
        output.status
    );
    assert!(!said.contains("panicked"), "{arguments:?}: {said}");
    said
}

fn fifo(path: &Path) {
    mknodat(CWD, path, FileType::Fifo, Mode::from_raw_mode(0o644), 0).unwrap();
}

/// Creates each kind of non-file at a free path, and runs the check.
fn each_kind(path: &Path, check: &mut dyn FnMut(&str)) {
    fifo(path);
    check("a FIFO (named pipe)");
    fs::remove_file(path).unwrap();
    let listener = UnixListener::bind(path).unwrap();
    check("a socket");
    drop(listener);
    fs::remove_file(path).unwrap();
    for target in ["/dev/zero", "/etc/hostname", "/proc/self/environ"] {
        symlink(target, path).unwrap();
        check("a symbolic link");
        fs::remove_file(path).unwrap();
    }
}

#[test]
fn non_files_in_a_session_are_rejected_and_named() {
    let folder = tempfile::tempdir().unwrap();
    // Paths of sockets are short.
    let at = folder.path();
    Session::good(1.0).write(&at.join("s"));
    for name in [
        "session.json",
        "rig/rig.toml",
        "segments/000000.mcap",
        "notes",
    ] {
        let path = at.join("s").join(name);
        let old = fs::read(&path).ok();
        if old.is_some() {
            fs::remove_file(&path).unwrap();
        }
        each_kind(&path, &mut |kind| {
            let said = ends(at, &["import", "s"], &[1]);
            assert!(said.contains(kind), "import, {name}: {said}");
            assert!(!at.join("library/sessions").join(ID).exists());
            // Notes are not read.
            if name == "notes" {
                return;
            }
            for arguments in [
                &["validate", "s"][..],
                &["show", "s"],
                &["recover", "s", "--out", "copy"],
                &["export", "s", "--format", "csv", "--out", "csv"],
            ] {
                let said = ends(at, arguments, &[1]);
                assert!(said.contains(kind), "{arguments:?}, {name}: {said}");
                for made in ["csv", "copy"] {
                    let _ = fs::remove_dir_all(at.join(made));
                }
            }
        });
        if let Some(old) = old {
            fs::write(&path, old).unwrap();
        }
    }
    // A link to a folder elsewhere in place of a folder of the session.
    fs::rename(at.join("s/segments"), at.join("elsewhere")).unwrap();
    symlink("../elsewhere", at.join("s/segments")).unwrap();
    for verb in ["import", "validate", "show"] {
        let said = ends(at, &[verb, "s"], &[1]);
        assert!(said.contains("a symbolic link"), "{verb}: {said}");
    }
    fs::remove_file(at.join("s/segments")).unwrap();
    fs::rename(at.join("elsewhere"), at.join("s/segments")).unwrap();
    // The folder itself may be reached through a link: the user named it.
    symlink("s", at.join("latest")).unwrap();
    ends(at, &["validate", "latest"], &[0]);
    ends(at, &["import", "latest"], &[0]);
}

#[test]
fn non_files_are_rejected_as_rig_or_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("rig.toml"), "revision = 1\n").unwrap();
    fifo(&at.join("p.toml"));
    fifo(&at.join("p.step"));
    fifo(&at.join("p.yaml"));
    let _listener = UnixListener::bind(at.join("s.toml")).unwrap();
    // The user may name a link; its target counts.
    symlink("/dev/zero", at.join("z.toml")).unwrap();
    let huge = File::create(at.join("h.toml")).unwrap();
    huge.set_len(1 << 42).unwrap();
    let huge = File::create(at.join("h.step")).unwrap();
    huge.set_len(1 << 42).unwrap();
    for (arguments, part) in [
        (&["rig", "check", "p.toml"][..], "a FIFO"),
        (&["rig", "check", "s.toml"], "a socket"),
        (&["rig", "check", "z.toml"], "a character device"),
        (&["rig", "check", "/dev/zero"], "a character device"),
        (&["rig", "check", "h.toml"], "expected at most 1048576"),
        (
            &["rig", "check", "rig.toml", "--calibration", "a=p.yaml"],
            "p.yaml",
        ),
        (&["rig", "show", "p.toml"], "a FIFO"),
        (&["rig", "diff", "rig.toml", "p.toml"], ""),
        (&["rig", "convert", "p.step", "--list"], "a FIFO"),
        (
            &["rig", "convert", "h.step", "--list"],
            "expected at most 268435456",
        ),
    ] {
        let said = ends(at, arguments, &[1, 2]);
        assert!(said.contains(part), "{arguments:?}: {said}");
    }
}

/// Writes into a file without making it shorter.
fn patch(path: &Path, offset: u64, bytes: &[u8]) {
    let mut file = File::options().write(true).open(path).unwrap();
    file.seek(SeekFrom::Start(offset)).unwrap();
    file.write_all(bytes).unwrap();
}

#[test]
fn false_sizes_allocate_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let limited = ends(at, &["--version"], &[0]);
    assert!(limited.starts_with("paws"), "{limited}");
    let verbs = |codes: &[i32], what: &str| {
        for arguments in [
            &["show", "s"][..],
            &["validate", "s"],
            &["export", "s", "--format", "csv", "--out", "csv"],
            &["recover", "s", "--out", "copy"],
        ] {
            ends(at, arguments, codes);
            for made in ["csv", "copy"] {
                let _ = fs::remove_dir_all(at.join(made));
            }
        }
        eprintln!("{what}: read");
    };
    let new = || {
        let _ = fs::remove_dir_all(at.join("s"));
        Session::good(1.0).write(&at.join("s"));
    };
    let any = [0, 1, 3];
    let sparse = |name: &str, length: u64| {
        let file = File::options()
            .write(true)
            .create(true)
            .truncate(false)
            .open(at.join(name));
        file.unwrap().set_len(length).unwrap();
    };
    // Documents of the size of a disk.
    for name in [
        "session.json",
        "import.json",
        "validation.json",
        "handoff.json",
        "index.bin",
        "rig/rig.toml",
    ] {
        new();
        sparse(&format!("s/{name}"), 1 << 40);
        verbs(&any, name);
    }
    // Records that are longer than the file, than the limit, and than memory.
    for length in [60 << 20, 1_u64 << 32, 1 << 62, u64::MAX] {
        new();
        let segment = at.join("s/segments/000000.mcap");
        let bytes = fs::read(&segment).unwrap();
        // The first chunk follows the magic and the header record.
        let header = u64::from_le_bytes(bytes[9..17].try_into().unwrap());
        let chunk = 17 + header;
        assert_eq!(bytes[chunk as usize], 6, "a chunk");
        patch(&segment, chunk + 1, &length.to_le_bytes());
        verbs(&any, "a record's length");
        patch(
            &segment,
            chunk + 1,
            &bytes[chunk as usize + 1..chunk as usize + 9],
        );
        // Its sizes, uncompressed and compressed.
        patch(&segment, chunk + 9 + 16, &length.to_le_bytes());
        patch(&segment, chunk + 9 + 32, &length.to_le_bytes());
        verbs(&any, "a chunk's sizes");
    }
}
