//! The catalogue: one row per session of a library, in SQLite.
//!
//! It is a copy. Every fact in it stands in a file of the session's folder, from which
//! [`Row::of`] reads it, so the catalogue can be deleted or rebuilt at any time. A catalogue that is
//! damaged or of another version is replaced by an empty one, which its library fills again.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rusqlite::{Connection, Error as SqlError, ErrorCode, params};
use session_archive::handoff::Verdict;
use session_archive::reader::{ReadError, SessionReader};
use session_archive::storage::DiskStorage;
use session_archive::time::CivilTime;
use session_archive::verify::Report;

use crate::condition::Condition;
use crate::import::ImportRecord;
use crate::validation::Validation;

/// Version of the table below; another one found means: build it anew.
const SCHEMA_VERSION: i64 = 1;

const SCHEMA: &str = "
CREATE TABLE session (
    key TEXT PRIMARY KEY NOT NULL,
    session_id TEXT NOT NULL,
    name TEXT NOT NULL,
    started_civil_ns INTEGER NOT NULL,
    duration_ns INTEGER NOT NULL,
    bytes INTEGER NOT NULL,
    cameras TEXT NOT NULL,
    imus TEXT NOT NULL,
    condition TEXT NOT NULL,
    samples INTEGER NOT NULL,
    missing INTEGER NOT NULL,
    verdict TEXT,
    source TEXT NOT NULL,
    imported_civil_ns INTEGER
) STRICT;
CREATE INDEX by_time ON session (started_civil_ns, key);";

/// One session of a library.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Row {
    /// Name of its folder in the library: the session's identifier, with `.recovered` behind it
    /// for a recovered copy.
    pub key: String,
    /// The session's identifier.
    pub session_id: String,
    /// Given by the user; may be empty.
    pub name: String,
    /// When recording began.
    pub started_civil: CivilTime,
    /// From the first sample to the last, ns; 0 where not known.
    pub duration_ns: i64,
    /// Bytes of the segments.
    pub bytes: u64,
    /// Names of the cameras, separated by commas.
    pub cameras: String,
    /// Names of the IMUs, separated by commas.
    pub imus: String,
    /// In what condition it is.
    pub condition: Condition,
    /// Samples present in all numbered streams.
    pub samples: u64,
    /// Samples missing, accounted for or not.
    pub missing: u64,
    /// Verdict of the last validation.
    pub verdict: Option<Verdict>,
    /// Where it was imported from.
    pub source: String,
    /// When it was imported.
    pub imported: Option<CivilTime>,
}

impl Row {
    /// Reads the facts of a session from its folder.
    ///
    /// # Errors
    /// The folder holds no session, or cannot be read.
    pub fn of(key: &str, folder: &Path) -> Result<Self, ReadError> {
        let reader = SessionReader::open(Arc::new(DiskStorage::new(folder)))?;
        let manifest = reader.manifest();
        let record = ImportRecord::read(folder);
        let validation = Validation::read(folder).ok();
        let report = newest_report(validation.as_ref(), record.as_ref());
        let streams = || report.into_iter().flat_map(|r| r.streams.values());
        let sampled = || streams().filter(|s| s.samples > 0);
        let span = sampled()
            .map(|s| s.start)
            .min()
            .zip(sampled().map(|s| s.end).max());
        Ok(Self {
            key: key.to_owned(),
            session_id: manifest.session_id.clone(),
            name: manifest.name.clone(),
            started_civil: manifest.started_civil,
            duration_ns: span.map_or(0, |(start, end)| end.since(start)),
            bytes: reader.bytes()?,
            cameras: join(manifest.cameras.iter().map(|c| &c.name)),
            imus: join(manifest.imus.iter().map(|i| &i.name)),
            condition: report.map_or(Condition::Unverified, |r| Condition::of(manifest.state, r)),
            samples: streams().map(|s| s.samples).fold(0, u64::saturating_add),
            missing: streams()
                .map(|s| s.gaps.saturating_add(s.lost))
                .fold(0, u64::saturating_add),
            verdict: validation.as_ref().map(|v| v.verdict),
            source: record.as_ref().map_or(String::new(), |r| r.source.clone()),
            imported: record.as_ref().map(|r| r.imported),
        })
    }
}

/// What was found last: a validation comes after the import.
pub(crate) fn newest_report<'a>(
    validation: Option<&'a Validation>,
    record: Option<&'a ImportRecord>,
) -> Option<&'a Report> {
    let validated = validation.map(|v| &v.report);
    validated.or(record.map(|r| &r.report))
}

