//! External programs: `paws X` starts `paws-X`.
//!
//! Contract: a program is an executable file `paws-X` beside `paws` or in a folder of PATH; the
//! first one of a name counts. `paws --help` lists them, those of the toolkit with a description
//! even if they are missing. Arguments are passed on unchanged, with two exceptions: where `paws
//! reconstruct` reads a hand-off, a session of the library may be named as everywhere else
//! ([`forward_arguments`]), because `paws-reconstruct` does not depend on libraries; and `-q` and `-v` before
//! the name of a program of the toolkit are passed to it.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use command_line::Verbosity;
use session_archive::layout;

use crate::outcome::Outcome;
use crate::target::Target;

/// Name prefix of external programs.
const PREFIX: &str = "paws-";
/// The programs of this toolkit, with their descriptions.
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
/// Programs that accept `-q` and `-v`.
const HAVE_VERBOSITY: [&str; 2] = ["reconstruct", "scene"];
/// The commands of `paws-reconstruct` whose first argument is a hand-off.
const READ_HANDOFF: [&str; 3] = ["info", "frames", "run"];
/// Their long options that take no value. All others take one, and no short one does.
const FLAGS: [&str; 5] = ["--force", "--help", "--json", "--quiet", "--verbose"];

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

/// Whether a name can be typed and displayed.
fn is_plain(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
    !name.is_empty() && name.bytes().all(plain)
}

/// The arguments of a program: the verbosity, then those of the user, with a session named to
/// `paws-reconstruct` replaced by its folder.
///
/// # Errors
/// The library has no such session, or it has not been handed over.
pub fn forward_arguments(
    name: &str,
    verbosity: Verbosity,
    words: &[OsString],
    library: Option<&Path>,
) -> Result<Vec<OsString>> {
    let mut words = words.to_vec();
    let place = match name {
        "reconstruct" => handoff_position(&words),
        _ => None,
    };
    if let Some(at) = place
        && let Some(text) = words[at].to_str()
        && !text.starts_with('-')
        && !Path::new(text).exists()
    {
        let target = Target::find(text, library)?;
        if !target.folder.join(layout::HANDOFF).is_file() {
            bail!(
                "session {} has not been handed over; `paws handoff {text}` does so: {}",
                target.name(),
                target.folder.display()
            );
        }
        words[at] = target.folder.into();
    }
    if HAVE_VERBOSITY.contains(&name) {
        let is_quiet = words.iter().any(|word| word == "-q" || word == "--quiet");
        let options = verbosity.options().into_iter();
        // Given twice, it would be rejected.
        let options = options.filter(|option| !is_quiet || *option != "-q");
        words.splice(0..0, options.map(OsString::from));
    }
    Ok(words)
}

/// Position of the hand-off among the arguments for `paws-reconstruct`: the first after the command
/// that is neither an option nor the value of one.
fn handoff_position(words: &[OsString]) -> Option<usize> {
    let mut has_verb = false;
    let mut at = 0;
    while let Some(word) = words.get(at) {
        let word = word.to_string_lossy();
        match &*word {
            "--" if has_verb => return (at + 1 < words.len()).then_some(at + 1),
            option if option.starts_with('-') => {
                let has_value =
                    option.starts_with("--") && !option.contains('=') && !FLAGS.contains(&option);
                at += if has_value { 2 } else { 1 };
            }
            _ if has_verb => return Some(at),
            verb if READ_HANDOFF.contains(&verb) => {
                has_verb = true;
                at += 1;
            }
            _ => return None,
        }
    }
    None
}

/// Runs `paws-NAME` and waits for it. Its exit code becomes ours where the meaning is the same.
///
/// # Errors
/// It does not exist, or cannot be started.
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

/// Replaces this process by another program; returns only on failure, with the error.
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

    fn words(text: &str) -> Vec<OsString> {
        text.split(' ').map(Into::into).collect()
    }

    #[test]
    fn only_the_hand_off_argument_is_resolved() {
        let quiet = Verbosity::default();
        for (name, text) in [
            ("reconstruct", "evaluate latest"),
            ("reconstruct", "run --help"),
            ("reconstruct", "run ."),
            ("reconstruct", "run --out x ."),
            ("reconstruct", "-q evaluate run latest"),
            ("scene", "show latest"),
        ] {
            let handed = forward_arguments(name, quiet, &words(text), None).unwrap();
            assert_eq!(handed, words(text), "{name}");
        }
        let error = forward_arguments("reconstruct", quiet, &words("run latest --out x"), None);
        let error = error.unwrap_err().to_string();
        assert!(error.contains("PAWS_LIBRARY"), "{error}");
    }

    #[test]
    fn hand_off_argument_is_found_at_any_position() {
        for (text, expected) in [
            ("run HERE --out x", Some(1)),
            ("run --out x HERE", Some(3)),
            ("run --out=x HERE", Some(2)),
            ("-q run HERE", Some(2)),
            ("--quiet run --json -vv --preset fast HERE --force", Some(6)),
            ("frames --from -1.5 --out x HERE", Some(5)),
            ("run --out x -- HERE", Some(4)),
            ("info", None),
            ("run --out x", None),
            ("run --out x --", None),
            ("run --out", None),
            ("evaluate HERE", None),
            ("--version", None),
        ] {
            assert_eq!(handoff_position(&words(text)), expected, "{text}");
        }
    }
}
