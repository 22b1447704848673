//! A library: the folder that holds imported sessions.
//!
//! ```text
//! LIBRARY/
//!   sessions/ID/            one session: what was recorded, import.json, derived files
//!   sessions/ID.recovered/  its recovered copy, where there is one
//!   sessions/ID.damaged/    a damaged copy that was replaced by a better one
//!   .incoming/              sessions being written; not listed
//!   catalogue.sqlite        a copy of the facts, for listing; can be rebuilt
//! ```
//!
//! A session appears under `sessions/` by one rename, complete and synced, or not at all. Opening a
//! library updates its catalogue from the existing folders, so a program killed between the rename
//! and the catalogue leaves no session unlisted.
//!
//! * **Nothing can be written** (a full disk, a read-only one): everything can be read. Changes of
//!   the catalogue are held in memory.
//! * **The catalogue is damaged, of another version or not there**: the next program that opens the
//!   library renames it to `catalogue.sqlite.damaged` and rebuilds it from the sessions; while
//!   another program changes the library, the sessions are listed from their folders.
//! * **Several programs**: one at a time changes a library, under a lock that the system releases
//!   when the program dies. Creating and repairing the catalogue is such a change.

mod lock;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use session_access::{CATALOGUE, INCOMING, SESSIONS};
use session_archive::storage::{DiskStorage, Storage};

use crate::catalogue::{Catalogue, CatalogueFile, Row};
use crate::session_key::{RECOVERED, is_key, is_set_aside_copy};

pub use self::lock::Lock;
pub use crate::derived_files::DERIVED;

/// Name for the last recorded session; of several recorded at one time, the last imported.
pub const LATEST: &str = "latest";

/// An open library.
pub struct Library {
    root: PathBuf,
    catalogue: Catalogue,
}