fn join<'a>(names: impl Iterator<Item = &'a String>) -> String {
    names.map(String::as_str).collect::<Vec<_>>().join(",")
}

/// Why the catalogue cannot be used; the library itself is not concerned.
#[derive(Debug, thiserror::Error)]
#[error("using the catalogue: {}", .path.display())]
pub struct CatalogueError {
    /// What SQLite says.
    #[source]
    source: SqlError,
    /// The file.
    path: PathBuf,
}

/// An open catalogue.
pub struct Catalogue {
    connection: Connection,
    path: PathBuf,
}

impl Catalogue {
    /// Opens the catalogue in a file. One that is not there, damaged or of another version becomes an
    /// empty one; where the file cannot be written, the catalogue is kept in memory.
    ///
    /// # Errors
    /// Memory or the disk is exhausted.
    pub fn open(path: &Path) -> Result<Self, CatalogueError> {
        let failed = |source| CatalogueError {
            source,
            path: path.to_owned(),
        };
        let mut opened = Self::connect(path);
        if opened.as_ref().is_err_and(is_unusable) {
            log::warn!("the catalogue is damaged or of another version and is built anew");
            for suffix in ["", "-wal", "-shm"] {
                let mut file = path.as_os_str().to_owned();
                file.push(suffix);
                // What is not there need not be removed; what cannot be removed fails below.
                let _ = std::fs::remove_file(file);
            }
            opened = Self::connect(path);
        }
        let connection = match opened {
            Err(e) if cannot_write(&e) => {
                let connection = Connection::open_in_memory().map_err(failed)?;
                connection.execute_batch(SCHEMA).map_err(failed)?;
                connection
            }
            other => other.map_err(failed)?,
        };
        Ok(Self {
            connection,
            path: path.to_owned(),
        })
    }

    fn connect(path: &Path) -> Result<Connection, SqlError> {
        let connection = Connection::open(path)?;
        connection.busy_timeout(std::time::Duration::from_secs(10))?;
        connection.pragma_update(None, "journal_mode", "WAL")?;
        connection.pragma_update(None, "synchronous", "NORMAL")?;
        let version: i64 = connection.pragma_query_value(None, "user_version", |r| r.get(0))?;
        let tables: i64 =
            connection.query_row("SELECT count(*) FROM sqlite_schema", [], |r| r.get(0))?;
        if tables == 0 {
            connection.execute_batch(&format!(
                "BEGIN IMMEDIATE; {SCHEMA} PRAGMA user_version = {SCHEMA_VERSION}; COMMIT;"
            ))?;
        } else if version != SCHEMA_VERSION {
            return Err(SqlError::InvalidQuery);
        }
        Ok(connection)
    }

    /// Puts a session in, or replaces its row.
    ///
    /// # Errors
    /// The disk says no.
    pub fn put(&mut self, row: &Row) -> Result<(), CatalogueError> {
        let result = insert(&self.connection, row);
        result.map_err(|e| self.failed(e))
    }

    /// Takes a session out.
    ///
    /// # Errors
    /// The disk says no.
    pub fn remove(&mut self, key: &str) -> Result<(), CatalogueError> {
        let result = self
            .connection
            .execute("DELETE FROM session WHERE key = ?1", [key]);
        result.map(drop).map_err(|e| self.failed(e))
    }

    /// Replaces everything at once: whoever reads meanwhile sees the old or the new rows.
    ///
    /// # Errors
    /// The disk says no; the old rows stay.
    pub fn replace(&mut self, rows: &[Row]) -> Result<(), CatalogueError> {
        let path = self.path.clone();
        let all = || -> Result<(), SqlError> {
            let transaction = self.connection.transaction()?;
            transaction.execute("DELETE FROM session", [])?;
            for row in rows {
                insert(&transaction, row)?;
            }
            transaction.commit()
        };
        let mut all = all;
        all().map_err(|source| CatalogueError { source, path })
    }

