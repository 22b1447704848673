//! Importing one session into a library.
//!
//! * **Normally**: every file is copied to `.incoming/ID/` and hashed meanwhile; the copy is
//!   synced, verified with [`session_archive::verify`] while it grows, given its [`ImportRecord`],
//!   and appears under `sessions/ID` by one rename.
//! * **Stopped at any point**, by a signal, a power cut or an error: the content of `.incoming/`
//!   remains and is not listed. The next import resumes: a file that is in the journal, unchanged
//!   in the source and still has its hash is reused; every other one is copied again (at most one
//!   segment is copied twice). If the session is incomplete, the reused files are compared with the
//!   source (see `recheck`).
//! * **Repeated**: a session that is in the library with the same files is left unchanged. One that
//!   differs is rejected, unless the library's copy is damaged or cut off and this one is better
//!   (see `existing`): then it replaces that copy, which is renamed to `ID.damaged`. A worse copy
//!   never replaces a better one.
//! * **Damaged**: imported nevertheless, byte for byte, with its report.
//! * **No files**: a FIFO, a device, a socket or a link in a session's folder is rejected
//!   immediately.
//! * **Changed while it was copied**, because it is still being recorded: rejected before it is
//!   listed; a later import resumes.
//!
//! Nothing is ever written to the source.

mod cleanup;
mod copy;
mod error;
pub(crate) mod existing;
mod file_record;
mod growing_copy;
mod hash;
mod journal;
mod publication;
pub(crate) mod publish;
mod recheck;
mod record;
mod result;
mod source;
mod space;
mod step;

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::thread;

use console_output::{Clock, Progress};
use session_archive::reader::SessionReader;
use session_archive::storage::DiskStorage;
use session_archive::time::CivilTime;
use session_archive::verify::{Report, verify};

pub use self::error::ImportError;
pub use self::file_record::FileRecord;
pub(crate) use self::publication::publish_folder;
pub use self::record::ImportRecord;
pub use self::result::ImportResult;
pub(crate) use self::space::check_space;
pub use self::step::{Hook, Step, no_hook};

use self::cleanup::remove_remains;
use self::copy::{CopyResult, copy_all};
use self::error::failed;
use self::existing::{CopyQuality, ExistingCopy};
use self::growing_copy::{CopyProgress, GrowingCopy};
use self::journal::Journal;
use self::publication::{list, publish_incoming, sync_published};
use self::source::{SourceFile, list_files};
use crate::condition::Condition;
use crate::folders::sync_tree;
use crate::library::Library;
use crate::session_key::is_key;

/// Bytes of the files that importing a session would copy, for a progress bar.
///
/// # Errors
/// The source cannot be read.
pub fn size(source: &Path) -> Result<u64, ImportError> {
    let (files, _) = list_files(source)?;
    Ok(files.iter().map(|f| f.bytes).sum())
}

