//! External programs: `paws X` starts `paws-X`.
//!
//! Contract: a program is an executable file `paws-X` beside `paws` or in a folder of PATH; the
//! first one of a name counts. `paws --help` lists them, those of the toolkit with a description
//! even if they are missing. Arguments are passed on as [`crate::forwarding`] describes.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use console_output::Outcome;

/// Name prefix of external programs.
const PREFIX: &str = "paws-";
/// The programs of this toolkit, with their descriptions.
const KNOWN: [(&str, &str); 4] = [
    ("calib", "Calibrate from a session"),
    (
        "reconstruct",
        "Depth, poses and a cloud from a hand-off: a scene bundle",
    ),
    (
        "rig-sim",
        "Simulate a walk with the rig, with its exact truth",
    ),
    (
        "scene",
        "Look into a scene bundle, check it, write it in the formats of others",
    ),
];

/// The folders that are searched for programs, in this order.
fn folders() -> Vec<PathBuf> {
    let beside = std::env::current_exe()
        .ok()
        .and_then(|own| Some(own.parent()?.to_owned()));
    let on_path = std::env::var_os("PATH").unwrap_or_default();
    beside
        .into_iter()
        .chain(std::env::split_paths(&on_path))
        .collect()
}

fn is_program(path: &Path) -> bool {
    let data = path.metadata();
    data.is_ok_and(|data| data.is_file() && data.permissions().mode() & 0o111 != 0)
}

/// The program `paws-NAME`, beside this one or on PATH.
pub(crate) fn program(name: &str) -> Option<PathBuf> {
    let file = format!("{PREFIX}{name}");
    let mut candidates = folders().into_iter().map(|folder| folder.join(&file));
    candidates.find(|path| is_program(path))
}

/// Whether this is the name of a program of the toolkit.
pub(crate) fn is_known(name: &str) -> bool {
    KNOWN.iter().any(|(known, _)| *known == name)
}

/// The program `paws-NAME`, which has to be there.
///
/// # Errors
/// It is neither beside this program nor on PATH.
pub(crate) fn needed_program(name: &str) -> Result<PathBuf> {
    program(name).with_context(|| {
        format!("starting paws-{name}: it is neither beside paws nor on PATH; install it there")
    })
}

/// The list of programs for `paws --help`: one line each.
pub(crate) fn listing() -> String {
    listing_of(&folders())
}

fn listing_of(folders: &[PathBuf]) -> String {
    let mut found: BTreeMap<String, PathBuf> = BTreeMap::new();
    for folder in folders {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let name = name.to_str().and_then(|name| name.strip_prefix(PREFIX));
            let Some(name) = name.filter(|name| is_plain(name)) else {
                continue;
            };
            if !found.contains_key(name) && is_program(&entry.path()) {
                found.insert(name.to_owned(), entry.path());
            }
        }
    }
    let mut lines: BTreeMap<&str, String> = BTreeMap::new();
    for (name, what) in KNOWN {
        lines.insert(
            name,
            match found.contains_key(name) {
                true => what.to_owned(),
                false => format!("{what} (not found)"),
            },
        );
    }
    for (name, path) in &found {
        let line = || path.display().to_string();
        lines.entry(name).or_insert_with(line);
    }
    let mut text = "Programs beside paws or on PATH, started as `paws NAME`:".to_owned();
    for (name, line) in lines {
        text.push_str(&format!("\n  {name:12} {line}"));
    }
    text
}

/// Whether a name can be typed and displayed.
fn is_plain(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
    !name.is_empty() && name.bytes().all(plain)
}

/// Runs `paws-NAME` and waits for it. Its exit code becomes ours where the meaning is the same.
///
/// # Errors
/// It does not exist, or cannot be started.
pub(crate) fn start(name: &str, arguments: &[&OsStr]) -> Result<Outcome> {
    let program = needed_program(name)?;
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

/// Replaces this process by another program; returns only on failure, with the error.
pub(crate) fn become_program(program: &Path, arguments: &[OsString]) -> io::Error {
    Command::new(program).args(arguments).exec()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn programs_are_listed_with_one_line_each() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, mode: u32| {
            let path = folder.path().join(name);
            fs::write(&path, "").unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        };
        put("paws-scene", 0o755);
        put("paws-hello", 0o755);
        put("paws-notes", 0o644);
        put("paws-a\u{1b}[31mred", 0o755);
        let text = listing_of(&[folder.path().to_owned()]);
        let lines: Vec<&str> = text.lines().skip(1).map(str::trim).collect();
        assert_eq!(lines.len(), 5, "{text}");
        assert!(lines[1].starts_with("hello ") && lines[1].ends_with("paws-hello"));
        assert!(lines[2].starts_with("reconstruct ") && lines[2].ends_with("(not found)"));
        assert!(lines[4].starts_with("scene ") && lines[4].ends_with("of others"));
    }
}
