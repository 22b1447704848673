//! A library: the folder that holds imported sessions.
//!
//! ```text
//! LIBRARY/
//!   sessions/ID/            one session: what was recorded, import.json, derived files
//!   sessions/ID.recovered/  its recovered copy, where there is one
//!   .incoming/              what is being written; nothing in it is listed
//!   catalogue.sqlite        a copy of the facts, for listing; can be rebuilt
//! ```
//!
//! A session appears under `sessions/` by one rename, complete and on disk, or not at all. Opening a
//! library brings its catalogue up to date with the folders that are there, so a program that was
//! killed between the rename and the catalogue leaves nothing half listed.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use rustix::fs::{FlockOperation, flock};
use session_archive::layout;
use session_archive::storage::{DiskStorage, Storage};

use crate::catalogue::{Catalogue, Row};

/// Folder of the sessions.
pub const SESSIONS: &str = "sessions";
/// Folder of what is being written.
pub const INCOMING: &str = ".incoming";
/// The catalogue.
pub const CATALOGUE: &str = "catalogue.sqlite";
/// Locked by whoever changes the library.
const LOCK: &str = ".lock";
/// Files that a host makes beside a recording and can make again.
pub const DERIVED: [&str; 4] = [
    layout::INDEX,
    layout::VALIDATION,
    layout::HANDOFF,
    crate::validation::REPORT,
];
/// What the session is called that was recorded last; of several recorded at one time, the one imported last.
pub const LATEST: &str = "latest";
/// What a recovered copy's folder has behind the session's identifier.
pub const RECOVERED: &str = ".recovered";

/// An open library.
pub struct Library {
    root: PathBuf,
    catalogue: Catalogue,
}

/// While it exists no other program changes the library. Let go of when it is dropped, and by the
/// system when the program dies.
pub struct Lock {
    _file: File,
}

impl Library {
    /// Opens the library in a folder, which is created if need be.
    ///
    /// # Errors
    /// The disk says no.
    pub fn create(root: &Path) -> Result<Self> {
        let storage = DiskStorage::new(root);
        for folder in [SESSIONS, INCOMING] {
            // Unlike the system's own call it makes the names durable, the root's too.
            (storage.create_dir(folder))
                .with_context(|| format!("making the library: {}", root.join(folder).display()))?;
        }
        Self::open(root)
    }

    /// Opens the library in a folder.
    ///
    /// # Errors
    /// The folder is no library, or the disk says no.
    pub fn open(root: &Path) -> Result<Self> {
        ensure!(
            root.join(SESSIONS).is_dir(),
            "this is no library, it has no folder {SESSIONS}/ (`paws import` makes one): {}",
            root.display()
        );
        let root = root
            .canonicalize()
            .with_context(|| format!("opening the library: {}", root.display()))?;
        let catalogue = Catalogue::open(&root.join(CATALOGUE))?;
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

    /// Folder in which something called `key` is written before it becomes a session.
    pub fn incoming(&self, key: &str) -> PathBuf {
        self.root.join(INCOMING).join(key)
    }

    /// Keeps other programs from changing the library.
    ///
    /// # Errors
    /// Another one is changing it.
    pub fn lock(&self) -> Result<Lock> {
        let path = self.root.join(LOCK);
        let file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .with_context(|| format!("locking the library: {}", path.display()))?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => Ok(Lock { _file: file }),
            Err(rustix::io::Errno::WOULDBLOCK) => bail!(
                "another paws is changing this library; wait for it: {}",
                self.root.display()
            ),
            Err(e) => Err(io::Error::from(e))
                .with_context(|| format!("locking the library: {}", path.display())),
        }
    }

    /// Names of the sessions' folders, sorted.
    ///
    /// # Errors
    /// The disk says no.
    pub fn keys(&self) -> Result<BTreeSet<String>> {
        let folder = self.root.join(SESSIONS);
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

    /// All sessions, the oldest first.
    ///
    /// # Errors
    /// The disk says no.
    pub fn rows(&self) -> Result<Vec<Row>> {
        Ok(self.catalogue.rows()?)
    }

    /// Reads a session's facts from its folder into the catalogue again.
    ///
    /// # Errors
    /// The session cannot be read, or the disk says no.
    pub fn refresh(&mut self, key: &str) -> Result<Row> {
        let folder = self.folder(key);
        let row = Row::of(key, &folder)
            .with_context(|| format!("reading the session: {}", folder.display()))?;
        self.catalogue.put(&row)?;
        Ok(row)
    }

    /// Takes a session out of the catalogue.
    ///
    /// # Errors
    /// The disk says no.
    pub fn forget(&mut self, key: &str) -> Result<()> {
        Ok(self.catalogue.remove(key)?)
    }

    /// Builds the catalogue from the folders alone; gives the number of sessions, and the folders
    /// that are none.
    ///
    /// # Errors
    /// The disk says no; the old catalogue stays.
    pub fn rebuild(&mut self) -> Result<(usize, Vec<(String, String)>)> {
        let (mut rows, mut failed) = (Vec::new(), Vec::new());
        for key in self.keys()? {
            match Row::of(&key, &self.folder(&key)) {
                Ok(row) => rows.push(row),
                Err(e) => failed.push((key, format!("{:#}", anyhow::Error::from(e)))),
            }
        }
        self.catalogue.replace(&rows)?;
        Ok((rows.len(), failed))
    }

    /// The session that a user means: its key, a prefix of it that fits no other, its name, or
    /// the name of the folder that it was imported from. A prefix that fits a session and its
    /// recovered copy means the copy; [`LATEST`] is the one that was recorded last.
    ///
    /// # Errors
    /// None or several fit, or the text is empty.
    pub fn find(&self, text: &str) -> Result<String> {
        ensure!(!text.is_empty(), "which session? its name is empty");
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
                    "looking for the latest session: there is none; `paws import` brings some: {}",
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
        match fits[..] {
            [one] => Ok(one.to_owned()),
            [one, copy] if copy.strip_prefix(one) == Some(RECOVERED) => Ok(copy.to_owned()),
            [] => bail!(
                "looking for session {text:?}: none of the {} in the library begins with that or \
                 is called so (`paws list` shows them): {}",
                rows.len(),
                self.root.display()
            ),
            _ => bail!(
                "looking for session {text:?}: {} fit, among them {}; give more of the one meant: {}",
                fits.len(),
                fits[..fits.len().min(3)].join(", "),
                self.root.display()
            ),
        }
    }

    /// Brings the catalogue up to date with the folders that are there.
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

/// Whether a session identifier can be the name of a folder here and nowhere else.
pub fn is_key(text: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-_.".contains(&b);
    (1..=100).contains(&text.len()) && !text.starts_with('.') && text.bytes().all(plain)
}

/// Makes the names in a folder durable.
///
/// # Errors
/// The disk says no.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_cannot_leave_the_library() {
        for good in ["0192aa00-0000-7000-8000-000000000001", "a", "x_1.recovered"] {
            assert!(is_key(good), "{good}");
        }
        for bad in [
            "",
            ".",
            "..",
            ".hidden",
            "a/b",
            "a\\b",
            "a b",
            "\u{e4}",
            &"x".repeat(101),
        ] {
            assert!(!is_key(bad), "{bad}");
        }
    }

    #[test]
    fn one_at_a_time_may_change_a_library() {
        let folder = tempfile::tempdir().unwrap();
        let library = Library::create(folder.path()).unwrap();
        let lock = library.lock().unwrap();
        let error = library.lock().err().unwrap().to_string();
        assert!(error.starts_with("another paws is changing"), "{error}");
        drop(lock);
        library.lock().unwrap();
    }
}
