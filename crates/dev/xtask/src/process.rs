//! Starting other programs from the workspace root, and the few paths that every verb shares.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};

/// The workspace root, absolute.
pub(crate) fn root() -> Result<PathBuf> {
    let package = std::env::var_os("CARGO_MANIFEST_DIR")
        .context("CARGO_MANIFEST_DIR is not set: start this program as `cargo xtask`")?;
    // crates/dev/xtask
    let root = Path::new(&package)
        .ancestors()
        .nth(3)
        .context("the xtask package is not three folders below the workspace root")?;
    Ok(root.to_owned())
}

/// The folder with the programs of the profile that built this one (`target/debug`), wherever
/// Cargo's configuration puts the target folder.
pub(crate) fn program_folder() -> Result<PathBuf> {
    let this = std::env::current_exe().context("finding this program's own path")?;
    let folder = this.parent().context("this program has no folder")?;
    Ok(folder.to_owned())
}

/// The target folder, for what the verbs leave there.
pub(crate) fn target_folder() -> Result<PathBuf> {
    let programs = program_folder()?;
    let target = programs.parent().context("no target folder")?;
    Ok(target.to_owned())
}

/// The folder of real recordings, absolute, or `None` where there is none. A `PAWS_DATA` that
/// names no folder is an error.
pub(crate) fn data_folder() -> Result<Option<PathBuf>> {
    if let Some(named) = std::env::var_os("PAWS_DATA") {
        let folder = std::fs::canonicalize(&named)
            .with_context(|| format!("opening the folder that PAWS_DATA names, {named:?}"))?;
        ensure!(
            folder.is_dir(),
            "PAWS_DATA names something that is not a folder: {named:?}"
        );
        return Ok(Some(folder));
    }
    Ok(std::fs::canonicalize(root()?.join("../shared/data")).ok())
}

/// A program started in the workspace root, with nothing on its standard input.
pub(crate) fn command(program: impl AsRef<OsStr>) -> Result<Command> {
    let mut command = Command::new(program);
    command.current_dir(root()?).stdin(Stdio::null());
    Ok(command)
}

/// The Cargo that started this program.
pub(crate) fn cargo() -> Result<Command> {
    command(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Runs to the end with the output shown; an exit code other than 0 is an error.
pub(crate) fn run(command: &mut Command) -> Result<()> {
    let status = command
        .status()
        .with_context(|| format!("starting `{}`", line(command)))?;
    if !status.success() {
        bail!("`{}` ended with {status}", line(command));
    }
    Ok(())
}

/// Whether the program is there and ends with exit code 0, with its output thrown away.
pub(crate) fn succeeds(command: &mut Command) -> bool {
    command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

/// The command as a person would type it, for messages. Words that a shell would split are quoted.
pub(crate) fn line(command: &Command) -> String {
    let program = Path::new(command.get_program())
        .file_name()
        .unwrap_or(command.get_program());
    std::iter::once(program)
        .chain(command.get_args())
        .map(|word| {
            let word = word.to_string_lossy();
            let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,+@%".contains(c);
            if !word.is_empty() && word.chars().all(plain) {
                word.into_owned()
            } else {
                format!("'{}'", word.replace('\'', r"'\''"))
            }
        })
        .collect::<Vec<_>>()
        .join(" ")
}

/// `3.2 s` or `4 min 07 s`.
pub(crate) fn human(took: Duration) -> String {
    let seconds = took.as_secs();
    if seconds < 60 {
        format!("{:.1} s", took.as_secs_f64())
    } else {
        format!("{} min {:02} s", seconds / 60, seconds % 60)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shown_command_can_be_pasted_into_a_shell() {
        let mut command = Command::new("/usr/bin/cargo");
        command.args(["test", "it's here", "--", "-D", ""]);
        assert_eq!(line(&command), r"cargo test 'it'\''s here' -- -D ''");
    }

    #[test]
    fn times_read_well_on_both_sides_of_a_minute() {
        assert_eq!(human(Duration::from_millis(59_940)), "59.9 s");
        assert_eq!(human(Duration::from_millis(247_900)), "4 min 07 s");
    }
}
