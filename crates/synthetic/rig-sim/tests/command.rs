//! The program: outputs and exit codes.

use std::path::Path;
use std::process::{Command, Output};

fn run(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_paws-rig-sim"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

fn check(folder: &Path, arguments: &[&str], code: i32) -> [String; 2] {
    let output = run(folder, arguments);
    let texts = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    let ended = output.status.code();
    assert_eq!(ended, Some(code), "{arguments:?}: {texts:?}");
    texts
}

#[test]
fn quiet_prints_only_the_result() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let render =
        "render --scene pavement --seconds 0.3 --rate 10 --width 64 --height 36 --quality fast";
    let mut arguments: Vec<&str> = render.split(' ').collect();
    arguments.extend(["-q", "--out", "walk"]);
    let [out, error] = check(at, &arguments, 0);
    assert_eq!(error, "");
    assert!(
        out.ends_with("0.3 s of pavement, day, seed 1: walk\n"),
        "{out}"
    );
    assert_eq!(out.lines().count(), 1, "{out}");
    // An error is reported.
    let [out, error] = check(at, &arguments, 1);
    assert_eq!(out, "");
    assert!(error.starts_with("error: "), "{error}");
}

#[test]
fn completions_and_manual_pages_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for shell in ["bash", "zsh", "fish"] {
        let [out, _] = check(at, &["completions", shell], 0);
        for word in ["paws-rig-sim", "preview", "low-sun"] {
            assert!(out.contains(word), "{shell}: {word}");
        }
    }
    check(at, &["man", "--out", "man"], 0);
    for page in [
        "paws-rig-sim",
        "paws-rig-sim-render",
        "paws-rig-sim-preview",
    ] {
        let page = at.join(format!("man/{page}.1"));
        let text = std::fs::read_to_string(&page).unwrap();
        assert!(text.starts_with(".ie") || text.contains(".TH"), "{page:?}");
    }
    let [out, _] = check(at, &["render", "--help"], 0);
    assert!(
        out.contains("Examples:\n  # a session, for `paws import`\n"),
        "{out}"
    );
}

#[test]
fn invalid_arguments_exit_with_2() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for arguments in [
        &["render", "--scene", "moon", "--out", "x"][..],
        &[
            "render",
            "--scene",
            "plaza",
            "--seconds",
            "-1",
            "--out",
            "x",
        ],
        &["-q", "-v", "preview", "--scene", "plaza", "--out", "x.png"],
        &[],
    ] {
        check(at, arguments, 2);
    }
    let [_, error] = check(
        at,
        &[
            "preview",
            "--scene",
            "plaza",
            "--rig",
            "/dev/zero",
            "--out",
            "x.png",
        ],
        1,
    );
    assert!(error.contains("found a character device"), "{error}");
    assert!(!at.join("x.png").exists());
}
