//! The part of `paws-calib` in a deep validation: its measurements count, and it cannot be missing.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;
use collector::commands::validate::{Options, ValidatedSession, validate};
use collector::validation::Validation;
use session_archive::handoff::Verdict::{Fail, Pass};
use session_health::Limits;

use crate::support::{Session, calib_script, capture, install, measurements, prints};

const ROTATED: &str = r#"{"metric":"calib.camera_rotation","of":"feet","value":2.0,
"detail":"feet on the plate: rotated by 2.5 degrees"}"#;

/// A session without fault in a folder.
fn write(folder: &Path) -> PathBuf {
    let session = folder.join("session");
    Session::decodable(0.5).write(&session);
    session
}

/// Validates a session, with these commands of the shell for `paws-calib`.
fn deep(session: &Path, commands: &str, limits: Limits) -> Result<ValidatedSession> {
    let options = Options {
        deep: true,
        limits,
        calib_program: calib_script(session.parent().unwrap(), commands),
        ..Options::default()
    };
    capture(|console| validate(session, &options, console)).0
}

/// As [`deep`]; what it is refused with.
fn refused(session: &Path, commands: &str) -> String {
    match deep(session, commands, Limits::default()) {
        Ok(validated) => panic!("{:?}", validated.validation.verdict),
        Err(error) => format!("{error:#}"),
    }
}

#[test]
fn measurement_beyond_its_limit_fails_a_deep_validation() {
    let folder = tempfile::tempdir().unwrap();
    let session = write(folder.path());
    let validated = |measured: &str, limits| -> Validation {
        let commands = prints(&measurements(1, measured));
        deep(&session, &commands, limits).unwrap().validation
    };
    let good = validated("", Limits::default());
    assert_eq!(good.verdict, Pass, "{:?}", good.reasons);

    let found = validated(ROTATED, Limits::default());
    assert_eq!(found.verdict, Fail);
    let beyond = found.findings.iter().filter(|f| f.verdict != Pass);
    let beyond: Vec<_> = beyond
        .map(|f| (f.verdict, f.metric.as_str(), f.of.as_str(), f.value))
        .collect();
    assert_eq!(beyond, [(Fail, "calib.camera_rotation", "feet", 2.0)]);
    let reasons = &found.reasons;
    assert!(
        reasons.len() == 1 && reasons[0].contains("rotated by 2.5 degrees"),
        "{reasons:?}"
    );

    // The limits are those of this validation.
    let mut limits = Limits::default();
    limits.set("calib.camera_rotation=3,4").unwrap();
    assert_eq!(validated(ROTATED, limits).verdict, Pass);
}

#[test]
fn failed_verification_of_the_calibration_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let session = write(folder.path());
    // Also after a whole document.
    let commands = format!("{}\nexit 1", prints(&measurements(1, "")));
    let error = refused(&session, &commands);
    let expected = format!(
        "verifying the calibration: {} ended with exit status: 1",
        folder.path().join("paws-calib").display()
    );
    assert!(error.contains(&expected), "{error}");
}

#[test]
fn measurements_of_another_version_are_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let session = write(folder.path());
    for (document, expected) in [
        (measurements(2, ""), "found paws-measurements version 2"),
        ("PASS".to_owned(), "reading measurements"),
    ] {
        let error = refused(&session, &prints(&document));
        assert!(error.contains("paws-calib: "), "{error}");
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn deep_validation_without_paws_calib_names_it_and_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let session = write(folder.path());
    let bin = folder.path().join("bin");
    std::fs::create_dir(&bin).unwrap();
    let paws = bin.join("paws");
    install(Path::new(env!("CARGO_BIN_EXE_paws")), &paws);
    let run = |arguments: &[&str]| {
        let mut command = Command::new(&paws);
        command.arg("validate").args(arguments).arg(&session);
        let output = command.env("PATH", &bin).output().unwrap();
        let text = [output.stdout, output.stderr].map(|b| String::from_utf8(b).unwrap());
        (output.status.code(), text.concat())
    };
    let (code, text) = run(&["--deep"]);
    assert_eq!(code, Some(1), "{text}");
    let expected = "verifying the calibration: starting paws-calib: it is neither beside paws nor \
                    on PATH; install it there";
    assert!(text.contains(expected), "{text}");
    // Only a deep validation needs it.
    let (code, text) = run(&[]);
    assert_eq!(code, Some(0), "{text}");
}
