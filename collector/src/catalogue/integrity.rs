//! Integrity check of a catalogue file.

use std::io::{self, Read};
use std::path::Path;

use rusqlite::{Connection, Error as SqlError, ErrorCode};

/// Magic of SQLite databases (`sqlite.org/fileformat2.html`, 1.3).
const MAGIC: &[u8; 16] = b"SQLite format 3\0";
/// Format versions that are read and written, bytes 18 and 19: 1 without, 2 with a write-ahead log.
/// SQLite opens a later version read-only.
const VERSIONS: std::ops::RangeInclusive<u8> = 1..=2;

/// Reason why a file is unusable, by its kind and its first bytes; `None` if it is usable.
///
/// # Errors
/// The file does not exist, or an I/O error occurs.
pub(super) fn of_file(path: &Path) -> io::Result<Option<String>> {
    let mut file = match plain_file::open(path) {
        Err(e) if plain_file::is_refusal(&e) => return Ok(Some(e.to_string())),
        other => other?,
    };
    let mut head = Vec::new();
    file.by_ref().take(20).read_to_end(&mut head)?;
    let why = if head.is_empty() {
        Some("it is empty")
    } else if head.len() < 20 || !head.starts_with(MAGIC) {
        Some("it is not an SQLite database")
    } else if !head[18..20].iter().all(|v| VERSIONS.contains(v)) {
        Some("it is damaged, or of a later version of SQLite")
    } else {
        None
    };
    Ok(why.map(str::to_owned))
}

/// Reason why the content is unusable; `None` if it is usable.
///
/// # Errors
/// SQLite reports an error: see [`is_damage`].
pub(super) fn of_content(
    connection: &Connection,
    path: &Path,
    version: i64,
) -> Result<Option<String>, SqlError> {
    // One transaction: no writes between the queries.
    let connection = connection.unchecked_transaction()?;
    let found: i64 = connection.pragma_query_value(None, "user_version", |r| r.get(0))?;
    if found != version {
        let what = format!("it is of version {found}, expected version {version}");
        return Ok(Some(what));
    }
    let check: String = connection.query_row("PRAGMA integrity_check(1)", [], |r| r.get(0))?;
    if check != "ok" {
        return Ok(Some(check));
    }
    // SQLite reads the missing part of a truncated last page as zeros.
    let asked = |pragma: &str| connection.pragma_query_value(None, pragma, |r| r.get::<_, i64>(0));
    let expected = asked("page_count")?.saturating_mul(asked("page_size")?);
    let mode: String = connection.pragma_query_value(None, "journal_mode", |r| r.get(0))?;
    // With a write-ahead log, the newest pages are in the log.
    let length = std::fs::metadata(path).map_or(0, |data| data.len());
    let is_whole = mode == "wal" || i64::try_from(length) == Ok(expected);
    Ok((!is_whole).then(|| format!("it has {length} bytes, expected {expected}")))
}

/// Whether an error means that the file is not a catalogue.
pub(super) fn is_damage(error: &SqlError) -> bool {
    match error {
        SqlError::SqliteFailure(..) => matches!(
            error.sqlite_error_code(),
            // `Unknown` is SQLITE_ERROR: no such table, no such column.
            Some(ErrorCode::NotADatabase | ErrorCode::DatabaseCorrupt | ErrorCode::Unknown)
        ),
        SqlError::SqlInputError { .. }
        | SqlError::FromSqlConversionFailure(..)
        | SqlError::IntegralValueOutOfRange(..)
        | SqlError::InvalidColumnType(..)
        | SqlError::InvalidColumnName(..)
        | SqlError::Utf8Error(..)
        | SqlError::QueryReturnedNoRows => true,
        _ => false,
    }
}

/// Whether another program holds it locked.
pub(super) fn is_busy(error: &SqlError) -> bool {
    matches!(
        error.sqlite_error_code(),
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked)
    )
}
