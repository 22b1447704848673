//! Comparison of a session with the library's copy of the same identifier.
//!
//! Contract: the better of two copies of a session is published under its key, in whatever order
//! they are imported, and neither is lost. The order of quality is: damaged; cut off (complete up
//! to the cut); closed after a cut or recovered; complete. A cut off copy with more samples than a
//! recovered one is better than that. If the library's copy is complete, names, lengths and the
//! manifest decide whether the other is the same; if not, every byte is compared, because a flipped
//! bit does not change lengths. The replaced copy is renamed to `ID.damaged`, a separate session
//! that is listed and that `paws prune --session` removes. It is renamed after the other was
//! verified and synced; if stopped between the two renames, the library has `ID.damaged`, and the
//! next import publishes the other.

use std::fmt;
use std::io;
use std::path::Path;
use std::sync::Arc;

use console_output::text;
use session_archive::layout;
use session_archive::manifest::State;
use session_archive::reader::{ReadError, SessionReader};
use session_archive::storage::DiskStorage;
use session_archive::verify::{Report, verify};

use super::error::{ImportError, failed};
use super::hash::hash_file;
use super::publication::sync_published;
use super::record::ImportRecord;
use super::result::ImportResult;
use super::source::SourceFile;
use crate::catalogue::Row;
use crate::condition::Condition;
use crate::folders::rename_new;
use crate::library::Library;
use crate::session_key::{DAMAGED, aside_key};

/// State of a session's key in the library.
pub(crate) enum ExistingCopy {
    /// Nothing.
    Absent,
    /// The same session.
    Same(Box<ImportResult>),
    /// A copy of this quality; the new one is better.
    Worse(CopyQuality),
}

/// Quality of a copy of a session, for comparison with another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CopyQuality {
    /// Its condition.
    pub(crate) condition: Condition,
    /// Readable samples of all numbered streams.
    samples: u64,
}

impl CopyQuality {
    /// Quality of a copy damaged by its disk.
    pub(crate) const DAMAGED: Self = Self {
        condition: Condition::Damaged,
        samples: 0,
    };

    /// Quality from a condition and a verification report.
    pub(crate) fn of(condition: Condition, report: &Report) -> Self {
        let samples = report.streams.values().map(|s| s.samples);
        Self {
            condition,
            samples: samples.fold(0, u64::saturating_add),
        }
    }

    fn is_whole(self) -> bool {
        self.condition == Condition::Ok
    }

    /// Whether this copy replaces the other.
    fn is_better_than(self, other: Self) -> bool {
        match (self.condition, other.condition) {
            // A copy closed after the cut has all samples of the cut off one. One recovered from a
            // damaged one may not.
            (Condition::Recovered, Condition::Unclosed) => self.samples >= other.samples,
            (Condition::Unclosed, Condition::Recovered) => self.samples > other.samples,
            (one, other) => rank(one) > rank(other),
        }
    }
}

impl fmt::Display for CopyQuality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let samples = text::count(self.samples, "sample");
        write!(f, "{} with {samples}", self.condition)
    }
}

/// Rank of a condition; higher is better.
fn rank(condition: Condition) -> u8 {
    match condition {
        Condition::Ok => 3,
        Condition::Recovered => 2,
        Condition::Unclosed => 1,
        Condition::Damaged | Condition::Unverified => 0,
    }
}

/// Finds the library's copy of a session, and compares it.
///
/// # Errors
/// [`ImportError::Differs`] if it differs and is at least as good as the one in `source`; or one of
/// the two cannot be read.
pub(super) fn find_existing(
    library: &Library,
    key: &str,
    source: &Path,
    files: &[SourceFile],
) -> Result<ExistingCopy, ImportError> {
    let folder = library.folder(key);
    if !folder.exists() {
        return Ok(ExistingCopy::Absent);
    }
    let worth = quality_in_library(library, key);
    let record = ImportRecord::read(&folder);
    let difference = match (&record, worth.is_whole()) {
        (Some(record), true) => difference(record, source, files)?,
        _ => difference_in_content(&folder, source, files)?,
    };
    match difference {
        None => same(key, &folder, record).map(|existing| ExistingCopy::Same(Box::new(existing))),
        // A complete copy is never replaced.
        Some(what) if worth.is_whole() => Err(differs(key, what, source)),
        Some(what) => {
            let (state, report) = read(source).map_err(|error| ImportError::Unreadable {
                source: error,
                path: source.to_owned(),
            })?;
            let comes = CopyQuality::of(Condition::of(state, &report), &report);
            if comes.is_better_than(worth) {
                Ok(ExistingCopy::Worse(worth))
            } else {
                Err(differs(key, what, source))
            }
        }
    }
}

