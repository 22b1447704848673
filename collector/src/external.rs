//! Programs beside this one: `paws X` starts `paws-X`.
//!
//! Contract: a program is a file `paws-X` that may be executed, beside `paws` or in a folder of PATH; the first one of a
//! name counts. `paws --help` lists them, those of the toolkit with what they do even where they are missing. Their
//! arguments are handed on as they are, with one exception: where `paws reconstruct` reads a hand-off, a session of the
//! library may be named as everywhere else ([`hand_on`]), for `paws-reconstruct` knows nothing of libraries.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use session_archive::layout;

use crate::outcome::Outcome;
use crate::target::Target;

/// What programs of `paws` are called, without their own name.
const PREFIX: &str = "paws-";
/// The programs of this toolkit, and what they do.
const KNOWN: [(&str, &str); 3] = [
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
/// The verbs of `paws-reconstruct` whose first argument is a hand-off.
const READ_HANDOFF: [&str; 3] = ["info", "frames", "run"];

/// The folders in which programs are looked for, in their order.
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
pub fn program(name: &str) -> Option<PathBuf> {
    let file = format!("{PREFIX}{name}");
    let mut candidates = folders().into_iter().map(|folder| folder.join(&file));
    candidates.find(|path| is_program(path))
}

/// The list of programs for `paws --help`: one line each.
pub fn listing() -> String {
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

/// Whether a name can be typed, and shown.
fn is_plain(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
    !name.is_empty() && name.bytes().all(plain)
}

/// The arguments of a program: those of the user, but for a session named to `paws-reconstruct` the folder of it.
///
/// # Errors
/// The library has no such session, or it has not been handed over.
pub fn hand_on(name: &str, words: &[OsString], library: Option<&Path>) -> Result<Vec<OsString>> {
    let mut words = words.to_vec();
    let reads = |verb: &OsString| READ_HANDOFF.iter().any(|known| verb == known);
    if name != "reconstruct" || !words.first().is_some_and(reads) {
        return Ok(words);
    }
    let Some(text) = words.get(1).and_then(|word| word.to_str()) else {
        return Ok(words);
    };
    if text.starts_with('-') || Path::new(text).exists() {
        return Ok(words);
    }
    let target = Target::find(text, library)?;
    if !target.folder.join(layout::HANDOFF).is_file() {
        bail!(
            "session {} has not been handed over; `paws handoff {text}` does so: {}",
            target.name(),
            target.folder.display()
        );
    }
    words[1] = target.folder.into();
    Ok(words)
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
        assert_eq!(lines.len(), 4, "{text}");
        assert!(lines[0].starts_with("hello ") && lines[0].ends_with("paws-hello"));
        assert!(lines[1].starts_with("reconstruct ") && lines[1].ends_with("(not found)"));
        assert!(lines[3].starts_with("scene ") && lines[3].ends_with("of others"));
    }

    #[test]
    fn only_the_place_of_a_handoff_is_looked_up() {
        let words = |text: &str| -> Vec<OsString> { text.split(' ').map(Into::into).collect() };
        for (name, text) in [
            ("reconstruct", "evaluate latest"),
            ("reconstruct", "run --help"),
            ("reconstruct", "run ."),
            ("scene", "show latest"),
        ] {
            let handed = hand_on(name, &words(text), None).unwrap();
            assert_eq!(handed, words(text), "{name}");
        }
        let error = hand_on("reconstruct", &words("run latest --out x"), None);
        let error = error.unwrap_err().to_string();
        assert!(error.contains("PAWS_LIBRARY"), "{error}");
    }
}
