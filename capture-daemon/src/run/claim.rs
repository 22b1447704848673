//! Ownership of a session while it is written: a lock on its folder, for programs that know nothing
//! of each other.
//!
//! Contract: a program that records or closes a session holds its [`Claim`], from before there is
//! anything in it until the last byte is written. The system releases it when the program ends,
//! however that happens. A file system without locks has no claims: then sessions are protected
//! only within one program.

use std::fs::File;
use std::io;
use std::path::Path;

use session_archive::storage::{DiskStorage, ReadAt, Storage, WriteFile};

/// A session's folder belongs to this program until this is dropped.
#[derive(Debug)]
pub(super) struct Claim {
    _folder: File,
}

impl Claim {
    /// Claims the session in this folder; waits for the present owner.
    ///
    /// # Errors
    /// The folder does not exist, or its file system has no locks.
    pub(super) fn wait(session: &Path) -> io::Result<Self> {
        let folder = File::open(session)?;
        folder.lock()?;
        Ok(Self { _folder: folder })
    }
}

/// Whether another program has claimed the session in this folder.
pub(super) fn is_claimed(session: &Path) -> bool {
    // Shared, so that several checks do not see each other.
    let lock = File::open(session).map(|folder| folder.try_lock_shared());
    matches!(lock, Ok(Err(std::fs::TryLockError::WouldBlock)))
}

/// Storage in a session's folder, with the claim to it.
pub(super) struct ClaimedStorage {
    storage: DiskStorage,
    _claim: Option<Claim>,
}

impl ClaimedStorage {
    /// Claims a new folder, which another program can hold only for the duration of a check.
    pub(super) fn new(session: &Path) -> Self {
        let claim = Claim::wait(session)
            .inspect_err(|error| log::warn!("claiming a session: {error}: {}", session.display()));
        Self {
            storage: DiskStorage::new(session),
            _claim: claim.ok(),
        }
    }
}

impl Storage for ClaimedStorage {
    fn create(&self, path: &str) -> io::Result<Box<dyn WriteFile>> {
        self.storage.create(path)
    }

    fn open(&self, path: &str) -> io::Result<Box<dyn ReadAt>> {
        self.storage.open(path)
    }

    fn list(&self, dir: &str) -> io::Result<Vec<String>> {
        self.storage.list(dir)
    }

    fn create_dir(&self, dir: &str) -> io::Result<()> {
        self.storage.create_dir(dir)
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        self.storage.rename(from, to)
    }

    fn remove(&self, path: &str) -> io::Result<()> {
        self.storage.remove(path)
    }

    fn sync_dir(&self, dir: &str) -> io::Result<()> {
        self.storage.sync_dir(dir)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn session_is_claimed_until_its_storage_is_dropped() {
        let folder = tempfile::tempdir().expect("folder");
        assert!(!is_claimed(folder.path()));
        let claimed = ClaimedStorage::new(folder.path());
        assert!(is_claimed(folder.path()) && is_claimed(folder.path()));
        drop(claimed);
        assert!(!is_claimed(folder.path()));
        assert!(!is_claimed(&folder.path().join("absent")));
        assert!(Claim::wait(&folder.path().join("absent")).is_err());
    }
}
