//! The check of the calibration in a deep validation, which `paws-calib measure` computes.
//!
//! Contract: a session without enough calibration has no measurements. That the program is missing
//! or fails is an error: a deep validation is never less than it states.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use console_output::{Console, Show};
use session_health::{Measurement, read_measurements};

use crate::external::needed_program;

/// Measures how far the rig is from its nominal calibration. `program` is used instead of
/// `paws-calib` beside this program or on PATH.
///
/// # Errors
/// The program is missing, fails, or prints something else.
pub(crate) fn measure(
    folder: &Path,
    program: Option<&Path>,
    console: &Console<'_>,
) -> Result<Vec<Measurement>> {
    let program = match program {
        Some(program) => program.to_owned(),
        None => needed_program("calib").context("verifying the calibration")?,
    };
    let mut command = Command::new(&program);
    if console.show == Show::Nothing {
        command.arg("-q");
    }
    let output = command
        .args(["measure", "--"])
        .arg(folder)
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .with_context(|| format!("starting {}", program.display()))?;
    ensure!(
        output.status.success(),
        "verifying the calibration: {} ended with {}",
        program.display(),
        output.status
    );
    read_measurements(&output.stdout)
        .with_context(|| format!("reading the output of {}", program.display()))
}
