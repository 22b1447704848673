//! Storage of sessions as folders below one folder.

use std::ffi::OsString;
use std::fs;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use session_archive::layout;
use session_archive::storage::Storage;
use session_archive::time::{CivilTime, HostTime};

use super::claim::ClaimedStorage;
use super::machine_monitor::MachineMonitor;
use crate::disk;
use crate::recorder::{MachineReading, SessionStore};

/// Prefix of a session's folder while it is being deleted.
const DISCARDED: &str = ".discarded-";

/// Creates session folders named by their time: `2026-11-21T02-03-17Z_1a2b3c4d`.
pub struct FolderStore {
    out: PathBuf,
    /// `None` if the same input must give the same session, byte for byte.
    machine_monitor: Option<MachineMonitor>,
    /// Identity of the only session in that case.
    identity: [u8; 16],
}

impl FolderStore {
    /// Sessions are written to `out` and leave `reserve_bytes` free; identifiers are derived from
    /// their time and the machine's randomness.
    pub fn random(out: PathBuf, reserve_bytes: u64) -> Self {
        Self {
            machine_monitor: Some(MachineMonitor::new(out.clone(), reserve_bytes)),
            identity: [0; 16],
            out,
        }
    }

    /// A session is written to `out`; its identifier is made of these bytes (a UUID of version 8),
    /// and the machine is not monitored: nothing that changes from run to run gets into the
    /// session.
    pub fn reproducible(out: PathBuf, identity: [u8; 16]) -> Self {
        Self {
            out,
            machine_monitor: None,
            identity,
        }
    }

    fn identifier(&self, started: CivilTime) -> io::Result<uuid::Uuid> {
        if self.machine_monitor.is_none() {
            return Ok(uuid::Builder::from_custom_bytes(self.identity).into_uuid());
        }
        let millis = (started.0 / 1_000_000).max(0) as u64;
        let mut bytes = [0; 10];
        fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
        Ok(uuid::Builder::from_unix_timestamp_millis(millis, &bytes).into_uuid())
    }
}

impl SessionStore for FolderStore {
    fn create(&mut self, started: CivilTime) -> io::Result<(PathBuf, Arc<dyn Storage>, String)> {
        let id = self.identifier(started)?;
        let time = started.to_string();
        let time = time.split('.').next().unwrap_or(&time).replace(':', "-");
        let text = id.to_string();
        let path = self
            .out
            .join(format!("{time}Z_{}", &text[text.len() - 8..]));
        fs::create_dir(&path)?;
        let storage = ClaimedStorage::new(&path);
        // The session is found after a power cut only if its name is on disk.
        fs::File::open(&self.out)?.sync_all()?;
        Ok((path, Arc::new(storage), text))
    }

    /// The session disappears by one rename; deleting an hour of video takes time, for which nobody
    /// waits.
    fn discard(&mut self, path: &Path) -> io::Result<()> {
        let name = path.file_name().unwrap_or_default();
        let mut removed = OsString::from(DISCARDED);
        removed.push(name);
        let removed = path.with_file_name(removed);
        fs::rename(path, &removed)?;
        fs::File::open(&self.out)?.sync_all()?;
        let removing = std::thread::Builder::new().name("discard".to_owned());
        // Without a thread it is deleted at the next start.
        let _ = removing.spawn(move || remove(&removed));
        Ok(())
    }

    fn is_there(&self, path: &Path) -> bool {
        path.join(layout::MANIFEST).exists() && path.join(layout::SEGMENTS).is_dir()
    }

    fn free_bytes(&self) -> Option<u64> {
        self.machine_monitor
            .is_some()
            .then(|| disk::free_bytes(&self.out).ok())
            .flatten()
    }

    fn machine(&mut self, now: HostTime, recording: bool) -> MachineReading {
        match &mut self.machine_monitor {
            Some(machine_monitor) => machine_monitor.read(now, recording),
            None => MachineReading::default(),
        }
    }
}

/// Deletes the remains of discarded sessions, as after a power cut in between.
pub(super) fn finish_discards(out: &Path) {
    let entries = fs::read_dir(out).into_iter().flatten().flatten();
    for entry in entries {
        let name = entry.file_name();
        if name.as_encoded_bytes().starts_with(DISCARDED.as_bytes())
            && entry.file_type().is_ok_and(|kind| kind.is_dir())
        {
            remove(&entry.path());
        }
    }
}

fn remove(removed: &Path) {
    match fs::remove_dir_all(removed) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => {
            log::warn!("deleting {}: {e}", removed.display());
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The recorder does not notice by itself: open files remain usable after their folder is
    /// removed.
    #[test]
    fn removed_session_folder_is_detected() {
        let folder = tempfile::tempdir().expect("folder");
        let mut store = FolderStore::random(folder.path().to_owned(), 0);
        let mut begun = || {
            let (path, storage, _) = store.create(CivilTime(0)).expect("session");
            fs::write(path.join(layout::MANIFEST), b"{}").expect("a manifest");
            fs::create_dir(path.join(layout::SEGMENTS)).expect("a folder");
            (path, storage)
        };
        let (whole, _claim) = begun();
        let (removed, _claim_too) = begun();
        let (emptied, _claim_as_well) = begun();
        fs::remove_dir_all(&removed).expect("removed");
        fs::remove_dir_all(emptied.join(layout::SEGMENTS)).expect("removed");
        assert!(store.is_there(&whole));
        assert!(!store.is_there(&removed));
        assert!(!store.is_there(&emptied));
    }

    #[test]
    fn discarded_session_disappears_immediately_and_is_deleted_later() {
        let folder = tempfile::tempdir().expect("folder");
        let mut store = FolderStore::random(folder.path().to_owned(), 0);
        let (path, storage, _) = store.create(CivilTime(0)).expect("session");
        drop(storage);
        fs::write(path.join("video"), b"a walk").expect("file");
        store.discard(&path).expect("discarded");
        assert!(!path.exists());
        assert!(store.discard(&path).is_err(), "it no longer exists");

        let cut = folder.path().join(".discarded-walk");
        fs::create_dir_all(cut.join("segments")).expect("folder");
        finish_discards(folder.path());
        assert!(!cut.exists());
    }
}
