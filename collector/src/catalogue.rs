//! The catalogue: one row per session of a library, in SQLite.
//!
//! The catalogue is a cache. Every field is read by [`Row::of`] from a file of the session's
//! folder, so the catalogue can be deleted or rebuilt at any time; [`crate::library`] does so.
//!
//! * **Reading** writes nothing, so that it works on a full and on a read-only file system.
//! * **Damaged, truncated, empty, of another version, not a file**: detected before a row is used
//!   (`Catalogue::inspect`), renamed, and rebuilt.
//! * **Not writable**: the change is made in memory; listing still works.

mod database_files;
mod integrity;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rusqlite::{
    Connection, Error as SqlError, OpenFlags, Transaction, TransactionBehavior, params,
};
use session_archive::handoff::Verdict;
use session_archive::reader::{ReadError, SessionReader};
use session_archive::storage::DiskStorage;
use session_archive::time::CivilTime;
use session_archive::verify::Report;

use crate::condition::Condition;
use crate::folders::sync_folder;
use crate::import::ImportRecord;
use crate::validation::Validation;

/// Version of the table below. A catalogue of another version is rebuilt.
const SCHEMA_VERSION: i64 = 1;
/// SQLite busy timeout while another program writes, which takes milliseconds.
const BUSY_TIMEOUT: Duration = Duration::from_secs(60);

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
    /// Name given by the user; may be empty.
    pub name: String,
    /// When recording began.
    pub started_civil: CivilTime,
    /// From the first sample to the last, ns; 0 if unknown.
    pub duration_ns: i64,
    /// Bytes of the segments.
    pub bytes: u64,
    /// Names of the cameras, separated by commas.
    pub cameras: String,
    /// Names of the IMUs, separated by commas.
    pub imus: String,
    /// Condition of the session.
    pub condition: Condition,
    /// Samples present in all numbered streams.
    pub samples: u64,
    /// Samples missing, with or without a gap record.
    pub missing: u64,
    /// Verdict of the last validation.
    pub verdict: Option<Verdict>,
    /// Where it was imported from.
    pub source: String,
    /// When it was imported.
    pub imported: Option<CivilTime>,
}

impl Row {
    /// Reads the row of a session from its folder.
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

/// The newest verification report: a validation is newer than the import.
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

/// The catalogue cannot be used. The sessions of the library are not affected.
#[derive(Debug, thiserror::Error)]
#[error("using the catalogue: {}", .path.display())]
pub struct CatalogueError {
    /// Error of SQLite.
    #[source]
    source: SqlError,
    /// The file.
    path: PathBuf,
}

/// An open catalogue.
pub struct Catalogue {
    connection: Connection,
    path: PathBuf,
    /// Whether it is held in memory because the file cannot be used.
    in_memory: bool,
}

/// State of the catalogue file.
pub(crate) enum CatalogueFile {
    /// A complete catalogue of this version.
    Usable(Box<Catalogue>),
    /// Nothing.
    Missing,
    /// Not a catalogue: damaged, of another version, or not a file. With the reason.
    Unusable(String),
    /// Not readable: no permission, or no space for the files that SQLite needs beside it. With the
    /// reason.
    Unreachable(String),
}

impl Catalogue {
    /// Checks the catalogue file. Nothing is written.
    ///
    /// # Errors
    /// Another program has locked it for a minute.
    pub(crate) fn inspect(path: &Path) -> Result<CatalogueFile, CatalogueError> {
        match integrity::of_file(path) {
            Ok(None) => {}
            Ok(Some(why)) => return Ok(CatalogueFile::Unusable(why)),
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(CatalogueFile::Missing),
            Err(e) => return Ok(CatalogueFile::Unreachable(e.to_string())),
        }
        let opened = Self::connect(path).and_then(|connection| {
            let why = integrity::of_content(&connection, path, SCHEMA_VERSION)?;
            let catalogue = Self {
                connection,
                path: path.to_owned(),
                in_memory: false,
            };
            let read = match why {
                Some(_) => Ok(Vec::new()),
                None => catalogue.read_rows(),
            };
            read.map(|_| (catalogue, why))
        });
        match opened {
            Ok((catalogue, None)) => Ok(CatalogueFile::Usable(Box::new(catalogue))),
            Ok((_, Some(why))) => Ok(CatalogueFile::Unusable(why)),
            Err(e) if integrity::is_damage(&e) => Ok(CatalogueFile::Unusable(e.to_string())),
            Err(e) if integrity::is_busy(&e) => Err(CatalogueError {
                source: e,
                path: path.to_owned(),
            }),
            Err(e) => Ok(CatalogueFile::Unreachable(e.to_string())),
        }
    }