/// Renames the library's copy before a better one, verified and synced, is published; returns its
/// new key. `old` is the quality of the library's copy, `new` of the other.
///
/// # Errors
/// [`ImportError::Differs`] if the other is not better, or an I/O error occurs.
pub(crate) fn set_aside_copy(
    library: &mut Library,
    key: &str,
    source: &Path,
    old: CopyQuality,
    new: CopyQuality,
) -> Result<String, ImportError> {
    if !new.is_better_than(old) {
        let what = format!("it is {new}, there it is {old}");
        return Err(differs(key, what, source));
    }
    let free = (1_u32..)
        .map(|n| match n {
            1 => aside_key(key, DAMAGED),
            n => aside_key(key, &format!("{DAMAGED}-{n}")),
        })
        .find(|key| !library.folder(key).exists());
    let aside = free.unwrap_or_default();
    // If stopped before the new copy is listed, this row would be mistaken for that of the new one.
    // Opening the library lists it again.
    library.forget(key).map_err(|e| ImportError::Catalogue {
        key: key.to_owned(),
        reason: format!("{e:#}"),
    })?;
    let (from, to) = (library.folder(key), library.folder(&aside));
    rename_new(&from, &to).map_err(failed("setting the damaged session aside", &from))?;
    sync_published(library, key)?;
    Ok(aside)
}

/// Quality of the library's copy, by the last verification; verifies it now if there is none.
pub(crate) fn quality_in_library(library: &Library, key: &str) -> CopyQuality {
    let folder = library.folder(key);
    match Row::of(key, &folder) {
        Ok(row) if row.condition == Condition::Unverified => read(&folder)
            .map_or(CopyQuality::DAMAGED, |(state, report)| {
                CopyQuality::of(Condition::of(state, &report), &report)
            }),
        Ok(row) => CopyQuality {
            condition: row.condition,
            samples: row.samples,
        },
        // It cannot even be opened.
        Err(_) => CopyQuality::DAMAGED,
    }
}

fn differs(key: &str, what: String, source: &Path) -> ImportError {
    ImportError::Differs {
        key: key.to_owned(),
        what,
        path: source.to_owned(),
    }
}

fn read(folder: &Path) -> Result<(State, Report), ReadError> {
    let reader = SessionReader::open(Arc::new(DiskStorage::new(folder)))?;
    let report = verify(&reader, |_| {})?;
    Ok((reader.manifest().state, report))
}

/// The library's copy, as the result of an import.
fn same(
    key: &str,
    folder: &Path,
    record: Option<ImportRecord>,
) -> Result<ImportResult, ImportError> {
    let unreadable = |source| ImportError::Unreadable {
        source,
        path: folder.to_owned(),
    };
    let (state, report) = match record {
        Some(record) => {
            let reader = SessionReader::open(Arc::new(DiskStorage::new(folder)));
            let state = reader.map(|reader| reader.manifest().state);
            (state.map_err(unreadable)?, record.report)
        }
        None => read(folder).map_err(unreadable)?,
    };
    Ok(ImportResult {
        key: key.to_owned(),
        condition: Condition::of(state, &report),
        report,
        copied: 0,
        resumed: 0,
        already_imported: true,
        skipped: Vec::new(),
        replaced: None,
    })
}

/// The first difference by names, lengths and the manifest.
fn difference(
    record: &ImportRecord,
    source: &Path,
    files: &[SourceFile],
) -> Result<Option<String>, ImportError> {
    for file in files {
        match record.files.iter().find(|f| f.path == file.path) {
            None => return Ok(Some(format!("{} is not in the library", file.path))),
            Some(known) if known.bytes != file.bytes => {
                return Ok(Some(format!(
                    "{} has {} bytes, in the library {}",
                    file.path, file.bytes, known.bytes
                )));
            }
            Some(_) => {}
        }
    }
    let is_missing = |path: &str| files.iter().all(|f| f.path != path);
    if let Some(extra) = record.files.iter().find(|known| is_missing(&known.path)) {
        return Ok(Some(format!("{} is only in the library", extra.path)));
    }
    // All lengths are equal: the manifest decides whether it is the same recording.
    let manifest = source.join(layout::MANIFEST);
    if let Some(known) = record.files.iter().find(|f| f.path == layout::MANIFEST) {
        let (_, hash) = hash_file(&manifest).map_err(failed("reading", &manifest))?;
        if hash != known.blake3 {
            return Ok(Some(format!("{} has another content", known.path)));
        }
    }
    Ok(None)
}

/// The first difference between the files of the source and the current files in the library.
fn difference_in_content(
    folder: &Path,
    source: &Path,
    files: &[SourceFile],
) -> Result<Option<String>, ImportError> {
    let (existing, _) = super::source::list_files(folder)?;
    let is_missing = |path: &str| files.iter().all(|f| f.path != path);
    if let Some(extra) = existing.iter().find(|known| is_missing(&known.path)) {
        return Ok(Some(format!("{} is only in the library", extra.path)));
    }
    for file in files {
        let path = source.join(&file.path);
        let comes = hash_file(&path).map_err(failed("reading", &path))?;
        let path = folder.join(&file.path);
        match hash_file(&path) {
            Ok(existing) if existing == comes => {}
            Ok(_) => return Ok(Some(format!("{} has another content", file.path))),
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                return Ok(Some(format!("{} is not in the library", file.path)));
            }
            // A file that can no longer be read is a difference, too.
            Err(e) => return Ok(Some(format!("{} cannot be read: {e}", file.path))),
        }
    }
    Ok(None)
}
