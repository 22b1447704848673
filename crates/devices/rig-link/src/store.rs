//! The folder of sessions, as served.
//!
//! ```text
//! ROOT/NAME/            a session: it has a folder segments/
//! ROOT/receipts/        the hosts' receipts, one file per session; kept when the session is removed
//! ROOT/.freeing-NAME/   a session that is being removed; finished at the next start after a power cut
//! ```
//!
//! Contract: a session and a file are found by their whole name in a listing, never by a path
//! composed of client input. Links are not followed and not listed. Hashes are computed by reading
//! a file once and cached in memory until the file changes (length, times or inode). A session is
//! removed only if its stored receipt has the list hash of the files on disk, every file is still
//! the one that was hashed, and its folder contains nothing else. Sessions being recorded are
//! excluded by the server, not here.
//!
//! All functions access the disk and may block.

mod free;
mod hashes;
mod listing;
mod receipts;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use session_archive::layout;
use session_archive::manifest::{Manifest, ManifestError, State};
use session_archive::reader::SessionReader;
use session_archive::storage::DiskStorage;
use session_archive::text::shown;

use self::hashes::Hashes;
use crate::link::{self, Code, FileEntry, Problem, SessionState, SessionSummary, Total};

pub use self::listing::{ListedFile, Listing, Stamp};
pub use self::receipts::RECEIPTS;

/// The folder of sessions.
pub struct Store {
    root: PathBuf,
    hashes: Hashes,
}

/// An existing session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Session {
    /// Its name, as found in the folder.
    pub name: String,
    /// Its folder.
    pub folder: PathBuf,
}

impl Store {
    /// The sessions below `root`. Finishes interrupted removals.
    pub fn new(root: PathBuf) -> Self {
        free::finish(&root);
        Self {
            root,
            hashes: Hashes::default(),
        }
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// All sessions, by name; empty if the folder does not exist yet.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn sessions(&self) -> io::Result<Vec<Session>> {
        let entries = match fs::read_dir(&self.root) {
            Ok(entries) => entries,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(e) => return Err(e),
        };
        let mut sessions = Vec::new();
        for entry in entries {
            let entry = entry?;
            let Ok(name) = entry.file_name().into_string() else {
                continue;
            };
            let folder = entry.path();
            let segments = fs::symlink_metadata(folder.join(layout::SEGMENTS));
            if link::is_session_name(&name)
                && entry.file_type()?.is_dir()
                && segments.is_ok_and(|s| s.is_dir())
            {
                sessions.push(Session { name, folder });
            }
        }
        sessions.sort_by(|a, b| a.name.cmp(&b.name));
        self.hashes.retain(&sessions);
        Ok(sessions)
    }

    /// The session with exactly this name.
    ///
    /// # Errors
    /// It does not exist, or an I/O error occurs.
    pub fn session(&self, name: &str) -> Result<Session, Problem> {
        let sessions = self.sessions().map_err(|e| unreadable(&e))?;
        let found = sessions.into_iter().find(|s| s.name == name);
        found.ok_or_else(|| problem(Code::NotFound, "there is no session with this name"))
    }

    /// The list entry of a session.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn summary(&self, session: &Session, recording: bool) -> io::Result<SessionSummary> {
        let listing = listing::list(&session.folder)?;
        let storage = Arc::new(DiskStorage::new(&session.folder));
        // Without a readable manifest the segments still contain the identifier.
        let (manifest, readable) = match Manifest::read(&*storage) {
            Ok(manifest) => (Some(manifest), true),
            Err(ManifestError::TooNew { .. }) => (None, false),
            Err(_) => {
                let reader = SessionReader::open(storage).ok();
                (reader.map(|r| r.manifest().clone()), false)
            }
        };
        let state = match &manifest {
            _ if recording => SessionState::Recording,
            Some(manifest) if readable => match manifest.state {
                State::Recording => SessionState::Interrupted,
                State::Closed => SessionState::Closed,
                State::Recovered => SessionState::Recovered,
            },
            _ => SessionState::Damaged,
        };
        Ok(SessionSummary {
            name: session.name.clone(),
            session_id: manifest.as_ref().map(|m| m.session_id.clone()),
            title: manifest
                .as_ref()
                .map_or_else(String::new, |m| shown(&m.name).into_owned()),
            state,
            started_ns: manifest.as_ref().map(|m| m.started_civil.0),
            bytes: listing.files.iter().map(|f| f.stamp.bytes).sum(),
            files: listing.files.len() as u64,
            receipt: self.receipt(&session.name),
        })
    }

    /// The files of a session.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn files(&self, session: &Session) -> Result<Vec<ListedFile>, Problem> {
        let listing = listing::list(&session.folder).map_err(|e| unreadable(&e))?;
        Ok(listing.files)
    }

    /// The file of a session with exactly this path, opened.
    ///
    /// # Errors
    /// It does not exist, or an I/O error occurs.
    pub fn open(&self, session: &Session, path: &str) -> Result<(fs::File, ListedFile), Problem> {
        let listed = self.files(session)?.into_iter().find(|f| f.path == path);
        let listed = listed
            .ok_or_else(|| problem(Code::NotFound, "the session has no file with this path"))?;
        let (file, stamp) =
            listing::open(&session.folder, &listed.path).map_err(|e| unreadable(&e))?;
        Ok((file, ListedFile { stamp, ..listed }))
    }

    /// A file with its hash; reads the file unless the hash is known. `pace` is called with the
    /// bytes of each read, and may block.
    ///
    /// # Errors
    /// An I/O error occurs, or the file changes while it is read.
    pub fn hash(
        &self,
        session: &Session,
        listed: &ListedFile,
        pace: &dyn Fn(usize),
    ) -> Result<FileEntry, Problem> {
        let entry = self.hashes.of(session, listed, pace);
        entry.map_err(|e| unreadable(&e))
    }

    /// Totals of the session's current files.
    ///
    /// # Errors
    /// [`Code::ManifestFirst`] if a hash is not known, [`Code::NotListed`] if the folder contains
    /// an unlistable entry, or an I/O error occurs.
    pub(crate) fn known_total(&self, session: &Session) -> Result<Total, Problem> {
        let listing = listing::list(&session.folder).map_err(|e| unreadable(&e))?;
        if let Some(stranger) = listing.unlistable.first() {
            return Err(problem(
                Code::NotListed,
                &format!("the session's folder holds {stranger:?}, which cannot be listed"),
            ));
        }
        let entries = listing.files.iter();
        let entries = entries.map(|listed| self.hashes.known(session, listed));
        let entries: Option<Vec<FileEntry>> = entries.collect();
        let entries = entries.ok_or_else(|| {
            problem(
                Code::ManifestFirst,
                "not all files of the session are hashed; fetch its manifest, then ask again",
            )
        })?;
        Ok(link::total(&entries))
    }
}

/// A problem with this text.
pub(crate) fn problem(code: Code, message: &str) -> Problem {
    Problem {
        code,
        message: message.to_owned(),
    }
}

/// Response to an I/O error. The path is only logged, not sent to the client.
fn unreadable(error: &io::Error) -> Problem {
    log::warn!("serving a session: {error}");
    problem(Code::Io, &format!("the rig reports an I/O error: {error}"))
}

#[cfg(test)]
mod tests;
