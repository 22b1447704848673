//! Arguments: where results go, and what is refused.

use std::fs;
use std::process::Command;

use crate::imu_noise::{model, write};
use crate::rendered::calib;

/// A session of a library, named by its folder.
#[test]
fn results_of_an_earlier_run_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().canonicalize().unwrap();
    fs::create_dir(root.join(".incoming")).unwrap();
    let session = root.join("sessions/still");
    write(&session, model(), 2, [0, 0], [0, 0]);
    let path = session.to_str().unwrap();
    let results = session.join("calibration");
    fs::create_dir(&results).unwrap();
    for (verb, result) in [
        ("cameras", "rig.toml"),
        ("camera-imu", "rig-imu.toml"),
        ("imu", "imu-noise.json"),
    ] {
        let result = results.join(result);
        fs::write(&result, "mine").unwrap();
        let (code, text) = calib(&[verb, path]);
        assert_eq!(code, Some(1), "{text}");
        assert!(text.contains(result.to_str().unwrap()), "{text}");
        assert_eq!(fs::read(&result).unwrap(), b"mine");
        fs::remove_file(&result).unwrap();
    }
}

#[test]
fn session_without_calibration_has_nothing_to_verify() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("still");
    write(&session, model(), 2, [0, 0], [0, 0]);
    let path = session.to_str().unwrap();
    let (code, text) = calib(&["verify", path]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("nothing to verify"), "{text}");
    let (code, text) = calib(&["-q", "measure", path]);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.ends_with("\"measurements\":[]}\n"), "{text}");
    let (code, text) = calib(&["imu", path]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("--out names another path"), "{text}");
    let (code, text) = calib(&["verify", "latest"]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.starts_with("paws-calib: \"latest\" is not"), "{text}");
}

#[test]
fn named_pipe_is_not_read_as_a_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("p.yaml");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    let out = folder.path().join("o");
    let [pipe, out] = [&pipe, &out].map(|path| path.to_str().unwrap());
    let (code, text) = calib(&["convert", pipe, "--to", "opencv", "--out", out]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("p.yaml"), "{text}");
}
