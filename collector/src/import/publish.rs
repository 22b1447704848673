//! Publishing a session whose files were brought into `.incoming/ID/` by something else than
//! [`super::import`].
//!
//! The caller has compared each file with its hash and synced it. Here the session is verified,
//! gets its [`ImportRecord`] and is published by one rename, as after an import; stopped before
//! that, it is not listed.

use std::path::Path;
use std::sync::Arc;

use console_output::{Clock, Progress};
use session_archive::reader::{ReadError, SessionReader};
use session_archive::storage::DiskStorage;
use session_archive::time::CivilTime;
use session_archive::verify::verify;

use super::cleanup::remove_remains;
use super::error::{ImportError, failed};
use super::existing::{CopyQuality, set_aside_copy};
use super::file_record::FileRecord;
use super::hash::hash_file;
use super::publication::{list, publish_incoming, sync_published};
use super::record::ImportRecord;
use super::result::ImportResult;
use super::source::{SourceFile, list_files, remove_unknown_files};
use super::space::check_space;
use super::step::no_hook;
use crate::condition::Condition;
use crate::folders::sync_tree;
use crate::library::Library;

/// A session in `.incoming/`, verified and synced.
pub(crate) struct VerifiedSession {
    imported: ImportResult,
}

/// Creates the folder, removes files from it that the session does not have, and checks the free
/// space for the rest.
pub(crate) fn prepare(incoming: &Path, files: &[FileRecord]) -> Result<(), ImportError> {
    std::fs::create_dir_all(incoming).map_err(failed("making the folder", incoming))?;
    let files: Vec<SourceFile> = files
        .iter()
        .map(|f| SourceFile {
            path: f.path.clone(),
            bytes: f.bytes,
            modified_ns: f.modified_ns,
        })
        .collect();
    remove_unknown_files(incoming, &files)?;
    let (existing, _) = list_files(incoming)?;
    let all: u64 = files.iter().map(|f| f.bytes).sum();
    let existing: u64 = existing.iter().map(|f| f.bytes).sum();
    check_space(incoming, all.saturating_sub(existing))
}

/// Verifies a complete session, and writes its record. `source` is its origin, as text.
pub(crate) fn check(
    incoming: &Path,
    key: &str,
    source: &Path,
    clock: Clock,
    files: Vec<FileRecord>,
) -> Result<VerifiedSession, ImportError> {
    let (state, report) = scan_session(incoming, key)?;
    sync_tree(incoming).map_err(failed("syncing", incoming))?;
    let record = ImportRecord::new(
        key,
        source,
        CivilTime((clock.civil_ns)()),
        files,
        report.clone(),
    );
    record
        .write(incoming)
        .map_err(failed("writing the import record", incoming))?;
    Ok(VerifiedSession {
        imported: ImportResult {
            key: key.to_owned(),
            condition: Condition::of(state, &report),
            report,
            copied: 0,
            resumed: 0,
            already_imported: false,
            skipped: Vec::new(),
            replaced: None,
        },
    })
}

fn scan_session(
    folder: &Path,
    key: &str,
) -> Result<
    (
        session_archive::manifest::State,
        session_archive::verify::Report,
    ),
    ImportError,
> {
    let unreadable = |source: ReadError| ImportError::Unreadable {
        source,
        path: folder.to_owned(),
    };
    let reader = SessionReader::open(Arc::new(DiskStorage::new(folder))).map_err(unreadable)?;
    let manifest = reader.manifest();
    if manifest.session_id != key {
        return Err(ImportError::Another {
            found: manifest.session_id.clone(),
            expected: key.to_owned(),
            path: folder.to_owned(),
        });
    }
    let report = verify(&reader, |_| {}).map_err(unreadable)?;
    Ok((manifest.state, report))
}

/// Publishes it in the library. `old` is the quality of the library's copy, if there is one: a
/// better one replaces it, see [`super::existing`]. The caller holds the library's lock.
pub(crate) fn publish(
    library: &mut Library,
    checked: VerifiedSession,
    source: &Path,
    old: Option<CopyQuality>,
) -> Result<ImportResult, ImportError> {
    let mut imported = checked.imported;
    let key = imported.key.clone();
    if let Some(old) = old {
        let new = CopyQuality::of(imported.condition, &imported.report);
        let is_set_aside_copy = set_aside_copy(library, &key, source, old, new);
        if let Err(ImportError::Differs { .. }) = &is_set_aside_copy {
            // The download was unnecessary.
            let incoming = library.incoming(&key);
            std::fs::remove_dir_all(&incoming).map_err(failed("clearing", &incoming))?;
        }
        imported.replaced = Some(is_set_aside_copy?);
    }
    publish_incoming(library, &key, &no_hook)?;
    remove_remains(&library.incoming(&key))?;
    list(library, &key, imported.replaced.as_deref())?;
    Ok(imported)
}

/// Result of importing a session that is in the library already.
pub(crate) fn already_imported(
    library: &Library,
    key: &str,
    record: ImportRecord,
) -> Result<ImportResult, ImportError> {
    // The publishing program may have been stopped just after the rename.
    sync_published(library, key)?;
    remove_remains(&library.incoming(key))?;
    let folder = &library.folder(key);
    let reader = SessionReader::open(Arc::new(DiskStorage::new(folder)));
    let state = reader.map(|reader| reader.manifest().state);
    let state = state.map_err(|source| ImportError::Unreadable {
        source,
        path: folder.to_owned(),
    })?;
    Ok(ImportResult {
        key: key.to_owned(),
        condition: Condition::of(state, &record.report),
        report: record.report,
        copied: 0,
        resumed: 0,
        already_imported: true,
        skipped: Vec::new(),
        replaced: None,
    })
}

/// Verifies by hash that the library still has these files.
pub(crate) fn verify_files(
    folder: &Path,
    files: &[FileRecord],
    progress: &Progress,
) -> Result<(), ImportError> {
    for file in files {
        let path = folder.join(&file.path);
        let (bytes, hash) = match hash_file(&path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => (0, String::new()),
            other => other.map_err(failed("reading", &path))?,
        };
        if (bytes, &hash) != (file.bytes, &file.blake3) {
            return Err(ImportError::Changed {
                what: file.path.clone(),
                path: folder.to_owned(),
            });
        }
        progress.add(bytes);
    }
    Ok(())
}
