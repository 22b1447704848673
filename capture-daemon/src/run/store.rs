//! Sessions as folders below one folder.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use session_archive::storage::{DiskStorage, Storage};
use session_archive::time::CivilTime;

use crate::disk;
use crate::recorder::SessionStore;

/// Makes session folders named by their time: `2026-11-21T02-03-17Z_1a2b3c4d`.
pub struct FolderStore {
    out: PathBuf,
    /// Ten random bytes for an identifier.
    random: Box<dyn FnMut() -> [u8; 10] + Send>,
    /// Whether the machine is looked at.
    looks: bool,
}

impl FolderStore {
    /// Sessions go into `out`; identifiers are made from their time and the machine's randomness.
    pub fn random(out: PathBuf) -> Self {
        let random = || {
            let mut bytes = [0; 10];
            bytes.copy_from_slice(&uuid::Uuid::now_v7().as_bytes()[6..]);
            bytes
        };
        Self {
            out,
            random: Box::new(random),
            looks: true,
        }
    }

    /// Sessions go into `out`; identifiers are made from their time alone, and neither free space nor
    /// temperature is known: nothing that changes from run to run gets into a session.
    pub fn reproducible(out: PathBuf) -> Self {
        Self {
            out,
            random: Box::new(|| [0; 10]),
            looks: false,
        }
    }
}

impl SessionStore for FolderStore {
    fn create(&mut self, started: CivilTime) -> io::Result<(PathBuf, Arc<dyn Storage>, String)> {
        let millis = (started.0 / 1_000_000).max(0) as u64;
        let id = uuid::Builder::from_unix_timestamp_millis(millis, &(self.random)()).into_uuid();
        let time = started.to_string();
        let time = time.split('.').next().unwrap_or(&time).replace(':', "-");
        let text = id.to_string();
        let path = self
            .out
            .join(format!("{time}Z_{}", &text[text.len() - 8..]));
        fs::create_dir(&path)?;
        // The session is found after a power cut only if its name is on disk.
        fs::File::open(&self.out)?.sync_all()?;
        Ok((path.clone(), Arc::new(DiskStorage::new(path)), text))
    }

    fn discard(&mut self, path: &Path) -> io::Result<()> {
        fs::remove_dir_all(path)
    }

    fn free_bytes(&self) -> Option<u64> {
        self.looks
            .then(|| disk::free_bytes(&self.out).ok())
            .flatten()
    }

    fn temperature_c(&self) -> Option<f64> {
        self.looks.then(disk::hottest_c).flatten()
    }
}
