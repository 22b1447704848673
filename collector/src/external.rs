//! Programs beside this one: `paws X` starts `paws-X`.

use std::ffi::{OsStr, OsString};
use std::io;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::outcome::Outcome;

/// The program `paws-NAME`, beside this one or on PATH.
pub fn program(name: &str) -> Option<PathBuf> {
    let file = format!("paws-{name}");
    let beside = std::env::current_exe()
        .ok()
        .and_then(|own| Some(own.parent()?.join(&file)));
    let on_path = std::env::var_os("PATH").unwrap_or_default();
    let on_path: Vec<PathBuf> = std::env::split_paths(&on_path)
        .map(|folder| folder.join(&file))
        .collect();
    beside
        .into_iter()
        .chain(on_path)
        .find(|path| path.is_file())
}

/// Runs `paws-NAME` to its end. Its exit code becomes ours as far as ours have that meaning.
///
/// # Errors
/// It is not there, or cannot be started.
pub fn start(name: &str, arguments: &[&OsStr]) -> Result<Outcome> {
    let program = program(name).with_context(|| {
        format!("starting paws-{name}: it is neither beside paws nor on PATH; install it there")
    })?;
    let status = Command::new(&program)
        .args(arguments)
        .status()
        .with_context(|| format!("starting {}", program.display()))?;
    Ok(match status.code() {
        Some(0) => Outcome::Fine,
        Some(3) => Outcome::Loss,
        _ => Outcome::Failed,
    })
}

/// Replaces this program by another one; only comes back with the reason why not.
pub fn become_program(program: &Path, arguments: &[OsString]) -> io::Error {
    Command::new(program).args(arguments).exec()
}