    /// An empty catalogue in memory that replaces the one in a file.
    ///
    /// # Errors
    /// Memory is exhausted.
    pub(crate) fn in_memory(path: &Path) -> Result<Self, CatalogueError> {
        let made = Connection::open_in_memory().and_then(|connection| {
            connection.execute_batch(SCHEMA)?;
            Ok(connection)
        });
        let connection = made.map_err(|source| CatalogueError {
            source,
            path: path.to_owned(),
        })?;
        Ok(Self {
            connection,
            path: path.to_owned(),
            in_memory: true,
        })
    }

    /// Creates the file with these rows and opens it. It appears complete, by one rename; an
    /// existing file is renamed, never removed, and its new path is returned. The caller holds the
    /// library's lock.
    ///
    /// # Errors
    /// An I/O error occurs; the existing file is then unchanged.
    pub(crate) fn make(path: &Path, rows: &[Row]) -> anyhow::Result<(Self, Option<PathBuf>)> {
        let new = database_files::with_suffix(path, ".new");
        database_files::remove(&new)?;
        let made = Connection::open(&new).and_then(|mut connection| {
            let transaction =
                connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            transaction.execute_batch(SCHEMA)?;
            transaction.pragma_update(None, "user_version", SCHEMA_VERSION)?;
            for row in rows {
                insert(&transaction, row)?;
            }
            transaction.commit()?;
            connection.close().map_err(|(_, e)| e)
        });
        if let Err(e) = made {
            // An incomplete file is useless.
            let _ = database_files::remove(&new);
            return Err(e.into());
        }
        let old = database_files::set_aside(path)?;
        std::fs::rename(&new, path)?;
        if let Some(folder) = path.parent() {
            sync_folder(folder)?;
        }
        let opened = Self {
            connection: Self::connect(path)?,
            path: path.to_owned(),
            in_memory: false,
        };
        Ok((opened, old))
    }

