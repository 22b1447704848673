//! `import.json`: origin, files and condition of an imported session.

use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};
use session_archive::storage::{self, DiskStorage};
use session_archive::time::CivilTime;
use session_archive::verify::Report;

use super::error::{ImportError, failed};
use super::file_record::{FileRecord, RECORD};
use super::hash::hash_file;
use super::source::list_files;

const FORMAT: &str = "paws-import";
const VERSION: u32 = 1;

/// Record of an import.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImportRecord {
    format: String,
    version: u32,
    /// Software that imported it.
    pub software: String,
    /// The session.
    pub session_id: String,
    /// The folder that it was copied from.
    pub source: String,
    /// Time of the import.
    pub imported: CivilTime,
    /// The copied files.
    pub files: Vec<FileRecord>,
    /// Verification report of the copy.
    pub report: Report,
}

impl ImportRecord {
    /// A record of a finished import.
    pub fn new(
        session_id: &str,
        source: &Path,
        imported: CivilTime,
        files: Vec<FileRecord>,
        report: Report,
    ) -> Self {
        let source = source.canonicalize().unwrap_or_else(|_| source.to_owned());
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            software: crate::SOFTWARE.to_owned(),
            session_id: session_id.to_owned(),
            source: source.display().to_string(),
            imported,
            files,
            report,
        }
    }

    /// A record of a session in `folder` that was derived from the one in `source`; hashes the
    /// files.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(crate) fn of_folder(
        session_id: &str,
        folder: &Path,
        source: &Path,
        imported: CivilTime,
        report: Report,
    ) -> Result<Self, ImportError> {
        let (files, _) = list_files(folder)?;
        let records = files.into_iter().map(|file| {
            let path = folder.join(&file.path);
            let (bytes, blake3) = hash_file(&path).map_err(failed("reading", &path))?;
            Ok(FileRecord {
                path: file.path,
                bytes,
                modified_ns: file.modified_ns,
                blake3,
            })
        });
        let records = records.collect::<Result<_, ImportError>>()?;
        Ok(Self::new(session_id, source, imported, records, report))
    }

    /// The record in a session's folder; `None` if it is missing or unreadable.
    pub fn read(folder: &Path) -> Option<Self> {
        let limit = plain_file::DOCUMENT_LIMIT;
        let text = plain_file::read_below(folder, Path::new(RECORD), limit).ok()?;
        let record: Self = serde_json::from_slice(&text).ok()?;
        (record.format == FORMAT && record.version == VERSION).then_some(record)
    }

    /// Writes the record into a session's folder, atomically.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn write(&self, folder: &Path) -> io::Result<()> {
        let text = serde_json::to_vec_pretty(self).map_err(io::Error::other)?;
        storage::replace(&DiskStorage::new(folder), RECORD, &text)
    }
}
