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

mod copy;
pub(crate) mod existing;
mod growing_copy;
mod journal;
pub(crate) mod publish;
mod recheck;
mod record;
mod source;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;

use console_output::{Clock, Progress};
use rustix::fs::{RenameFlags, renameat_with, statvfs};
use session_access::{INCOMING, SESSIONS};
use session_archive::reader::{ReadError, SessionReader};
use session_archive::storage::DiskStorage;
use session_archive::time::CivilTime;
use session_archive::verify::{Report, verify};

pub use self::record::{FileRecord, ImportRecord};

use self::copy::{CopyResult, copy_all};
use self::existing::{CopyQuality, ExistingCopy};
use self::growing_copy::{CopyProgress, GrowingCopy};
use self::journal::Journal;
use self::source::{SourceFile, list_files};
use crate::condition::Condition;
use crate::library::{Library, is_key, sync_folder};

/// Free space to leave on the library's disk, bytes.
const RESERVED_BYTES: u64 = 64 << 20;

/// Steps of an import. Tests stop it at each of them in turn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// The folder under `.incoming/` is about to be made.
    Begin,
    /// A block of a file is about to be written.
    Write(String),
    /// A file is about to be synced.
    Sync(String),
    /// A file is about to be recorded in the journal.
    Note(String),
    /// The folders are about to be synced.
    SyncFolders,
    /// The import record is about to be written.
    Record,
    /// The folder is about to be renamed into the library.
    Publish,
    /// The rename is about to be made durable.
    SyncPublished,
    /// The session is about to be put into the catalogue.
    List,
}

/// Callback before each step; an error stops the import as if it had been killed.
pub type Hook<'a> = &'a (dyn Fn(&Step) -> io::Result<()> + Sync);

/// The hook without effect.
pub fn no_hook(_: &Step) -> io::Result<()> {
    Ok(())
}

/// Result of an import: a session in the library.
#[derive(Clone, Debug)]
pub struct ImportResult {
    /// Its key in the library.
    pub key: String,
    /// Condition of the session.
    pub condition: Condition,
    /// Verification report.
    pub report: Report,
    /// Bytes copied by this import; 0 if the session was in the library already.
    pub copied: u64,
    /// Bytes that an earlier, interrupted import had copied.
    pub resumed: u64,
    /// Whether it was in the library before.
    pub already_imported: bool,
    /// Entries of the source that were not copied: names that are not UTF-8, folders nested too
    /// deeply.
    pub skipped: Vec<String>,
    /// Key of the damaged or cut off session that it replaced.
    pub replaced: Option<String>,
}

/// A session was not imported. Source and library are unchanged, except for `.incoming/`.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// It cannot be read as a session, or was written by a newer version.
    #[error("importing a session: {}", .path.display())]
    Unreadable {
        /// Why.
        #[source]
        source: ReadError,
        /// The source.
        path: PathBuf,
    },
    /// The identifier is not a safe folder name: the manifest is not from this recorder.
    #[error("its identifier {id:?} cannot be the name of a folder: {}", .path.display())]
    Identifier {
        /// The identifier.
        id: String,
        /// The source.
        path: PathBuf,
    },
    /// The session is not the announced one: check the announcement.
    #[error("found session {found}, expected {expected}: {}", .path.display())]
    Another {
        /// Its identifier.
        found: String,
        /// The announced identifier.
        expected: String,
        /// Its folder.
        path: PathBuf,
    },
    /// An entry of the source is not a file. Remove it, or replace it by the file.
    #[error("importing a session: found {found}, expected only files and folders: {}", .path.display())]
    NoFile {
        /// What it is.
        found: plain_file::Kind,
        /// It.
        path: PathBuf,
    },
    /// The library has a session with this identifier and other content. To replace it, remove it
    /// first: `paws prune --session ID --yes`.
    #[error("session {key} is in the library already and differs ({what}); nothing was changed: {}", .path.display())]
    Differs {
        /// Its key.
        key: String,
        /// The first difference.
        what: String,
        /// The source.
        path: PathBuf,
    },
    /// The source changed during the copy, so it is still being recorded: import it again later.
    #[error("{what} changed while it was copied; is it still being recorded? {}", .path.display())]
    Changed {
        /// What changed.
        what: String,
        /// The source.
        path: PathBuf,
    },
    /// Free the disk, then import again.
    #[error("copying takes {needed} bytes and {free} are free: {}", .path.display())]
    NoSpace {
        /// Bytes still to be copied plus the reserve.
        needed: u64,
        /// Bytes free.
        free: u64,
        /// The library.
        path: PathBuf,
    },
    /// An I/O error of the source or of the library.
    #[error("{doing}: {}", .path.display())]
    Io {
        /// What was being done.
        doing: &'static str,
        /// What failed.
        #[source]
        source: io::Error,
        /// The file or folder.
        path: PathBuf,
    },
    /// The catalogue could not be updated. The session is in the library; opening the library lists
    /// it.
    #[error("listing session {key}: {reason}")]
    Catalogue {
        /// Its key.
        key: String,
        /// Why.
        reason: String,
    },
}

