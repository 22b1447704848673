//! The catalogue: damaged, rebuilt, and used by several programs at a time.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::{ID, Session};

fn paws(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_paws"));
    command
        .args(arguments)
        .current_dir(folder)
        .env("PAWS_LIBRARY", folder.join("library"));
    command
}

/// Runs it; returns standard output and standard error.
fn run(folder: &Path, arguments: &[&str]) -> (String, String) {
    let output = paws(folder, arguments).output().unwrap();
    let [out, err] = [output.stdout, output.stderr].map(|b| String::from_utf8(b).unwrap());
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {out}{err}");
    (out, err)
}

fn other_id(n: usize) -> String {
    format!("0192aa00-0000-7000-8000-0000000001{n:02}")
}

#[test]
fn damaged_catalogue_is_renamed_and_rebuilt() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    Session::good(1.0).write(&at.join("disk/walk"));
    run(at, &["import", "disk"]);
    run(at, &["validate", ID]);
    let listed = run(at, &["list"]);
    assert!(
        listed.0.contains("PASS") && listed.1.is_empty(),
        "{listed:?}"
    );
    let catalogue = at.join("library/catalogue.sqlite");
    let whole = fs::read(&catalogue).unwrap();
    let mut other_version = whole.clone();
    // The user version of the header, big-endian (sqlite.org/fileformat2.html, 1.3).
    other_version[60..64].copy_from_slice(&7_u32.to_be_bytes());
    let mut overwritten = whole.clone();
    overwritten[4096..].fill(0xff);
    let cases: [(&str, Vec<u8>); 5] = [
        ("it is empty", Vec::new()),
        ("not an SQLite database", b"garbage".repeat(999)),
        ("", whole[..whole.len() - 4096].to_vec()),
        ("version 7", other_version),
        ("", overwritten),
    ];
    for (i, (why, content)) in cases.iter().enumerate() {
        fs::write(&catalogue, content).unwrap();
        let (out, err) = run(at, &["list"]);
        assert_eq!(out, listed.0, "case {i}");
        assert!(err.contains(why) && err.contains("was rebuilt"), "{err}");
        let name = match i {
            0 => "catalogue.sqlite.damaged".to_owned(),
            i => format!("catalogue.sqlite.damaged-{}", i + 1),
        };
        assert!(err.contains(&name), "{err}");
        assert_eq!(fs::read(at.join("library").join(name)).unwrap(), *content);
        assert_eq!(run(at, &["list"]), listed, "case {i}");
    }
    // An import detects the damage, too.
    fs::write(&catalogue, b"garbage").unwrap();
    let (out, err) = run(at, &["import", "disk"]);
    assert!(out.contains("imported already"), "{out}");
    assert!(err.contains("was rebuilt"), "{err}");
    assert_eq!(run(at, &["list"]), listed);
}

#[test]
fn simultaneous_imports_into_a_new_library_all_succeed() {
    const PROGRAMS: usize = 4;
    let folder = tempfile::tempdir().unwrap();
    for n in 0..PROGRAMS {
        let mut session = Session::good(1.0);
        session.spec.session_id = other_id(n);
        session.write(&folder.path().join(format!("disk-{n}/walk")));
    }
    let mut waited = 0;
    for round in 0..15 {
        let at = folder.path();
        // Every other round all of them also import the same session.
        let same = format!("disk-{}", round % PROGRAMS);
        let programs: Vec<_> = (0..PROGRAMS)
            .map(|n| {
                let own = format!("disk-{n}");
                let sources = [own.as_str(), same.as_str()];
                let take = 1 + round % 2;
                paws(at, &[&["import"], &sources[..take]].concat())
                    .stdout(Stdio::piped())
                    .stderr(Stdio::piped())
                    .spawn()
                    .unwrap()
            })
            .collect();
        for program in programs {
            let output = program.wait_with_output().unwrap();
            let [out, err] = [output.stdout, output.stderr].map(|b| String::from_utf8(b).unwrap());
            assert_eq!(output.status.code(), Some(0), "round {round}: {out}{err}");
            waited += err.matches("waiting for it to end").count();
            let other = err.lines().filter(|l| !l.contains("waiting for it to end"));
            let other: Vec<&str> = other
                .filter(|l| l.contains("paws:") || l.contains("warn"))
                .collect();
            assert!(other.is_empty(), "round {round}: {other:?}");
        }
        let (out, err) = run(at, &["list"]);
        for n in 0..PROGRAMS {
            assert!(out.contains(&other_id(n)), "round {round}: {out}");
        }
        assert_eq!(out.lines().count(), 1 + PROGRAMS, "{out}");
        assert_eq!(err, "");
        let mut names: Vec<_> = fs::read_dir(at.join("library"))
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        assert_eq!(
            names,
            [".incoming", ".lock", "catalogue.sqlite", "sessions"]
        );
        assert_eq!(
            fs::read_dir(at.join("library/.incoming")).unwrap().count(),
            0
        );
        fs::remove_dir_all(at.join("library")).unwrap();
    }
    eprintln!("{waited} of {} imports waited for another", 15 * PROGRAMS);
}

#[test]
fn readers_work_while_the_library_is_created() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for n in 0..3 {
        let mut session = Session::good(1.0);
        session.spec.session_id = other_id(n);
        session.write(&at.join(format!("disk/walk-{n}")));
    }
    for _ in 0..5 {
        fs::create_dir_all(at.join("library/sessions")).unwrap();
        let mut import = paws(at, &["import", "disk"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // List until the import has ended, and once more.
        loop {
            let ended = import.try_wait().unwrap();
            run(at, &["list"]);
            if let Some(status) = ended {
                assert!(status.success());
                break;
            }
        }
        let (out, _) = run(at, &["list"]);
        assert_eq!(out.lines().count(), 4, "{out}");
        fs::remove_dir_all(at.join("library")).unwrap();
    }
}
