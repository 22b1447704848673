//! Cache of file hashes.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::Session;
use super::listing::{self, ListedFile, Stamp};
use crate::link::FileEntry;

/// Bytes read and hashed at a time.
const BLOCK: usize = 1 << 20;

/// Known hashes by session and path. That of a changed file is ignored.
#[derive(Default)]
pub(super) struct Hashes(Mutex<BTreeMap<String, SessionHashes>>);

/// Hashes of one session's files by path, each with the file's stamp at that time.
type SessionHashes = BTreeMap<String, (Stamp, String)>;

impl Hashes {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, SessionHashes>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Forgets sessions that no longer exist.
    pub(super) fn retain(&self, sessions: &[Session]) {
        let there = |name: &str| {
            let found = sessions.binary_search_by(|s| s.name.as_str().cmp(name));
            found.is_ok()
        };
        self.lock().retain(|name, _| there(name));
    }

    /// A file with its hash, if known.
    pub(super) fn known(&self, session: &Session, listed: &ListedFile) -> Option<FileEntry> {
        let lock = self.lock();
        let (stamp, blake3) = lock.get(&session.name)?.get(&listed.path)?;
        (*stamp == listed.stamp).then(|| entry(listed, blake3.clone()))
    }

    /// A file with its hash; the file is read unless the hash is known.
    pub(super) fn of(
        &self,
        session: &Session,
        listed: &ListedFile,
        pace: &dyn Fn(usize),
    ) -> io::Result<FileEntry> {
        if let Some(known) = self.known(session, listed) {
            return Ok(known);
        }
        let changed = || io::Error::other(format!("{} changes while it is read", listed.path));
        let (mut file, before) = listing::open(&session.folder, &listed.path)?;
        if before != listed.stamp {
            return Err(changed());
        }
        let mut hasher = blake3::Hasher::new();
        let mut block = vec![0; BLOCK];
        loop {
            match file.read(&mut block) {
                Ok(0) => break,
                Ok(n) => {
                    hasher.update(&block[..n]);
                    pace(n);
                }
                Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
                Err(e) => return Err(e),
            }
        }
        let blake3 = hasher.finalize().to_hex().to_string();
        let (_, after) = listing::open(&session.folder, &listed.path)?;
        if after != before {
            return Err(changed());
        }
        let files = &mut *self.lock();
        let files = files.entry(session.name.clone()).or_default();
        files.insert(listed.path.clone(), (after, blake3.clone()));
        Ok(entry(listed, blake3))
    }
}

fn entry(listed: &ListedFile, blake3: String) -> FileEntry {
    FileEntry {
        path: listed.path.clone(),
        bytes: listed.stamp.bytes,
        modified_ns: listed.stamp.modified_ns,
        blake3,
    }
}
