//! Comparison of the files of an earlier import with the source.
//!
//! Used if a session that was copied by several imports is incomplete: the earlier files may be
//! from another, damaged copy. Each reused file is compared with the source's by hash. A differing
//! one is copied beside the folder (`.incoming/.again.ID/`) and replaces the old one by a rename,
//! so that nothing is removed before its replacement is on disk. One that the source's disk can no
//! longer read is left as it was read before.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use console_output::Progress;

use super::copy::copy_all;
use super::error::{ImportError, failed};
use super::file_record::FileRecord;
use super::growing_copy::CopyProgress;
use super::hash::hash_file;
use super::journal::Journal;
use super::source::SourceFile;
use super::space::check_space;
use super::step::Hook;

/// Copies those reused files again that differ from the source; returns their bytes.
pub(super) fn refresh_reused(
    incoming: &Path,
    source: &Path,
    kept: &[FileRecord],
    hook: Hook<'_>,
) -> Result<u64, ImportError> {
    let mut renewed = 0;
    for record in kept {
        let is_renewed = match hash_file(&source.join(&record.path)) {
            Ok((_, hash)) => hash != record.blake3 && replace(incoming, source, record, hook)?,
            Err(error) => {
                warn_unreadable(source, record, &error);
                false
            }
        };
        if is_renewed {
            renewed += record.bytes;
        }
    }
    clear(incoming)?;
    Ok(renewed)
}

/// Replaces a file by the source's; false if the source cannot be read.
fn replace(
    incoming: &Path,
    source: &Path,
    record: &FileRecord,
    hook: Hook<'_>,
) -> Result<bool, ImportError> {
    check_space(incoming, record.bytes)?;
    let files = [SourceFile {
        path: record.path.clone(),
        bytes: record.bytes,
        modified_ns: record.modified_ns,
    }];
    let folder = staging_folder(incoming);
    // Recorded before the rename: if stopped between the two, the old file no longer has its hash
    // and is copied again.
    let mut journal = Journal::open(incoming)?;
    let copied = copy_all(
        source,
        &folder,
        &files,
        &[],
        &mut journal,
        &CopyProgress::new(&files, &[]),
        &Progress::hidden(),
        hook,
    );
    match copied {
        Err(ImportError::Io {
            doing: "reading",
            source: error,
            ..
        }) => {
            warn_unreadable(source, record, &error);
            return Ok(false);
        }
        other => other?,
    };
    let to = incoming.join(&record.path);
    fs::rename(folder.join(&record.path), &to).map_err(failed("replacing", &to))?;
    Ok(true)
}

fn warn_unreadable(source: &Path, record: &FileRecord, error: &io::Error) {
    log::warn!(
        "keeping the copy of an earlier import, because the source cannot be read again ({error}): {}",
        source.join(&record.path).display()
    );
}

/// Removes files that were copied beside the folder `incoming` and not moved into it.
pub(super) fn clear(incoming: &Path) -> Result<(), ImportError> {
    let folder = staging_folder(incoming);
    match fs::remove_dir_all(&folder) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(failed("clearing", &folder)(e)),
        _ => Ok(()),
    }
}

/// No key begins with a dot, so this cannot be another session's folder.
fn staging_folder(incoming: &Path) -> PathBuf {
    let mut name = std::ffi::OsString::from(".again.");
    name.push(incoming.file_name().unwrap_or_default());
    incoming.with_file_name(name)
}