    /// All sessions, the oldest first.
    ///
    /// # Errors
    /// The disk says no.
    pub fn rows(&self) -> Result<Vec<Row>, CatalogueError> {
        let read = || -> Result<Vec<Row>, SqlError> {
            let mut statement = self.connection.prepare(
                "SELECT key, session_id, name, started_civil_ns, duration_ns, bytes, cameras, imus,
                        condition, samples, missing, verdict, source, imported_civil_ns
                 FROM session ORDER BY started_civil_ns, key",
            )?;
            let rows = statement.query_map([], |r| {
                let verdict: Option<String> = r.get(11)?;
                Ok(Row {
                    key: r.get(0)?,
                    session_id: r.get(1)?,
                    name: r.get(2)?,
                    started_civil: CivilTime(r.get(3)?),
                    duration_ns: r.get(4)?,
                    bytes: r.get::<_, i64>(5)? as u64,
                    cameras: r.get(6)?,
                    imus: r.get(7)?,
                    condition: Condition::from_word(&r.get::<_, String>(8)?),
                    samples: r.get::<_, i64>(9)? as u64,
                    missing: r.get::<_, i64>(10)? as u64,
                    verdict: verdict.and_then(|v| verdict_of(&v)),
                    source: r.get(12)?,
                    imported: r.get::<_, Option<i64>>(13)?.map(CivilTime),
                })
            })?;
            rows.collect()
        };
        read().map_err(|e| self.failed(e))
    }

    fn failed(&self, source: SqlError) -> CatalogueError {
        CatalogueError {
            source,
            path: self.path.clone(),
        }
    }
}

fn insert(connection: &Connection, row: &Row) -> Result<(), SqlError> {
    connection
        .prepare_cached(
            "INSERT OR REPLACE INTO session (key, session_id, name, started_civil_ns, duration_ns,
                bytes, cameras, imus, condition, samples, missing, verdict, source,
                imported_civil_ns)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14)",
        )?
        .execute(params![
            row.key,
            row.session_id,
            row.name,
            row.started_civil.0,
            row.duration_ns,
            row.bytes as i64,
            row.cameras,
            row.imus,
            row.condition.as_str(),
            row.samples as i64,
            row.missing as i64,
            row.verdict.map(|v| v.to_string()),
            row.source,
            row.imported.map(|t| t.0),
        ])
        .map(drop)
}

fn verdict_of(word: &str) -> Option<Verdict> {
    [Verdict::Pass, Verdict::Warn, Verdict::Fail]
        .into_iter()
        .find(|v| v.to_string() == word)
}

/// Whether the file is no catalogue of this version.
fn is_unusable(error: &SqlError) -> bool {
    matches!(error, SqlError::InvalidQuery)
        || matches!(
            error.sqlite_error_code(),
            Some(ErrorCode::NotADatabase | ErrorCode::DatabaseCorrupt)
        )
}

fn cannot_write(error: &SqlError) -> bool {
    matches!(
        error.sqlite_error_code(),
        Some(ErrorCode::ReadOnly | ErrorCode::CannotOpen | ErrorCode::PermissionDenied)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(key: &str) -> Row {
        Row {
            key: key.to_owned(),
            session_id: key.to_owned(),
            name: "walk".to_owned(),
            started_civil: CivilTime(5),
            duration_ns: 20,
            bytes: 1 << 40,
            cameras: "left_shoulder,feet".to_owned(),
            imus: String::new(),
            condition: Condition::Damaged,
            samples: 100,
            missing: 3,
            verdict: Some(Verdict::Warn),
            source: "/mnt/rig".to_owned(),
            imported: Some(CivilTime(7)),
        }
    }

    #[test]
    fn rows_come_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("catalogue.sqlite");
        let mut catalogue = Catalogue::open(&path).unwrap();
        catalogue.put(&row("b")).unwrap();
        let changed = Row {
            verdict: None,
            imported: None,
            ..row("a")
        };
        catalogue.put(&row("a")).unwrap();
        catalogue.put(&changed).unwrap();
        drop(catalogue);
        let mut catalogue = Catalogue::open(&path).unwrap();
        assert_eq!(catalogue.rows().unwrap(), [changed, row("b")]);
        catalogue.remove("a").unwrap();
        assert_eq!(catalogue.rows().unwrap(), [row("b")]);
        catalogue.replace(&[row("c"), row("d")]).unwrap();
        assert_eq!(catalogue.rows().unwrap(), [row("c"), row("d")]);
    }

    #[test]
    fn a_damaged_or_strange_file_becomes_an_empty_catalogue() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("catalogue.sqlite");
        std::fs::write(
            &path,
            b"this is no database, and long enough to tell".repeat(40),
        )
        .unwrap();
        let mut catalogue = Catalogue::open(&path).unwrap();
        catalogue.put(&row("a")).unwrap();
        let set = format!("PRAGMA user_version = {}", SCHEMA_VERSION + 1);
        catalogue.connection.execute_batch(&set).unwrap();
        drop(catalogue);
        assert_eq!(Catalogue::open(&path).unwrap().rows().unwrap(), []);
    }
}
