//! The folder of a session, in a library or anywhere else.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use session_archive::layout;

/// Folder of the sessions in a library.
pub const SESSIONS: &str = "sessions";
/// Folder of sessions being written in a library.
pub const INCOMING: &str = ".incoming";
/// The catalogue in a library.
pub const CATALOGUE: &str = "catalogue.sqlite";

/// The folder of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionFolder {
    /// Its path.
    pub folder: PathBuf,
    /// The library that lists it, and its key there.
    listed: Option<(PathBuf, String)>,
}

impl SessionFolder {
    /// The session of the library in `root` with this key.
    pub fn of_library(root: &Path, key: String) -> Self {
        Self {
            folder: root.join(SESSIONS).join(&key),
            listed: Some((root.to_owned(), key)),
        }
    }

    /// The session that the path `text` names: its folder, or a file in it. `None` if `text` is
    /// neither and no folder at all.
    ///
    /// # Errors
    /// `text` is a folder without a session.
    pub fn at(text: &str) -> Result<Option<Self>> {
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
            return Ok(Some(Self {
                listed: listed(&folder),
                folder,
            }));
        }
        if folder.is_dir() {
            bail!("this folder holds no session: {text}");
        }
        Ok(None)
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
}

/// Whether a folder holds a session, damaged or not.
pub fn is_session(folder: &Path) -> bool {
    let segments = folder.join(layout::SEGMENTS);
    segments.is_dir()
        && (folder.join(layout::MANIFEST).is_file()
            || std::fs::read_dir(&segments).is_ok_and(|entries| {
                entries.flatten().any(|entry| {
                    let name = entry.file_name();
                    name.to_str().and_then(layout::segment_number).is_some()
                })
            }))
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