fn failed<'a>(doing: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> ImportError + 'a {
    move |source| ImportError::Io {
        doing,
        source,
        path: path.to_owned(),
    }
}

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
            journal::remove(&library.incoming(&key))?;
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
    publish(library, &key, hook)?;
    journal::remove(&incoming)?;
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

/// Updates the catalogue with a new session of the library, and with the one that it replaced.
pub(crate) fn list(
    library: &mut Library,
    key: &str,
    replaced: Option<&str>,
) -> Result<(), ImportError> {
    for key in [Some(key), replaced].into_iter().flatten() {
        library.refresh(key).map_err(|e| ImportError::Catalogue {
            key: key.to_owned(),
            reason: format!("{e:#}"),
        })?;
    }
    Ok(())
}

/// Syncs a finished folder under `.incoming/` and publishes it as a session of the library.
///
/// # Errors
/// See [`ImportError`]; the folder is then where it was.
pub(crate) fn publish_folder(library: &Library, key: &str) -> Result<(), ImportError> {
    let incoming = library.incoming(key);
    sync_tree(&incoming).map_err(failed("syncing", &incoming))?;
    publish(library, key, &no_hook)
}

/// Renames a finished folder from `.incoming/` to `sessions/`, and syncs the rename.
fn publish(library: &Library, key: &str, hook: Hook<'_>) -> Result<(), ImportError> {
    let (from, to) = (library.incoming(key), library.folder(key));
    hook(&Step::Publish).map_err(failed("publishing", &to))?;
    rename_new(&from, &to).map_err(failed("publishing", &to))?;
    hook(&Step::SyncPublished).map_err(failed("publishing", &to))?;
    sync_published(library, key)
}

/// Syncs the rename into the library.
fn sync_published(library: &Library, key: &str) -> Result<(), ImportError> {
    for folder in [SESSIONS, INCOMING] {
        sync_folder(&library.root().join(folder))
            .map_err(failed("publishing", &library.folder(key)))?;
    }
    Ok(())
}

/// Renames a folder to a name that must not exist.
pub(crate) fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    let cwd = rustix::fs::CWD;
    match renameat_with(cwd, from, cwd, to, RenameFlags::NOREPLACE) {
        Ok(()) => Ok(()),
        // Some file systems do not support this flag; a folder is never renamed over a non-empty
        // one.
        Err(rustix::io::Errno::INVAL | rustix::io::Errno::NOSYS) if !to.exists() => {
            fs::rename(from, to)
        }
        Err(e) => Err(e.into()),
    }
}

/// Syncs a folder and all folders below it.
fn sync_tree(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_tree(&entry.path())?;
        }
    }
    sync_folder(folder)
}

/// Checks that `bytes` more fit onto the disk of `path`.
pub(crate) fn check_space(path: &Path, bytes: u64) -> Result<(), ImportError> {
    let disk = statvfs(path)
        .map_err(io::Error::from)
        .map_err(failed("asking for free space", path))?;
    let (needed, free) = (
        bytes.saturating_add(RESERVED_BYTES),
        disk.f_bavail.saturating_mul(disk.f_frsize),
    );
    if needed > free {
        return Err(ImportError::NoSpace {
            needed,
            free,
            path: path.to_owned(),
        });
    }
    Ok(())
}