    /// Opens an existing file. With a rollback journal, which exists only during a write, readers
    /// write nothing: they need locks, but no disk space.
    fn connect(path: &Path) -> Result<Connection, SqlError> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags)?;
        connection.busy_timeout(BUSY_TIMEOUT)?;
        connection.pragma_update(None, "synchronous", "NORMAL")?;
        Ok(connection)
    }

    /// Whether it is held in memory only, because the file cannot be used.
    pub fn is_in_memory(&self) -> bool {
        self.in_memory
    }

    /// Switches from the write-ahead log of earlier versions, which makes readers write, to a
    /// rollback journal. The caller holds the library's lock.
    pub(crate) fn leave_wal_mode(&self) {
        let mode = self
            .connection
            .pragma_query_value(None, "journal_mode", |r| r.get(0));
        if mode.is_ok_and(|mode: String| mode == "wal") {
            // Not possible while another program has it open; the next one tries again.
            let left = self
                .connection
                .pragma_update(None, "journal_mode", "DELETE");
            if let Err(e) = left {
                log::debug!("the catalogue keeps its journal: {e}");
            }
        }
    }

    /// Inserts a session, or replaces its row.
    ///
    /// # Errors
    /// Neither the file nor memory can be written.
    pub fn put(&mut self, row: &Row) -> Result<(), CatalogueError> {
        self.write(|connection| insert(connection, row))
    }

    /// Removes a session.
    ///
    /// # Errors
    /// Neither the file nor memory can be written.
    pub fn remove(&mut self, key: &str) -> Result<(), CatalogueError> {
        self.write(|connection| {
            connection
                .execute("DELETE FROM session WHERE key = ?1", [key])
                .map(drop)
        })
    }

    /// Replaces all rows in one transaction: a concurrent reader sees either the old or the new
    /// rows.
    ///
    /// # Errors
    /// Neither the file nor memory can be written.
    pub fn replace(&mut self, rows: &[Row]) -> Result<(), CatalogueError> {
        self.write(|connection| {
            let transaction =
                Transaction::new_unchecked(connection, TransactionBehavior::Immediate)?;
            transaction.execute("DELETE FROM session", [])?;
            for row in rows {
                insert(&transaction, row)?;
            }
            transaction.commit()
        })
    }

    /// Changes the catalogue. If the file cannot be written (full disk, no permission), the change
    /// is made in memory; the file, now outdated, is removed if possible and rebuilt by the next
    /// program that opens it.
    fn write(
        &mut self,
        change: impl Fn(&Connection) -> Result<(), SqlError>,
    ) -> Result<(), CatalogueError> {
        let failed = match change(&self.connection) {
            Ok(()) => return Ok(()),
            Err(e) if self.in_memory || integrity::is_busy(&e) => return Err(self.failed(e)),
            Err(e) => e,
        };
        let mut memory = Self::in_memory(&self.path)?;
        for row in self.rows()? {
            memory.put(&row)?;
        }
        change(&memory.connection).map_err(|e| self.failed(e))?;
        // Close the connection before its file is removed.
        drop(std::mem::replace(self, memory));
        let rest = match database_files::remove(&self.path) {
            Ok(()) => "it is rebuilt from the sessions as soon as possible".to_owned(),
            Err(e) => format!("until `paws rebuild` it may be out of date ({e})"),
        };
        log::warn!(
            "the catalogue cannot be written, the sessions are not concerned: {failed}; {rest}: {}",
            self.path.display()
        );
        Ok(())
    }

    /// All sessions, the oldest first.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn rows(&self) -> Result<Vec<Row>, CatalogueError> {
        self.read_rows().map_err(|e| self.failed(e))
    }

    fn read_rows(&self) -> Result<Vec<Row>, SqlError> {
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

    fn opened(path: &Path) -> Catalogue {
        match Catalogue::inspect(path).unwrap() {
            CatalogueFile::Usable(catalogue) => *catalogue,
            CatalogueFile::Missing => panic!("missing"),
            CatalogueFile::Unusable(why) | CatalogueFile::Unreachable(why) => panic!("{why}"),
        }
    }

    #[test]
    fn rows_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("catalogue.sqlite");
        assert!(matches!(
            Catalogue::inspect(&path).unwrap(),
            CatalogueFile::Missing
        ));
        let (mut catalogue, database_files) = Catalogue::make(&path, &[]).unwrap();
        assert_eq!(database_files, None);
        catalogue.put(&row("b")).unwrap();
        let changed = Row {
            verdict: None,
            imported: None,
            ..row("a")
        };
        catalogue.put(&row("a")).unwrap();
        catalogue.put(&changed).unwrap();
        drop(catalogue);
        let mut catalogue = opened(&path);
        assert_eq!(catalogue.rows().unwrap(), [changed, row("b")]);
        catalogue.remove("a").unwrap();
        assert_eq!(catalogue.rows().unwrap(), [row("b")]);
        catalogue.replace(&[row("c"), row("d")]).unwrap();
        assert_eq!(catalogue.rows().unwrap(), [row("c"), row("d")]);
        // Reading and writing leave no file beside it.
        drop(catalogue);
        let names = std::fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(names, 1);
    }

    #[test]
    fn unusable_catalogue_file_is_detected_before_a_row_is_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("catalogue.sqlite");
        let rows: Vec<Row> = (0..200).map(|i| row(&format!("session-{i}"))).collect();
        Catalogue::make(&path, &rows).unwrap();
        let whole = std::fs::read(&path).unwrap();
        assert!(whole.len() > 20_000);
        let why = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            match Catalogue::inspect(&path).unwrap() {
                CatalogueFile::Unusable(why) => why,
                CatalogueFile::Usable(catalogue) => {
                    panic!("{} rows", catalogue.rows().unwrap().len())
                }
                CatalogueFile::Missing => panic!("missing"),
                CatalogueFile::Unreachable(why) => panic!("unreachable: {why}"),
            }
        };
        for length in [
            0,
            1,
            15,
            50,
            99,
            100,
            512,
            4096,
            5000,
            whole.len() / 2,
            whole.len() - 1,
        ] {
            why(&whole[..length]);
        }
        assert_eq!(why(&[]), "it is empty");
        assert!(why(b"no database").contains("not an SQLite database"));
        assert!(why(&[0; 8192]).contains("not an SQLite database"));
        // A file that SQLite opens but does not write to.
        let mut later = whole.clone();
        later[18] = 9;
        assert!(why(&later).contains("later version"), "{}", why(&later));
        // Pages overwritten, header intact.
        let mut garbage = whole.clone();
        garbage[4096..].fill(0x5a);
        why(&garbage);
        std::fs::write(&path, &whole).unwrap();
        assert_eq!(opened(&path).rows().unwrap().len(), 200);
        // Another version, and other columns under the same version.
        let changed = |sql: &str| {
            std::fs::write(&path, &whole).unwrap();
            Connection::open(&path).unwrap().execute_batch(sql).unwrap();
            why(&std::fs::read(&path).unwrap())
        };
        let set = format!("PRAGMA user_version = {}", SCHEMA_VERSION + 1);
        assert!(changed(&set).contains("version 2"), "{}", changed(&set));
        let other = changed("ALTER TABLE session RENAME COLUMN missing TO absent");
        assert!(other.contains("no such column"), "{other}");
        assert!(changed("DROP TABLE session").contains("no such table"));
        // A FIFO in its place does not block.
        std::fs::remove_file(&path).unwrap();
        let mode = rustix::fs::Mode::from_raw_mode(0o644);
        let fifo = rustix::fs::FileType::Fifo;
        rustix::fs::mknodat(rustix::fs::CWD, &path, fifo, mode, 0).unwrap();
        match Catalogue::inspect(&path).unwrap() {
            CatalogueFile::Unusable(why) => assert!(why.contains("FIFO"), "{why}"),
            _ => panic!("a FIFO is not a catalogue"),
        }
    }

    #[test]
    fn unusable_catalogue_file_is_renamed_and_never_lost() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("catalogue.sqlite");
        let mut expected = Vec::new();
        for (i, name) in ["damaged", "damaged-2", "damaged-3"].iter().enumerate() {
            let content = format!("garbage {i}");
            std::fs::write(&path, &content).unwrap();
            std::fs::write(folder.path().join("catalogue.sqlite-wal"), "log").unwrap();
            let (catalogue, database_files) = Catalogue::make(&path, &[row("a")]).unwrap();
            assert_eq!(catalogue.rows().unwrap(), [row("a")]);
            let database_files = database_files.unwrap();
            assert_eq!(
                database_files,
                folder.path().join(format!("catalogue.sqlite.{name}"))
            );
            expected.push((database_files, content));
        }
        for (database_files, content) in expected {
            assert_eq!(std::fs::read_to_string(&database_files).unwrap(), content);
            let log = database_files::with_suffix(&database_files, "-wal");
            assert_eq!(std::fs::read_to_string(log).unwrap(), "log");
        }
    }

    #[test]
    fn catalogue_in_wal_mode_is_switched_to_a_rollback_journal() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("catalogue.sqlite");
        let (mut catalogue, _) = Catalogue::make(&path, &[row("a")]).unwrap();
        (catalogue.connection)
            .pragma_update(None, "journal_mode", "WAL")
            .unwrap();
        catalogue.put(&row("b")).unwrap();
        drop(catalogue);
        let catalogue = opened(&path);
        catalogue.leave_wal_mode();
        drop(catalogue);
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(bytes[18..20], [1, 1], "header without write-ahead log");
        assert_eq!(opened(&path).rows().unwrap(), [row("a"), row("b")]);
    }
}
