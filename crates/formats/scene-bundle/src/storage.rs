//! Storage of a bundle behind a small trait, so that a test can cut it off at every step: [`Disk`]
//! is a folder, and the tests have one in memory that loses unsynced data.
//!
//! What the trait promises is what POSIX promises and no more: bytes are durable after
//! [`StoredFile::sync`], names after [`Storage::sync_dir`] of the folder they are in; until then a
//! power cut may keep any part of either.

use std::io::{self, Read};
use std::path::Path;

mod disk;
#[cfg(test)]
pub(crate) mod memory;

pub(crate) use disk::Disk;

/// A folder with relative `/`-separated paths in it; `""` is the folder itself.
pub(crate) trait Storage: Send + Sync {
    /// Path of the folder, for messages.
    fn root(&self) -> &Path;

    /// Creates a file that must not exist yet.
    fn create(&self, path: &str) -> io::Result<Box<dyn StoredFile>>;

    /// Opens a file for reading from its beginning.
    fn open(&self, path: &str) -> io::Result<Box<dyn Read + Send>>;

    /// Length of a file, bytes.
    fn length(&self, path: &str) -> io::Result<u64>;

    /// Names in a folder, sorted, and whether each is a folder.
    fn list(&self, dir: &str) -> io::Result<Vec<(String, bool)>>;

    /// Creates a folder in one that exists.
    fn create_dir(&self, dir: &str) -> io::Result<()>;

    /// Renames a file over another, or a folder to a name that is not taken, atomically.
    fn rename(&self, from: &str, to: &str) -> io::Result<()>;

    /// Removes a file.
    fn remove_file(&self, path: &str) -> io::Result<()>;

    /// Removes an empty folder.
    fn remove_dir(&self, dir: &str) -> io::Result<()>;

    /// Makes the names in a folder durable.
    fn sync_dir(&self, dir: &str) -> io::Result<()>;
}

/// A file being written.
pub(crate) trait StoredFile: Send {
    /// Appends all of `bytes`.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Writes over bytes at the beginning that were appended before.
    fn overwrite_start(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Makes everything written durable.
    fn sync(&mut self) -> io::Result<()>;
}

/// Everything in a file of at most `limit` bytes. Its length is checked before memory is allocated.
pub(crate) fn read_all(storage: &dyn Storage, path: &str, limit: u64) -> io::Result<Vec<u8>> {
    let length = storage.length(path)?;
    plain_file::read_known(storage.open(path)?, length, limit)
}

/// Writes a file in the root folder so that a power cut leaves the old or the new content, never a
/// mixture: written beside it, synced, renamed over it, and the name synced too.
pub(crate) fn replace(storage: &dyn Storage, path: &str, bytes: &[u8]) -> io::Result<()> {
    let temporary = crate::layout::temporary(path);
    match storage.remove_file(&temporary) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    let mut file = storage.create(&temporary)?;
    file.append(bytes)?;
    file.sync()?;
    drop(file);
    storage.rename(&temporary, path)?;
    storage.sync_dir("")
}

/// Removes a folder and its content; succeeds if it does not exist.
pub(crate) fn remove_all(storage: &dyn Storage, dir: &str) -> io::Result<()> {
    let entries = match storage.list(dir) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(()),
        other => other?,
    };
    for (name, is_dir) in entries {
        let path = format!("{dir}/{name}");
        if is_dir {
            remove_all(storage, &path)?;
        } else {
            storage.remove_file(&path)?;
        }
    }
    storage.remove_dir(dir)
}
