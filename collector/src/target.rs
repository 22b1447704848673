//! The session that a command works on: one of the library, or any folder.

use std::io::{self, ErrorKind};
use std::ops::Deref;
use std::path::Path;

use anyhow::{Result, bail};
use session_access::SessionFolder;
use session_archive::layout;

use crate::catalogue::Row;
use crate::library::Library;
use crate::validation::Validation;

/// A session that a command works on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target(SessionFolder);

impl Deref for Target {
    type Target = SessionFolder;

    fn deref(&self) -> &SessionFolder {
        &self.0
    }
}

impl Target {
    /// Finds a session by `text`: a folder that holds a session, else a session of the library.
    ///
    /// # Errors
    /// `text` is neither, or no library was given.
    pub fn find(text: &str, library: Option<&Path>) -> Result<Self> {
        if let Some(folder) = SessionFolder::at(text)? {
            return Ok(Self(folder));
        }
        let Some(root) = library else {
            bail!(
                "{text:?} is not a folder, and to find it in a library, --library or \
                 PAWS_LIBRARY must say which"
            );
        };
        let library = Library::open(root)?;
        let key = library.find(text)?;
        Ok(Self(SessionFolder::of_library(library.root(), key)))
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
        match self.key() {
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