/// Imports the session in the folder `source`. `progress` counts every finished byte, copied now or
/// earlier. The caller holds the library's lock.
///
/// # Errors
/// See [`ImportError`].
pub fn import(
    library: &mut Library,
    source: &Path,
    clock: Clock,
    progress: &Progress,
    hook: Hook<'_>,
) -> Result<ImportResult, ImportError> {
    let unreadable = |error| ImportError::Unreadable {
        source: error,
        path: source.to_owned(),
    };
    let reader = SessionReader::open(Arc::new(DiskStorage::new(source))).map_err(unreadable)?;
    let key = reader.manifest().session_id.clone();
    drop(reader);
    if !is_key(&key) {
        return Err(ImportError::Identifier {
            id: key,
            path: source.to_owned(),
        });
    }
    let (files, skipped) = list_files(source)?;
    let old = match existing::find_existing(library, &key, source, &files)? {
        ExistingCopy::Absent => None,
        ExistingCopy::Same(imported) => {
            progress.add(files.iter().map(|f| f.bytes).sum());
            // Remains of an import that was stopped just after its rename, which may not be
            // durable.
            sync_published(library, &key)?;
            remove_remains(&library.incoming(&key))?;
            return Ok(*imported);
        }
        ExistingCopy::Worse(old) => Some(old),
    };

    let mut copy = copy_and_check(library, &key, source, &files, progress, hook)?;
    if copy.condition.needs_recovery() && copy.resumed > 0 {
        // Files of an earlier import may be from another, damaged copy of the session.
        let renewed = recheck::refresh_reused(&library.incoming(&key), source, &copy.kept, hook)?;
        if renewed > 0 {
            let (bytes, resumed) = (copy.bytes + renewed, copy.resumed - renewed);
            let hidden = Progress::hidden();
            copy = copy_and_check(library, &key, source, &files, &hidden, hook)?;
            (copy.bytes, copy.resumed) = (copy.bytes + bytes, resumed);
        }
    }

    let incoming = library.incoming(&key);
    let record = ImportRecord::new(
        &key,
        source,
        CivilTime((clock.civil_ns)()),
        copy.records,
        copy.report.clone(),
    );
    hook(&Step::Record).map_err(failed("writing the import record", &incoming))?;
    record
        .write(&incoming)
        .map_err(failed("writing the import record", &incoming))?;
    let replaced = match old {
        Some(old) => {
            let new = CopyQuality::of(copy.condition, &copy.report);
            Some(existing::set_aside_copy(library, &key, source, old, new)?)
        }
        None => None,
    };
    publish_incoming(library, &key, hook)?;
    remove_remains(&incoming)?;
    hook(&Step::List).map_err(failed("listing", &incoming))?;
    list(library, &key, replaced.as_deref())?;
    Ok(ImportResult {
        key,
        condition: copy.condition,
        report: copy.report,
        copied: copy.bytes,
        resumed: copy.resumed,
        already_imported: false,
        skipped,
        replaced,
    })
}

/// A session in `.incoming/`, verified and synced.
struct VerifiedCopy {
    condition: Condition,
    report: Report,
    records: Vec<FileRecord>,
    /// Bytes copied.
    bytes: u64,
    /// Bytes that an earlier import had copied.
    resumed: u64,
    /// The files with these bytes.
    kept: Vec<FileRecord>,
}

/// Copies what an earlier import has not copied, verifies the session meanwhile, and syncs it.
fn copy_and_check(
    library: &Library,
    key: &str,
    source: &Path,
    files: &[SourceFile],
    progress: &Progress,
    hook: Hook<'_>,
) -> Result<VerifiedCopy, ImportError> {
    let unreadable = |error| ImportError::Unreadable {
        source: error,
        path: source.to_owned(),
    };
    let incoming = library.incoming(key);
    hook(&Step::Begin).map_err(failed("beginning", &incoming))?;
    fs::create_dir_all(&incoming).map_err(failed("making the folder", &incoming))?;
    source::remove_unknown_files(&incoming, files)?;
    let mut journal = Journal::open(&incoming)?;
    let kept = journal.still_good(&incoming, files, progress)?;
    let to_copy: u64 =
        files.iter().map(|f| f.bytes).sum::<u64>() - kept.iter().map(|k| k.bytes).sum::<u64>();
    check_space(library.root(), to_copy)?;

    let copy_progress = CopyProgress::new(files, &kept);
    let follow = GrowingCopy::new(&incoming, &copy_progress);
    // The verification follows a few megabytes behind the copy and reads from the page cache.
    let (copied, report) = thread::scope(|scope| {
        let check = scope.spawn(|| {
            let reader = SessionReader::open(Arc::new(follow))?;
            verify(&reader, |_| {}).map(|report| (reader.manifest().state, report))
        });
        let copied = copy_all(
            source,
            &incoming,
            files,
            &kept,
            &mut journal,
            &copy_progress,
            progress,
            hook,
        );
        // Wake readers that still wait for bytes.
        copy_progress.close();
        (copied, check.join())
    });
    let CopyResult { bytes, records } = copied?;
    let (state, report) = match report {
        Ok(checked) => checked.map_err(unreadable)?,
        Err(panic) => std::panic::resume_unwind(panic),
    };

    source::unchanged(source, files)?;
    hook(&Step::SyncFolders).map_err(failed("syncing", &incoming))?;
    sync_tree(&incoming).map_err(failed("syncing", &incoming))?;
    Ok(VerifiedCopy {
        condition: Condition::of(state, &report),
        report,
        records,
        bytes,
        resumed: kept.iter().map(|k| k.bytes).sum(),
        kept,
    })
}
