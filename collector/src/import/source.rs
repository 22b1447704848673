//! Listing of the files of a session's folder.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use session_archive::layout;

use super::error::{ImportError, failed};
use super::file_record::RECORD;
use crate::derived_files::DERIVED;

/// Maximum depth of nested folders; a session has one level.
const DEPTH: usize = 8;

/// A file of the source, at the start of the import.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SourceFile {
    /// Path below the session's folder, `/` between names.
    pub(super) path: String,
    /// Length.
    pub(super) bytes: u64,
    /// Modification time, ns since 1970.
    pub(super) modified_ns: i64,
}

/// Whether a file was derived by a host, not recorded. Such files are never copied: the library
/// derives its own.
fn is_derived(path: &str) -> bool {
    path == RECORD || DERIVED.contains(&path)
}

/// The files of a session in copy order, the manifest first, so that the verification can begin;
/// and the entries that cannot be copied: names that are not UTF-8, and folders nested too deeply.
///
/// # Errors
/// [`ImportError::NoFile`] for a link, a FIFO, a device or a socket, or an I/O error occurs.
pub(super) fn list_files(source: &Path) -> Result<(Vec<SourceFile>, Vec<String>), ImportError> {
    let (mut files, mut skipped) = (Vec::new(), Vec::new());
    list(source, "", DEPTH, &mut files, &mut skipped)?;
    let rank = |path: &str| (path != layout::MANIFEST, path.starts_with(layout::SEGMENTS));
    files.sort_by(|a, b| (rank(&a.path), &a.path).cmp(&(rank(&b.path), &b.path)));
    skipped.sort();
    Ok((files, skipped))
}

fn list(
    root: &Path,
    below: &str,
    depth: usize,
    files: &mut Vec<SourceFile>,
    skipped: &mut Vec<String>,
) -> Result<(), ImportError> {
    let folder = root.join(below);
    let reading = || failed("reading", &folder);
    for entry in fs::read_dir(&folder).map_err(reading())? {
        let entry = entry.map_err(reading())?;
        let kind = entry.file_type().map_err(reading())?;
        let name = match entry.file_name().into_string() {
            Ok(name) => name,
            Err(name) => {
                skipped.push(format!("{below}{}", name.to_string_lossy()));
                continue;
            }
        };
        let path = format!("{below}{name}");
        if kind.is_dir() && depth > 0 {
            list(root, &format!("{path}/"), depth - 1, files, skipped)?;
        } else if kind.is_file() && !is_derived(&path) {
            let data = entry.metadata().map_err(reading())?;
            files.push(SourceFile {
                path,
                bytes: data.len(),
                modified_ns: modified_ns(&data),
            });
        } else if kind.is_dir() {
            skipped.push(path);
        } else if let Some(found) = plain_file::Kind::of(kind) {
            return Err(ImportError::NoFile {
                found,
                path: entry.path(),
            });
        }
    }
    Ok(())
}

fn modified_ns(data: &fs::Metadata) -> i64 {
    data.mtime()
        .saturating_mul(1_000_000_000)
        .saturating_add(data.mtime_nsec())
}

/// Checks that the source is unchanged since the listing.
pub(super) fn unchanged(source: &Path, files: &[SourceFile]) -> Result<(), ImportError> {
    let (now, _) = list_files(source)?;
    let changed = |what: &str| ImportError::Changed {
        what: what.to_owned(),
        path: source.to_owned(),
    };
    if let Some(new) = now.iter().find(|n| files.iter().all(|f| f.path != n.path)) {
        return Err(changed(&new.path));
    }
    match files.iter().find(|f| !now.contains(f)) {
        Some(file) => Err(changed(&file.path)),
        None => Ok(()),
    }
}

/// Removes files of an earlier import that the source no longer has.
pub(super) fn remove_unknown_files(
    incoming: &Path,
    files: &[SourceFile],
) -> Result<(), ImportError> {
    let (existing, _) = list_files(incoming)?;
    for stranger in existing
        .iter()
        .filter(|t| files.iter().all(|f| f.path != t.path))
    {
        let path = incoming.join(&stranger.path);
        fs::remove_file(&path).map_err(failed(
            "removing a file that is no longer in the source",
            &path,
        ))?;
    }
    Ok(())
}