impl Library {
    /// Opens the library in a folder, which is created if necessary.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn create(root: &Path) -> Result<Self> {
        let storage = DiskStorage::new(root);
        for folder in [SESSIONS, INCOMING] {
            // Unlike the system call, it syncs the names, the root's too.
            (storage.create_dir(folder))
                .with_context(|| format!("making the library: {}", root.join(folder).display()))?;
        }
        Self::open(root)
    }

    /// Opens the library in a folder.
    ///
    /// # Errors
    /// The folder is not a library, or an I/O error occurs.
    pub fn open(root: &Path) -> Result<Self> {
        ensure!(
            root.join(SESSIONS).is_dir(),
            "not a library, it has no folder {SESSIONS}/ (`paws import` creates one): {}",
            root.display()
        );
        let root = root
            .canonicalize()
            .with_context(|| format!("opening the library: {}", root.display()))?;
        let path = root.join(CATALOGUE);
        let catalogue = match Catalogue::inspect(&path)? {
            CatalogueFile::Usable(catalogue) => *catalogue,
            CatalogueFile::Unreachable(why) => {
                log::debug!("listing from the folders: {why}: {}", path.display());
                Catalogue::in_memory(&path)?
            }
            CatalogueFile::Missing | CatalogueFile::Unusable(_) => match lock::take(&root, false) {
                Ok(Some(_lock)) => repair_catalogue(&root)?,
                // A program that changes the library repairs it, too. Without a lock nothing can be
                // written.
                Ok(None) | Err(_) => Catalogue::in_memory(&path)?,
            },
        };
        let mut library = Self { root, catalogue };
        library.catch_up()?;
        Ok(library)
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Folder of a session.
    pub fn folder(&self, key: &str) -> PathBuf {
        self.root.join(SESSIONS).join(key)
    }

    /// Folder in which the session `key` is written before it is published.
    pub fn incoming(&self, key: &str) -> PathBuf {
        self.root.join(INCOMING).join(key)
    }

    /// Locks the library against changes by other programs.
    ///
    /// # Errors
    /// Another program has locked it.
    pub fn lock(&mut self) -> Result<Lock> {
        let locking = || format!("locking the library: {}", self.root.display());
        let Some(lock) = lock::take(&self.root, false).with_context(locking)? else {
            bail!(
                "another paws is changing this library; wait for it: {}",
                self.root.display()
            );
        };
        self.reload_catalogue()?;
        Ok(lock)
    }

    /// Locks the library against changes by other programs, and waits for the lock. `waiting` is
    /// called before a wait.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn lock_waiting(&mut self, waiting: impl FnOnce(&Path)) -> Result<Lock> {
        let locking = || format!("locking the library: {}", self.root.display());
        let lock = match lock::take(&self.root, false).with_context(locking)? {
            Some(lock) => lock,
            None => {
                waiting(&self.root);
                lock::take(&self.root, true)
                    .with_context(locking)?
                    .with_context(locking)?
            }
        };
        self.reload_catalogue()?;
        Ok(lock)
    }

    /// Reloads the catalogue after changes by previous lock holders.
    fn reload_catalogue(&mut self) -> Result<()> {
        self.catalogue = repair_catalogue(&self.root)?;
        self.catalogue.leave_wal_mode();
        self.catch_up()
    }

    /// Names of the sessions' folders, sorted.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn keys(&self) -> Result<BTreeSet<String>> {
        keys_of(&self.root)
    }

    /// All sessions, the oldest first.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn rows(&self) -> Result<Vec<Row>> {
        Ok(self.catalogue.rows()?)
    }

    /// Updates a session's row in the catalogue from its folder.
    ///
    /// # Errors
    /// The session cannot be read, or an I/O error occurs.
    pub fn refresh(&mut self, key: &str) -> Result<Row> {
        let folder = self.folder(key);
        let row = Row::of(key, &folder)
            .with_context(|| format!("reading the session: {}", folder.display()))?;
        self.catalogue.put(&row)?;
        Ok(row)
    }

    /// Removes a session from the catalogue.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn forget(&mut self, key: &str) -> Result<()> {
        Ok(self.catalogue.remove(key)?)
    }

    /// Rebuilds the catalogue from the folders alone; returns the number of sessions, and the
    /// folders that hold none.
    ///
    /// # Errors
    /// The folders cannot be read; the old catalogue is then unchanged.
    pub fn rebuild(&mut self) -> Result<(usize, Vec<(String, String)>)> {
        let (rows, failed) = rows_of_folders(&self.root)?;
        self.catalogue.replace(&rows)?;
        Ok((rows.len(), failed))
    }

    /// Finds a session by its key, a unique prefix of it, its name, or the name of the folder that
    /// it was imported from. A prefix that matches a session and its recovered copy selects the
    /// copy, unless the session is complete; [`LATEST`] selects the last recorded one.
    ///
    /// # Errors
    /// None or several match, or the text is empty.
    pub fn find(&self, text: &str) -> Result<String> {
        ensure!(!text.is_empty(), "the session's name is empty");
        let rows = self.rows()?;
        if let Some(row) = rows.iter().find(|r| r.key == text) {
            return Ok(row.key.clone());
        }
        if text == LATEST {
            let newest = rows
                .iter()
                .max_by_key(|r| (r.started_civil.0, r.imported.map(|t| t.0), &r.key));
            return match newest {
                Some(row) => Ok(row.key.clone()),
                None => bail!(
                    "looking for the latest session: there is none; `paws import` adds sessions: {}",
                    self.root.display()
                ),
            };
        }
        let named = |row: &Row| {
            row.name == text
                || Path::new(&row.source)
                    .file_name()
                    .is_some_and(|n| n == text)
        };
        let mut fits: Vec<&str> = rows
            .iter()
            .filter(|r| named(r) || r.key.starts_with(text))
            .map(|r| r.key.as_str())
            .collect();
        fits.sort_unstable();
        // A replaced copy is found only by its whole key.
        let was_set_aside = |key: &str| fits.iter().any(|other| is_set_aside_copy(key, other));
        let mut fits: Vec<&str> = fits.iter().copied().filter(|k| !was_set_aside(k)).collect();
        let is_whole = |key: &str| {
            let mut rows = rows.iter();
            rows.any(|r| r.key == key && !r.condition.needs_recovery())
        };
        if let [one, copy] = fits[..]
            && copy.strip_prefix(one) == Some(RECOVERED)
        {
            // The recovered copy is not needed if a complete session replaced the damaged one.
            fits.remove(if is_whole(one) { 1 } else { 0 });
        }
        match fits[..] {
            [one] => Ok(one.to_owned()),
            [] => bail!(
                "looking for session {text:?}: none of the {} in the library begins with that or \
                 is called so (`paws list` shows them): {}",
                rows.len(),
                self.root.display()
            ),
            _ => bail!(
                "looking for session {text:?}: {} fit, among them {}; give a longer prefix: {}",
                fits.len(),
                fits[..fits.len().min(3)].join(", "),
                self.root.display()
            ),
        }
    }

    /// Updates the catalogue from the existing folders.
    fn catch_up(&mut self) -> Result<()> {
        let there = self.keys()?;
        let listed: BTreeSet<String> = self.rows()?.into_iter().map(|r| r.key).collect();
        for key in listed.difference(&there) {
            self.forget(key)?;
        }
        for key in there.difference(&listed) {
            if let Err(e) = self.refresh(key) {
                log::warn!("not listed: {e:#}");
            }
        }
        Ok(())
    }
}

