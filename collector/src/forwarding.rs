//! Arguments of external programs, as `paws` passes them on.
//!
//! Contract: they are passed on unchanged, with two exceptions. Where `paws reconstruct` reads a
//! hand-off and `paws calib` a session, a session of the library may be named as everywhere else,
//! because these programs do not depend on libraries; and `-q` and `-v` before the name of a
//! program of the toolkit are passed to it.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use command_line::Verbosity;
use session_archive::layout;

use crate::target::Target;

/// Programs that accept `-q` and `-v`.
const HAVE_VERBOSITY: [&str; 3] = ["calib", "reconstruct", "scene"];

/// Verbs of a program whose first argument is a session.
struct SessionVerbs {
    verbs: &'static [&'static str],
    /// Their long options that take no value. All others take one, and no short one does.
    flags: &'static [&'static str],
}

/// Verbs of `paws-calib` that read a session.
const CALIB: SessionVerbs = SessionVerbs {
    verbs: &["camera-imu", "cameras", "imu", "verify"],
    flags: &["--force", "--help", "--keep-model", "--quiet", "--verbose"],
};
/// Verbs of `paws-reconstruct` that read a hand-off.
const RECONSTRUCT: SessionVerbs = SessionVerbs {
    verbs: &["info", "frames", "run"],
    flags: &[
        "--cpu-fallback",
        "--force",
        "--help",
        "--json",
        "--quiet",
        "--verbose",
    ],
};

/// The arguments of a program: the verbosity, then those of the user, with a session named to
/// `paws-calib` or `paws-reconstruct` replaced by its folder. `--library` of `paws calib` is one of
/// `paws`.
///
/// # Errors
/// The library has no such session, or it has not been handed over.
pub(crate) fn forward_arguments(
    name: &str,
    verbosity: Verbosity,
    words: &[OsString],
    library: Option<&Path>,
) -> Result<Vec<OsString>> {
    let mut words = words.to_vec();
    match name {
        "calib" => {
            let own = take_library(&mut words);
            replace_session(&mut words, own.as_deref().or(library))?;
        }
        "reconstruct" => replace_handoff(&mut words, library)?,
        _ => {}
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

/// Removes `--library DIR` or `--library=DIR`, and returns the folder.
fn take_library(words: &mut Vec<OsString>) -> Option<PathBuf> {
    let end = words.iter().position(|word| word == "--");
    let options = &words[..end.unwrap_or(words.len())];
    let at = options.iter().position(|word| {
        word == "--library" || word.as_encoded_bytes().starts_with(b"--library=")
    })?;
    let word = words[at].to_string_lossy().into_owned();
    if let Some(folder) = word.strip_prefix("--library=") {
        words.remove(at);
        return Some(folder.into());
    }
    if at + 1 == words.len() {
        return None;
    }
    words.remove(at);
    Some(words.remove(at).into())
}

/// Replaces the session among the arguments of `paws-calib` by its folder.
fn replace_session(words: &mut [OsString], library: Option<&Path>) -> Result<()> {
    if let Some(at) = session_position(words, &CALIB)
        && let Some(text) = words[at].to_str()
    {
        words[at] = Target::find(text, library)?.folder.clone().into();
    }
    Ok(())
}

/// Replaces the hand-off among the arguments of `paws-reconstruct`, if it is no path, by the folder
/// of the session.
fn replace_handoff(words: &mut [OsString], library: Option<&Path>) -> Result<()> {
    if let Some(at) = session_position(words, &RECONSTRUCT)
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
        words[at] = target.folder.clone().into();
    }
    Ok(())
}

/// Position of the session among the arguments: the first after the verb that is neither an option
/// nor the value of one.
fn session_position(words: &[OsString], of: &SessionVerbs) -> Option<usize> {
    let mut has_verb = false;
    let mut at = 0;
    while let Some(word) = words.get(at) {
        let word = word.to_string_lossy();
        match &*word {
            "--" if has_verb => return (at + 1 < words.len()).then_some(at + 1),
            option if option.starts_with('-') => {
                let has_value = option.starts_with("--")
                    && !option.contains('=')
                    && !of.flags.contains(&option);
                at += if has_value { 2 } else { 1 };
            }
            _ if has_verb => return Some(at),
            verb if of.verbs.contains(&verb) => {
                has_verb = true;
                at += 1;
            }
            _ => return None,
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

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
            ("run --device gpu --cpu-fallback HERE", Some(4)),
            ("frames --from -1.5 --out x HERE", Some(5)),
            ("run --out x -- HERE", Some(4)),
            ("info", None),
            ("run --out x", None),
            ("run --out x --", None),
            ("run --out", None),
            ("evaluate HERE", None),
            ("--version", None),
        ] {
            assert_eq!(
                session_position(&words(text), &RECONSTRUCT),
                expected,
                "{text}"
            );
        }
    }

    #[test]
    fn library_option_of_calib_is_taken_out() {
        for (text, library, rest) in [
            ("cameras --library a latest", Some("a"), "cameras latest"),
            ("--library=a cameras latest", Some("a"), "cameras latest"),
            ("cameras latest --out b", None, "cameras latest --out b"),
            ("cameras -- --library a", None, "cameras -- --library a"),
            ("cameras latest --library", None, "cameras latest --library"),
        ] {
            let mut found = words(text);
            let folder = take_library(&mut found);
            assert_eq!(folder.as_deref(), library.map(Path::new), "{text}");
            assert_eq!(found, words(rest), "{text}");
        }
    }

    #[test]
    fn session_of_calib_is_found() {
        for (text, expected) in [
            ("cameras HERE --keep-model", Some(1)),
            ("cameras --keep-model HERE", Some(2)),
            ("verify --json v.json --force HERE", Some(4)),
            ("convert a.conf --to kalibr", None),
            ("targets --out board.pdf", None),
            ("cameras --help", None),
        ] {
            assert_eq!(session_position(&words(text), &CALIB), expected, "{text}");
        }
    }
}
