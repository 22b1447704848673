//! Removal of a session that a host holds.

use std::fs;
use std::io;
use std::path::Path;

use session_archive::storage::{DiskStorage, Storage};

use super::{Session, Store, problem, unreadable};
use crate::link::{Code, Problem};

/// Name prefix of a session's folder while it is being removed.
const FREEING: &str = ".freeing-";

impl Store {
    /// Removes a session with a matching stored receipt. It disappears by one rename, which is
    /// synced before the first byte is deleted.
    ///
    /// # Errors
    /// [`Code::NoReceipt`], [`Code::ListDiffers`], [`Code::ManifestFirst`], [`Code::NotListed`] or
    /// [`Code::Io`]; the session is then complete, unless an I/O error interrupted the removal:
    /// then it is no longer listed, and the rest is removed at the next start.
    pub fn free(&self, session: &Session) -> Result<(), Problem> {
        let receipt = self.receipt(&session.name).ok_or_else(|| {
            problem(
                Code::NoReceipt,
                "no host has sent a receipt for this session",
            )
        })?;
        self.fits(session, &receipt)?;
        let removed = self.root.join(format!("{FREEING}{}", session.name));
        let remove = || {
            match fs::remove_dir_all(&removed) {
                Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
                _ => fs::rename(&session.folder, &removed)?,
            }
            DiskStorage::new(&self.root).sync_dir("")?;
            fs::remove_dir_all(&removed)
        };
        remove().map_err(|e| unreadable(&e))?;
        log::info!(
            "session {} freed: {} holds it ({} bytes)",
            session.name,
            receipt.host,
            receipt.bytes
        );
        Ok(())
    }
}

/// Finishes removals that were interrupted.
pub(super) fn finish(root: &Path) {
    let Ok(entries) = fs::read_dir(root) else {
        return;
    };
    for entry in entries.flatten() {
        let ours = entry
            .file_name()
            .as_encoded_bytes()
            .starts_with(FREEING.as_bytes());
        if ours && entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            let path = entry.path();
            if let Err(e) = fs::remove_dir_all(&path) {
                log::warn!("removing a freed session: {e}: {}", path.display());
            }
        }
    }
}
