//! Which session a verb is about: one of the library's, or any folder.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};

use session_archive::layout;

use crate::catalogue::Row;
use crate::library::{CATALOGUE, INCOMING, Library, SESSIONS};
use crate::session_search::is_session;
use crate::validation::Validation;

/// A session that a verb works on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    /// Its folder.
    pub folder: PathBuf,
    /// The library that lists it, and its key there.
    listed: Option<(PathBuf, String)>,
}

impl Target {
    /// The session that a user means by `text`: a folder if it is one that holds a session, else
    /// something that the library knows.
    ///
    /// # Errors
    /// It is neither, or no library was given.
    pub fn find(text: &str, library: Option<&Path>) -> Result<Self> {
        let mut folder = Path::new(text);
        // A file of the session, as `paws handoff` prints one, means the session.
        if let Some(parent) = folder.parent()
            && folder.is_file()
            && is_session(parent)
        {
            folder = match parent.as_os_str().is_empty() {
                true => Path::new("."),
                false => parent,
            };
        }
        if is_session(folder) {
            let folder = folder
                .canonicalize()
                .with_context(|| format!("opening the session: {text}"))?;
            return Ok(Self {
                listed: listed(&folder),
                folder,
            });
        }
        if folder.is_dir() {
            bail!("this folder holds no session: {text}");
        }
        let Some(root) = library else {
            bail!(
                "{text:?} is no folder, and to look for it in a library, --library or \
                 PAWS_LIBRARY must say which"
            );
        };
        let library = Library::open(root)?;
        let key = library.find(text)?;
        Ok(Self {
            folder: library.folder(&key),
            listed: Some((library.root().to_owned(), key)),
        })
    }

    /// Whether a library lists it, so that derived files may be put beside it.
    pub fn is_listed(&self) -> bool {
        self.listed.is_some()
    }

    /// Where to put a derived file beside it.
    ///
    /// # Errors
    /// No library lists it, so the folder is the recorder's or somebody else's; `otherwise` says what
    /// to do.
    pub fn derived(&self, file: &str, otherwise: &str) -> Result<PathBuf> {
        ensure!(
            self.is_listed(),
            "{file} goes only beside sessions of a library, and this one is in none; {otherwise}: {}",
            self.folder.display()
        );
        Ok(self.folder.join(file))
    }

    /// Its key in the library that lists it, with the library's folder.
    pub fn key(&self) -> Option<(&Path, &str)> {
        self.listed
            .as_ref()
            .map(|(root, key)| (root.as_path(), key.as_str()))
    }

    /// How to call it: its key, or its folder.
    pub fn name(&self) -> String {
        match &self.listed {
            Some((_, key)) => key.clone(),
            None => self.folder.display().to_string(),
        }
    }

    /// Puts a verdict beside it if a library lists it, and into the catalogue. Where the library's disk is full or cannot
    /// be written at all, the verdict is only what was printed, and a warning says so.
    ///
    /// # Errors
    /// The disk fails otherwise.
    pub fn keep(&self, validation: &Validation) -> Result<()> {
        if !self.is_listed() {
            return Ok(());
        }
        match validation.write(&self.folder) {
            Ok(()) => self.refresh().map(drop),
            Err(e) if cannot_write(&e) => {
                // What came of it so far is of no use.
                let half = format!("{}.tmp", layout::VALIDATION);
                let _ = std::fs::remove_file(self.folder.join(half));
                log::warn!(
                    "the verdict is not stored: {e:#}: {}",
                    self.folder.display()
                );
                Ok(())
            }
            Err(e) => Err(e),
        }
    }

    /// Brings the catalogue of its library up to date.
    ///
    /// # Errors
    /// The disk says no.
    pub fn refresh(&self) -> Result<Option<Row>> {
        match &self.listed {
            Some((root, key)) => Library::open(root)?.refresh(key).map(Some),
            None => Ok(None),
        }
    }
}

/// Whether nothing can be written there, whatever it is: no room, no rights.
fn cannot_write(error: &anyhow::Error) -> bool {
    let kinds = error.chain().filter_map(|e| e.downcast_ref::<io::Error>());
    kinds.map(io::Error::kind).any(|kind| {
        matches!(
            kind,
            ErrorKind::StorageFull
                | ErrorKind::QuotaExceeded
                | ErrorKind::FileTooLarge
                | ErrorKind::ReadOnlyFilesystem
                | ErrorKind::PermissionDenied
        )
    })
}

/// The library in whose `sessions/` a folder lies.
fn listed(folder: &Path) -> Option<(PathBuf, String)> {
    let key = folder.file_name()?.to_str()?;
    let sessions = folder.parent()?;
    let root = sessions.parent()?;
    // The catalogue may be missing; it is a copy.
    let is_library = root.join(CATALOGUE).is_file() || root.join(INCOMING).is_dir();
    (sessions.file_name()? == SESSIONS && is_library).then(|| (root.to_owned(), key.to_owned()))
}