/// Names of the sessions' folders, sorted.
fn keys_of(root: &Path) -> Result<BTreeSet<String>> {
    let folder = root.join(SESSIONS);
    let reading = || format!("reading the library: {}", folder.display());
    let mut keys = BTreeSet::new();
    for entry in fs::read_dir(&folder).with_context(reading)? {
        let entry = entry.with_context(reading)?;
        if let (true, Ok(name)) = (entry.path().is_dir(), entry.file_name().into_string())
            && is_key(&name)
        {
            keys.insert(name);
        }
    }
    Ok(keys)
}

/// Folders that hold no session, with the reason.
type NoSessions = Vec<(String, String)>;

/// The rows of all sessions, and the folders that hold none.
fn rows_of_folders(root: &Path) -> Result<(Vec<Row>, NoSessions)> {
    let (mut rows, mut failed) = (Vec::new(), Vec::new());
    for key in keys_of(root)? {
        match Row::of(&key, &root.join(SESSIONS).join(&key)) {
            Ok(row) => rows.push(row),
            Err(e) => failed.push((key, format!("{:#}", anyhow::Error::from(e)))),
        }
    }
    Ok((rows, failed))
}

/// The catalogue of a library, rebuilt from the sessions if it is damaged or missing; in memory if
/// it cannot be written. The caller holds the lock.
fn repair_catalogue(root: &Path) -> Result<Catalogue> {
    let path = root.join(CATALOGUE);
    let why = match Catalogue::inspect(&path)? {
        CatalogueFile::Usable(catalogue) => return Ok(*catalogue),
        CatalogueFile::Unreachable(why) => {
            log::debug!("listing from the folders: {why}: {}", path.display());
            return Ok(Catalogue::in_memory(&path)?);
        }
        CatalogueFile::Missing => None,
        CatalogueFile::Unusable(why) => Some(why),
    };
    let (rows, _) = rows_of_folders(root)?;
    let sessions = console_output::text::count(rows.len() as u64, "session");
    match (Catalogue::make(&path, &rows), why) {
        (Ok((catalogue, aside)), why) => {
            if let Some(aside) = aside {
                log::warn!(
                    "the catalogue could not be used ({}) and was rebuilt, with {sessions}; the old one is now {}",
                    why.unwrap_or_default(),
                    aside.display()
                );
            }
            Ok(catalogue)
        }
        (Err(e), why) => {
            if let Some(why) = why {
                log::warn!(
                    "the catalogue cannot be used ({why}) and cannot be rebuilt here ({e:#}); \
                     listing {sessions} from their folders: {}",
                    path.display()
                );
            }
            let mut catalogue = Catalogue::in_memory(&path)?;
            catalogue.replace(&rows)?;
            Ok(catalogue)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_program_may_change_a_library() {
        let folder = tempfile::tempdir().unwrap();
        let mut library = Library::create(folder.path()).unwrap();
        let mut other = Library::open(folder.path()).unwrap();
        let lock = library.lock().unwrap();
        let error = other.lock().err().unwrap().to_string();
        assert!(error.starts_with("another paws is changing"), "{error}");
        drop(lock);
        other.lock().unwrap();
    }

    #[test]
    fn waiting_for_the_lock_is_reported_and_ends_with_the_other_program() {
        let folder = tempfile::tempdir().unwrap();
        let mut library = Library::create(folder.path()).unwrap();
        let lock = library
            .lock_waiting(|_| panic!("it is not locked"))
            .unwrap();
        let mut other = Library::open(folder.path()).unwrap();
        let (said, reported) = std::sync::mpsc::sync_channel(1);
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| {
                let waiting = |root: &Path| said.send(root.to_owned()).unwrap();
                other.lock_waiting(waiting).map(drop)
            });
            let root = reported.recv().unwrap();
            assert_eq!(root, folder.path().canonicalize().unwrap());
            drop(lock);
            waiting.join().unwrap().unwrap();
        });
    }

    #[test]
    fn catalogue_is_not_created_or_repaired_while_the_library_is_locked() {
        let folder = tempfile::tempdir().unwrap();
        let mut library = Library::create(folder.path()).unwrap();
        let path = folder.path().join(CATALOGUE);
        let lock = library.lock().unwrap();
        fs::write(&path, b"garbage").unwrap();
        let mut other = Library::open(folder.path()).unwrap();
        assert!(other.catalogue.is_in_memory());
        assert_eq!(fs::read(&path).unwrap(), b"garbage");
        drop(lock);
        let _lock = other.lock().unwrap();
        assert!(!other.catalogue.is_in_memory());
        let aside = folder.path().join("catalogue.sqlite.damaged");
        assert_eq!(fs::read(aside).unwrap(), b"garbage");
    }
}
