//! A library that cannot be written: it can be read, and pruned.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use crate::support::{ID, Session};

const OTHER: &str = "0192aa00-0000-7000-8000-000000000002";

/// A library with two sessions, the first validated, both indexed; `library` in a new folder.
fn library() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    Session::good(1.0).write(&folder.path().join("disk/walk"));
    let mut other = Session::good(1.0);
    other.spec.session_id = OTHER.to_owned();
    other.spec.name = "run".to_owned();
    other.write(&folder.path().join("disk/run"));
    for arguments in [
        &["import", "disk"][..],
        &["validate", ID],
        &["index", ID, OTHER],
    ] {
        let output = command(folder.path(), "exec \"$0\" \"$@\"", arguments)
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    }
    folder
}

/// `paws` started by a line of shell.
fn command(folder: &Path, line: &str, arguments: &[&str]) -> Command {
    let mut command = Command::new("sh");
    command
        .args(["-c", line, env!("CARGO_BIN_EXE_paws")])
        .args(arguments)
        .current_dir(folder)
        .env("PAWS_LIBRARY", folder.join("library"));
    command
}

fn text(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|b| String::from_utf8_lossy(b));
    format!("{out}{err}")
}

/// No file can grow by writes of the program: simulates a full disk.
const NO_GROWTH: &str = "trap '' XFSZ; ulimit -f 0 && exec \"$0\" \"$@\"";

fn check(folder: &Path, line: &str, arguments: &[&str], code: i32, part: &str) -> String {
    let output = command(folder, line, arguments).output().unwrap();
    let said = text(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
    assert!(said.contains(part), "{arguments:?}: {part:?} not in {said}");
    assert!(!said.contains("database is locked"), "{said}");
    said
}

#[test]
fn library_is_readable_and_prunable_if_no_file_can_grow() {
    let folder = library();
    let at = folder.path();
    // Check that the limit works: no byte can be written.
    let write = "trap '' XFSZ; ulimit -f 0 && echo x > written";
    let done = Command::new("sh")
        .args(["-c", write])
        .current_dir(at)
        .output();
    if done.is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: this system does not limit the length of files (ulimit -f)");
        return;
    }
    let catalogue = at.join("library/catalogue.sqlite");
    let whole = fs::read(&catalogue).unwrap();
    for state in ["whole", "missing", "damaged"] {
        match state {
            "missing" => fs::remove_file(&catalogue).unwrap(),
            "damaged" => fs::write(&catalogue, &whole[..whole.len() / 2]).unwrap(),
            _ => {}
        }
        for session in [ID, OTHER] {
            check(at, NO_GROWTH, &["list"], 0, session);
        }
        let said = check(at, NO_GROWTH, &["list"], 0, "PASS");
        assert_eq!(
            said.contains("cannot be used") && said.contains("cannot be rebuilt"),
            state == "damaged",
            "{said}"
        );
        check(at, NO_GROWTH, &["show", "walk"], 0, "PASS");
        let said = check(at, NO_GROWTH, &["validate", "run"], 0, "PASS");
        assert!(said.contains("the verdict is not stored"), "{said}");
        check(
            at,
            NO_GROWTH,
            &["report", "walk", "--out", "/dev/stdout"],
            0,
            "<!DOCTYPE html>",
        );
        if state == "damaged" {
            // A file that cannot be replaced is unchanged.
            assert_eq!(fs::read(&catalogue).unwrap(), whole[..whole.len() / 2]);
        }
        assert!(!at.join("library/catalogue.sqlite.new").exists(), "{state}");
    }
    fs::write(&catalogue, &whole).unwrap();
    check(at, NO_GROWTH, &["prune"], 0, "removed 3 derived files");
    check(at, NO_GROWTH, &["list"], 0, OTHER);
    let remove = ["prune", "--session", OTHER, "--yes"];
    check(at, NO_GROWTH, &remove, 0, "removed");
    assert!(!at.join("library/sessions").join(OTHER).exists());
    assert_eq!(
        fs::read_dir(at.join("library/.incoming")).unwrap().count(),
        0
    );
    let said = check(at, NO_GROWTH, &["list"], 0, ID);
    assert!(!said.contains(OTHER), "{said}");
    // With free space again, everything works as before.
    let free = "exec \"$0\" \"$@\"";
    let said = check(at, free, &["list"], 0, ID);
    assert!(!said.contains(OTHER) && !said.contains("PASS"), "{said}");
    check(at, free, &["validate", "walk"], 0, "PASS");
    check(at, free, &["list"], 0, "PASS");
    check(at, free, &["import", "disk"], 0, "imported");
}

#[test]
fn library_works_on_a_full_and_on_a_read_only_disk() {
    let folder = library();
    let at = folder.path();
    let script = r#"
        set -eu
        mkdir small
        mount -t tmpfs -o size=4m none small
        cp -a library small/
        export PAWS_LIBRARY="$PWD/small/library"
        run() { code=0; "$0" "$@" > said 2>&1 || code=$?; echo "$1: $code"; cat said; }
        fill() { dd if=/dev/zero of=small/fill bs=1k 2>/dev/null || true; test "$(df --output=avail small | tail -n 1)" = 0; }
        fill
        run list
        run show walk
        run validate run
        run export walk --format csv --out exported
        mount -o remount,ro small
        run list
        run show walk
        run validate run
        mount -o remount,rw small
        rm small/library/catalogue.sqlite
        dd if=/dev/zero of=small/fill2 bs=1k 2>/dev/null || true
        run list
        run prune
        dd if=/dev/zero of=small/fill3 bs=1k 2>/dev/null || true
        run prune --session 0192aa00-0000-7000-8000-000000000002 --yes
        run list
        echo finished
    "#;
    let output = Command::new("unshare")
        .args(["--user", "--map-root-user", "--mount", "sh", "-c"])
        .args([script, env!("CARGO_BIN_EXE_paws")])
        .current_dir(at)
        .output();
    let said = match output {
        Ok(output) if text(&output).contains("list: ") => text(&output),
        Ok(output) => {
            let why = text(&output);
            eprintln!(
                "skipped: this system lets no user mount a disk: {}",
                why.trim()
            );
            return;
        }
        Err(e) => {
            eprintln!("skipped: unshare cannot be started: {e}");
            return;
        }
    };
    assert!(said.trim_end().ends_with("finished"), "{said}");
    let codes: Vec<&str> = said
        .lines()
        .filter(|l| {
            let verbs = ["list: ", "show: ", "validate: ", "export: ", "prune: "];
            verbs.iter().any(|verb| l.starts_with(verb))
        })
        .collect();
    assert_eq!(codes.len(), 11, "{said}");
    assert!(codes.iter().all(|line| line.ends_with(": 0")), "{said}");
    assert_eq!(
        said.matches("the verdict is not stored").count(),
        2,
        "{said}"
    );
    assert!(at.join("exported/feet_imu.csv").is_file());
    let last = said.rsplit("list: 0").next().unwrap();
    assert!(last.contains(ID) && !last.contains(OTHER), "{said}");
}
