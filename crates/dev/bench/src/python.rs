//! Peers in Python, in the same run: a script that takes JSON on its standard input and gives JSON
//! back.

use std::ffi::OsString;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use serde_json::Value;

/// Variables that name an interpreter: with OpenCV, GTSAM, Open3D, a foreign renderer, and MuJoCo
/// with a robot that walks.
pub(crate) const OPENCV: &str = "PAWS_PYTHON";
pub(crate) const GTSAM: &str = "PAWS_GTSAM_PYTHON";
pub(crate) const OPEN3D: &str = "PAWS_OPEN3D_PYTHON";
pub(crate) const RENDERER: &str = "PAWS_RENDERER_PYTHON";
pub(crate) const LEARNING: &str = "PAWS_LEARNING_PYTHON";
pub(crate) const PHYSICS: &str = "PAWS_PHYSICS_PYTHON";

/// The interpreter with OpenCV.
///
/// # Errors
/// No interpreter is named.
pub(crate) fn interpreter() -> Result<OsString> {
    interpreter_in(OPENCV)
}

/// The interpreter that a variable names.
///
/// # Errors
/// No interpreter is named.
pub(crate) fn interpreter_in(variable: &str) -> Result<OsString> {
    std::env::var_os(variable).with_context(|| {
        format!("{variable} names no Python interpreter; `cargo xtask bench` makes one")
    })
}

/// Answer of a script, by its path from `crates/dev/bench/src`, to a question.
///
/// # Errors
/// It does not start, fails, or answers in no JSON.
pub(crate) fn ask(script: &str, question: &Value) -> Result<Value> {
    ask_in(OPENCV, script, question)
}

/// The same with the interpreter that a variable names.
///
/// # Errors
/// It does not start, fails, or answers in no JSON.
pub(crate) fn ask_in(variable: &str, script: &str, question: &Value) -> Result<Value> {
    ask_with(interpreter_in(variable)?, script, question)
}

/// The same with an interpreter.
///
/// # Errors
/// It does not start, fails, or answers in no JSON.
pub(crate) fn ask_with(interpreter: OsString, script: &str, question: &Value) -> Result<Value> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("src")
        .join(script);
    let mut child = Command::new(interpreter)
        .arg(path)
        // Modules beside a script leave nothing in the folder of the sources.
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .context("starting python")?;
    let mut stdin = child.stdin.take().context("python's standard input")?;
    stdin
        .write_all(question.to_string().as_bytes())
        .context("writing to python")?;
    drop(stdin);
    let output = child.wait_with_output().context("waiting for python")?;
    ensure!(
        output.status.success(),
        "{script} ended with {}",
        output.status
    );
    serde_json::from_slice(&output.stdout).with_context(|| format!("reading what {script} says"))
}
