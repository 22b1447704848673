//! The session that a command works on: one of the library, or any folder.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};

use session_archive::layout;

use crate::catalogue::Row;
use crate::library::{CATALOGUE, INCOMING, Library, SESSIONS};
use crate::session_search::is_session;
use crate::validation::Validation;

/// A session that a command works on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    /// Its folder.
    pub folder: PathBuf,
    /// The library that lists it, and its key there.
    listed: Option<(PathBuf, String)>,
}

impl Target {
    /// Finds a session by `text`: a folder that holds a session, else a session of the library.
    ///
    /// # Errors
    /// `text` is neither, or no library was given.
    pub fn find(text: &str, library: Option<&Path>) -> Result<Self> {
        let mut folder = Path::new(text);
        // A path of a file of the session, as `paws handoff` prints one, selects the session.
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
                "{text:?} is not a folder, and to find it in a library, --library or \
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

    /// Path of a derived file in its folder.
    ///
    /// # Errors
    /// No library lists it, so the folder may be the recorder's; `otherwise` states what to do.
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

    /// Display name: its key, or its folder.
    pub fn name(&self) -> String {
        match &self.listed {
            Some((_, key)) => key.clone(),
            None => self.folder.display().to_string(),
        }
    }

    /// Stores a validation in its folder if a library lists it, and in the catalogue. If the
    /// library's disk is full or cannot be written, the verdict is only printed, and a warning is
    /// given.
    ///
    /// # Errors
    /// Another I/O error occurs.
    pub fn keep(&self, validation: &Validation) -> Result<()> {
        if !self.is_listed() {
            return Ok(());
        }
        match validation.write(&self.folder) {
            Ok(()) => self.refresh().map(drop),
            Err(e) if cannot_write(&e) => {
                // The partial file is useless.
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

    /// Updates the catalogue of its library.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn refresh(&self) -> Result<Option<Row>> {
        match &self.listed {
            Some((root, key)) => Library::open(root)?.refresh(key).map(Some),
            None => Ok(None),
        }
    }
}

/// Whether an error means that nothing can be written: no space, no permission.
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

/// The library whose `sessions/` contains a folder.
fn listed(folder: &Path) -> Option<(PathBuf, String)> {
    let key = folder.file_name()?.to_str()?;
    let sessions = folder.parent()?;
    let root = sessions.parent()?;
    // The catalogue may be missing; it is a cache.
    let is_library = root.join(CATALOGUE).is_file() || root.join(INCOMING).is_dir();
    (sessions.file_name()? == SESSIONS && is_library).then(|| (root.to_owned(), key.to_owned()))
}
