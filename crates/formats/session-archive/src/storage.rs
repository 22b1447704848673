//! Where a session's bytes go, behind a small trait, so that every failure of a disk can be
//! produced in a test: [`DiskStorage`] is a folder, [`FaultStorage`] a disk in memory that fails,
//! tears writes and loses unsynced data on demand.
//!
//! What the trait promises is what POSIX promises and no more: bytes are durable after
//! [`WriteFile::sync_data`], names of files after [`Storage::sync_dir`]; until then a power cut may
//! keep any part of either. After a failed write or sync a file must not be written again: what the
//! kernel still holds of it is unknown.

use std::io;

mod disk;
mod fault;

pub use disk::DiskStorage;
pub use fault::{CrashKind, Fault, FaultKind, FaultStorage, Operation};

/// A folder with relative `/`-separated paths in it.
pub trait Storage: Send + Sync {
    /// Creates a file that must not exist yet.
    ///
    /// # Errors
    /// The file exists, or the file system reports an I/O error.
    fn create(&self, path: &str) -> io::Result<Box<dyn WriteFile>>;

    /// Opens a file for reading.
    ///
    /// # Errors
    /// The file is not there, or the file system reports an I/O error.
    fn open(&self, path: &str) -> io::Result<Box<dyn ReadAt>>;

    /// Names of the entries of a folder, sorted; empty if the folder is not there.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    fn list(&self, dir: &str) -> io::Result<Vec<String>>;

    /// Creates a folder and those above it, their names durable; existing ones are fine.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    fn create_dir(&self, dir: &str) -> io::Result<()>;

    /// Renames a file over another, atomically.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    fn rename(&self, from: &str, to: &str) -> io::Result<()>;

    /// Removes a file.
    ///
    /// # Errors
    /// The file is not there, or the file system reports an I/O error.
    fn remove(&self, path: &str) -> io::Result<()>;

    /// Makes the names in a folder (`""` is the root) durable.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    fn sync_dir(&self, dir: &str) -> io::Result<()>;
}

/// A file that grows at its end.
pub trait WriteFile: Send {
    /// Appends all of `bytes`.
    ///
    /// # Errors
    /// The file system reports an I/O error; any part of `bytes` may have been written.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Makes everything appended durable.
    ///
    /// # Errors
    /// The file system reports an I/O error; nothing since the last success can be relied on.
    fn sync_data(&mut self) -> io::Result<()>;

    /// Cuts the file to `len` bytes.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    fn truncate(&mut self, len: u64) -> io::Result<()>;
}

/// A file that can be read anywhere, from any thread.
#[expect(
    clippy::len_without_is_empty,
    reason = "a file's length costs a call and may fail"
)]
pub trait ReadAt: Send + Sync {
    /// Length in bytes.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    fn len(&self) -> io::Result<u64>;

    /// Reads up to `buf.len()` bytes at `offset`; 0 at the end.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize>;

    /// Reads exactly `buf.len()` bytes at `offset`.
    ///
    /// # Errors
    /// The file system reports an I/O error, or the file ends before (`UnexpectedEof`).
    fn read_exact_at(&self, mut buf: &mut [u8], mut offset: u64) -> io::Result<()> {
        while !buf.is_empty() {
            match self.read_at(buf, offset) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(n) => {
                    buf = &mut buf[n..];
                    offset += n as u64;
                }
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }
}

impl ReadAt for Vec<u8> {
    fn len(&self) -> io::Result<u64> {
        Ok(Vec::len(self) as u64)
    }

    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize> {
        let start = usize::try_from(offset)
            .unwrap_or(usize::MAX)
            .min(Vec::len(self));
        let n = buf.len().min(Vec::len(self) - start);
        buf[..n].copy_from_slice(&self[start..start + n]);
        Ok(n)
    }
}

/// Everything in a document: a manifest, a rig file, a hand-off. At most
/// [`plain_file::DOCUMENT_LIMIT`] bytes.
///
/// # Errors
/// The file is not there, is longer ([`plain_file::TooLong`]), or the file system reports an I/O
/// error.
pub fn read_all(storage: &dyn Storage, path: &str) -> io::Result<Vec<u8>> {
    read_up_to(storage, path, plain_file::DOCUMENT_LIMIT)
}

/// Everything in a file of at most `limit` bytes. Its length is weighed before memory is taken.
///
/// # Errors
/// The file is not there, is longer ([`plain_file::TooLong`]), memory is exhausted, or the file
/// system reports an I/O error.
///
/// ```
/// use session_archive::storage::{FaultStorage, read_up_to};
///
/// let disk = FaultStorage::new();
/// disk.set_content("rig/rig.toml", b"revision = 1\n".to_vec());
/// assert_eq!(read_up_to(&disk, "rig/rig.toml", 100)?, b"revision = 1\n");
/// let refused = read_up_to(&disk, "rig/rig.toml", 10).unwrap_err();
/// assert_eq!(refused.kind(), std::io::ErrorKind::FileTooLarge);
/// # Ok::<(), std::io::Error>(())
/// ```
pub fn read_up_to(storage: &dyn Storage, path: &str, limit: u64) -> io::Result<Vec<u8>> {
    let file = storage.open(path)?;
    let length = file.len()?;
    if length > limit {
        let found = plain_file::TooLong {
            found: length,
            limit,
        };
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, found));
    }
    let mut bytes = plain_file::reserve(length)?;
    bytes.resize(length as usize, 0);
    file.read_exact_at(&mut bytes, 0)?;
    Ok(bytes)
}

/// Writes a file so that a power cut leaves the old or the new content, never a mixture: written
/// beside it, synced, renamed over it, and the name synced too.
///
/// # Errors
/// The file system reports an I/O error; the old content is still there.
///
/// ```
/// use session_archive::storage::{DiskStorage, read_all, replace};
///
/// let folder = tempfile::tempdir()?;
/// let storage = DiskStorage::new(folder.path());
/// replace(&storage, "validation.json", b"{ \"verdict\": \"FAIL\" }")?;
/// replace(&storage, "validation.json", b"{ \"verdict\": \"PASS\" }")?;
/// assert_eq!(read_all(&storage, "validation.json")?, b"{ \"verdict\": \"PASS\" }");
/// // The file that was written beside it was renamed.
/// assert_eq!(std::fs::read_dir(folder.path())?.count(), 1);
/// # Ok::<(), std::io::Error>(())
/// ```
pub fn replace(storage: &dyn Storage, path: &str, bytes: &[u8]) -> io::Result<()> {
    let temporary = format!("{path}.tmp");
    match storage.remove(&temporary) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    let mut file = storage.create(&temporary)?;
    file.append(bytes)?;
    file.sync_data()?;
    drop(file);
    storage.rename(&temporary, path)?;
    storage.sync_dir(path.rsplit_once('/').map_or("", |(dir, _)| dir))
}
