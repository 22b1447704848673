//! A session opened, and its index.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use console_output::Console;
use session_archive::index::Index;
use session_archive::reader::SessionReader;
use session_archive::storage::DiskStorage;

/// Opens the session in a folder.
///
/// # Errors
/// The folder holds no session, or cannot be read.
pub fn open(folder: &Path) -> Result<SessionReader> {
    SessionReader::open(Arc::new(DiskStorage::new(folder)))
        .with_context(|| format!("opening the session: {}", folder.display()))
}

/// The index of a session: the stored one if it still matches, else a new one, which is not
/// written.
///
/// # Errors
/// An I/O error occurs.
pub fn read_or_build(reader: &SessionReader, console: &Console<'_>) -> Result<Index> {
    match Index::read(reader) {
        Ok(index) => Ok(index),
        Err(_) => build(reader, console),
    }
}

/// A new index of a session, which is not written.
///
/// # Errors
/// An I/O error occurs.
pub fn build(reader: &SessionReader, console: &Console<'_>) -> Result<Index> {
    let progress = console.progress("indexing", reader.bytes()?);
    Ok(Index::build(reader, |bytes| progress.add(bytes))?)
}
