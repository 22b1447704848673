//! The folder of a session, in a library or anywhere else.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use session_archive::foreign::identify;
use session_archive::layout;
use session_archive::storage::{DiskStorage, Storage};
use session_archive::writer::PROFILE;

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
        if let Some(note) = mcap_note(folder) {
            bail!("no session here: {note}");
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

/// What the MCAP file at a path is, or the first one in that folder, and how it becomes a session;
/// `None` if there is none. For paths that hold no session.
pub fn mcap_note(path: &Path) -> Option<String> {
    let is_mcap = |path: &PathBuf| path.extension().is_some_and(|e| e == "mcap");
    let file = match path.is_dir() {
        true => {
            let entries = std::fs::read_dir(path).ok()?.flatten();
            entries.map(|entry| entry.path()).filter(is_mcap).min()?
        }
        false => path.to_owned(),
    };
    let folder = match file.parent()? {
        parent if parent.as_os_str().is_empty() => Path::new("."),
        parent => parent,
    };
    let opened = DiskStorage::new(folder).open(file.file_name()?.to_str()?);
    let found = identify(&*opened.ok()?).ok()??;
    let remedy = match found.profile == PROFILE {
        true => "a segment is read in its session's folder, below segments/",
        false => {
            "`pawsd record` makes a session of a ROS 2 bag, as a source of kind = \"bag\" (docs/reference/sources.md)"
        }
    };
    Some(format!("{found}; {remedy}: {}", file.display()))
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use session_archive::mcap::{ChunkBuilder, SegmentEncoder};
    use session_archive::record::{Event, Record};

    use super::*;

    #[test]
    fn mcap_of_another_profile_is_named_with_its_content() {
        let folder = tempfile::tempdir().unwrap();
        let (mut encoder, mut bytes) = SegmentEncoder::start("ros2", "rosbag2 0.26");
        let mut chunk = ChunkBuilder::default();
        chunk.schema(1, &Event::SCHEMA);
        chunk.channel(1, 1, "/imu/data", &BTreeMap::new());
        chunk.message(1, 0, 1, 1, |_| {});
        let chunk = chunk.finish();
        encoder.chunk(&chunk).unwrap();
        bytes.extend(chunk);
        bytes.extend(encoder.finish());
        let file = folder.path().join("walk_0.mcap");
        std::fs::write(&file, &bytes).unwrap();
        for path in [file.as_path(), folder.path()] {
            let error = SessionFolder::at(path.to_str().unwrap())
                .unwrap_err()
                .to_string();
            let expected = "an MCAP file of the profile \"ros2\", written by \"rosbag2 0.26\", 1 message, 1 channel: \
                            \"/imu/data\" of \"paws.Event\"";
            assert!(
                error.contains(expected) && error.contains("kind = \"bag\""),
                "{error}"
            );
        }

        // In the place of a segment.
        let session = folder.path().join("session");
        std::fs::create_dir_all(session.join("segments")).unwrap();
        std::fs::write(session.join("segments/000000.mcap"), &bytes).unwrap();
        let error = format!("{:#}", crate::open(&session).err().unwrap());
        assert!(error.contains("the profile \"ros2\""), "{error}");

        // Cut off: it is what its header says.
        std::fs::write(&file, &bytes[..bytes.len() - 3]).unwrap();
        let note = mcap_note(&file).unwrap();
        assert!(note.contains("without an intact summary"), "{note}");
        std::fs::write(&file, b"text").unwrap();
        assert_eq!(mcap_note(&file), None);
    }
}
