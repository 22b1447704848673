//! `paws prune`: removes files that can be derived again.
//!
//! Without options it removes derived files (indexes, validations, hand-offs, reports) and the
//! remains of stopped imports; an unreadable folder is reported and left unchanged. A recording is
//! removed only with its whole identifier and `--yes`; it disappears from the library by one rename
//! before its bytes are deleted.
//!
//! It works on a full disk: nothing is written before something was removed, and if the catalogue
//! cannot be updated, it is rebuilt later.

use std::fs;
use std::io;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use console_output::{Console, Outcome, text};
use session_access::{INCOMING, SESSIONS};

use crate::derived_files::DERIVED;
use crate::folders::{rename_new, sync_folder};
use crate::library::Library;

/// Removes derived files and remains of stopped imports from the library in the folder `root`.
///
/// # Errors
/// Another program is changing the library, or an I/O error occurs.
pub fn derived(root: &Path, console: &mut Console<'_>) -> Result<Outcome> {
    let mut library = Library::open(root)?;
    let _lock = library.lock()?;
    let (mut files, mut bytes) = (0, 0);
    for key in library.keys()? {
        for name in DERIVED {
            let path = library.folder(&key).join(name);
            let length = fs::metadata(&path).map_or(0, |data| data.len());
            match fs::remove_file(&path) {
                Ok(()) => (files, bytes) = (files + 1, bytes + length),
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => {
                    return Err(e).with_context(|| format!("removing {}", path.display()));
                }
            }
        }
        if let Err(e) = library.refresh(&key) {
            log::warn!("not listed: {e:#}");
        }
    }
    let incoming = library.root().join(INCOMING);
    let clearing = || format!("clearing {}", incoming.display());
    let mut left_over = 0;
    for entry in fs::read_dir(&incoming).with_context(clearing)? {
        let path = entry.with_context(clearing)?.path();
        bytes += size(&path);
        left_over += 1;
        if path.is_dir() {
            fs::remove_dir_all(&path)
        } else {
            fs::remove_file(&path)
        }
        .with_context(|| format!("removing {}", path.display()))?;
    }
    console.line(format!(
        "removed {} and {} of stopped imports, {}",
        text::count(files, "derived file"),
        text::count(left_over, "left-over"),
        text::bytes(bytes)
    ))?;
    Ok(Outcome::Fine)
}

/// Removes a session including its recording. Without `sure` it only reports what would be removed.
///
/// # Errors
/// `sure` is false, the session does not exist, or an I/O error occurs.
pub fn session(root: &Path, text: &str, sure: bool, console: &mut Console<'_>) -> Result<Outcome> {
    let mut library = Library::open(root)?;
    let _lock = library.lock()?;
    let key = library.find(text)?;
    ensure!(
        key == text,
        "removing a session needs its whole identifier, {key}: {}",
        library.folder(&key).display()
    );
    let folder = library.folder(&key);
    let bytes = text::bytes(size(&folder));
    if !sure {
        bail!(
            "this would remove the recording {key} itself, {bytes}; repeat it with --yes to do so: {}",
            folder.display()
        );
    }
    let away = library.incoming(&format!("{key}.removed"));
    let context = || format!("removing {}", folder.display());
    if away.exists() {
        fs::remove_dir_all(&away).with_context(context)?;
    }
    rename_new(&folder, &away).with_context(context)?;
    sync_folder(&library.root().join(SESSIONS)).with_context(context)?;
    // Bytes first: on a full disk the catalogue needs the space.
    fs::remove_dir_all(&away).with_context(context)?;
    library.forget(&key)?;
    console.line(format!("{key}: removed, {bytes}"))?;
    Ok(Outcome::Fine)
}

/// Bytes of a file, or of all files in a folder; unreadable files count as 0.
fn size(path: &Path) -> u64 {
    match fs::symlink_metadata(path) {
        Ok(data) if data.is_dir() => fs::read_dir(path)
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| size(&entry.path()))
            .sum(),
        Ok(data) => data.len(),
        Err(_) => 0,
    }
}
