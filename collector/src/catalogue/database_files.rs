//! The catalogue's file and the companion files of SQLite, moved and removed together: a log that
//! is left behind would be applied to the next file.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Name suffixes of the files that SQLite keeps beside a database.
const COMPANION_SUFFIXES: [&str; 3] = ["-journal", "-wal", "-shm"];

/// A path with a suffix appended to its name.
pub(super) fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut with = path.as_os_str().to_owned();
    with.push(suffix);
    with.into()
}

/// Renames a damaged catalogue to `catalogue.sqlite.damaged`, or `.damaged-2` and so on; returns
/// the new name, `None` if there was no file.
///
/// # Errors
/// An I/O error occurs.
pub(super) fn set_aside(path: &Path) -> io::Result<Option<PathBuf>> {
    let is_there = |path: &Path| fs::symlink_metadata(path).is_ok();
    let is_taken = |to: &PathBuf| {
        is_there(to)
            || COMPANION_SUFFIXES
                .iter()
                .any(|beside| is_there(&with_suffix(to, beside)))
    };
    let to = (1_u32..)
        .map(|n| match n {
            1 => with_suffix(path, ".damaged"),
            n => with_suffix(path, &format!(".damaged-{n}")),
        })
        .find(|to| !is_taken(to))
        .ok_or(io::ErrorKind::AlreadyExists)?;
    // The logs first: without their database they cannot be applied to another one.
    for beside in COMPANION_SUFFIXES {
        rename(&with_suffix(path, beside), &with_suffix(&to, beside))?;
    }
    Ok(rename(path, &to)?.then_some(to))
}

/// Returns whether the file existed.
fn rename(from: &Path, to: &Path) -> io::Result<bool> {
    match fs::rename(from, to) {
        Ok(()) => Ok(true),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(e) => Err(e),
    }
}

/// Removes an outdated or incomplete catalogue; it can be rebuilt.
///
/// # Errors
/// An I/O error occurs.
pub(super) fn remove(path: &Path) -> io::Result<()> {
    let beside = COMPANION_SUFFIXES
        .iter()
        .map(|beside| with_suffix(path, beside));
    for file in beside.chain([path.to_owned()]) {
        match fs::remove_file(&file) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
    }
    Ok(())
}
