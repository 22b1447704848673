//! Opening a hand-off: all checks before anything is read.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use session_archive::handoff::HandOff;
use session_archive::index::Index;
use session_archive::layout;
use session_archive::reader::SessionReader;
use session_archive::storage::DiskStorage;
use session_input::{Session, SessionError};

use super::judgement::notes;
use super::state::State;
use super::{Check, Input, InputError};

impl Input {
    /// As [`Self::open`]; with [`Check::Lengths`] only for a hand-off that was checked before.
    /// `progress` is called with the bytes checked and the bytes to check.
    ///
    /// # Errors
    /// See [`InputError`].
    pub fn open_with(
        path: &Path,
        check: Check,
        mut progress: impl FnMut(u64, u64),
    ) -> Result<Self, InputError> {
        let root = session_folder(path)?;
        let storage = Arc::new(DiskStorage::new(&root));
        let refused = |error| InputError::HandOff {
            path: root.clone(),
            error,
        };
        let mut handoff = HandOff::open(&*storage, Check::Lengths, |_| {}).map_err(refused)?;
        if check == Check::Content {
            let files = handoff.files.iter().chain(&handoff.derived);
            let total = files.map(|f| f.bytes).sum();
            let mut done = 0;
            handoff = HandOff::open(&*storage, Check::Content, |bytes| {
                done += bytes;
                progress(done, total);
            })
            .map_err(refused)?;
        }

        // Before they are read: unsealed files are not parsed.
        for file in [layout::MANIFEST, layout::INDEX] {
            sealed(&handoff, file.to_owned(), &root)?;
        }
        let session = |error| InputError::Session {
            path: root.clone(),
            error,
        };
        let reader = SessionReader::open(storage.clone()).map_err(session)?;
        let manifest = reader.manifest().clone();
        if manifest.session_id != handoff.session_id {
            return Err(InputError::OtherSession {
                sealed: handoff.session_id,
                found: manifest.session_id,
                path: root,
            });
        }
        let unusable = |error| InputError::Index {
            path: root.clone(),
            error,
        };
        let index = Index::read(&reader).map_err(unusable)?;
        for (number, _) in &index.segments {
            sealed(&handoff, layout::segment(*number), &root)?;
        }
        for file in &manifest.rig {
            let file = layout::rig_file(&file.name);
            // A missing segment affected the verdict, which was accepted; it cannot be read.
            let is_missed = handoff.is_accepted() && !root.join(&file).exists();
            if !is_missed {
                sealed(&handoff, file, &root)?;
            }
        }

        let content = Session::open(&*storage, &manifest, index).map_err(|error| match error {
            SessionError::Index(error) => unusable(error),
            SessionError::Format {
                camera,
                what,
                found,
                expected,
            } => InputError::Unknown {
                camera,
                what,
                found,
                expected,
                path: root.clone(),
            },
        })?;
        Ok(Self {
            state: State::read(&reader).map_err(session)?,
            notes: notes(&handoff, &*storage),
            session: content,
            root,
            handoff,
            manifest,
        })
    }
}

/// Session folder of a path.
fn session_folder(path: &Path) -> Result<PathBuf, InputError> {
    let failed = |error| InputError::Path {
        path: path.to_owned(),
        error,
    };
    // Resolved, because a link may lead to the file from anywhere.
    let path = path.canonicalize().map_err(failed)?;
    if path.is_dir() {
        return Ok(path);
    }
    match path.parent() {
        Some(folder) if path.file_name().is_some_and(|name| name == layout::HANDOFF) => {
            Ok(folder.to_owned())
        }
        _ => {
            let expected = format!("expected {} or a session's folder", layout::HANDOFF);
            Err(failed(io::Error::new(
                io::ErrorKind::InvalidInput,
                expected,
            )))
        }
    }
}

fn sealed(handoff: &HandOff, file: String, root: &Path) -> Result<(), InputError> {
    if handoff.names(&file) {
        return Ok(());
    }
    Err(InputError::NotSealed {
        file,
        path: root.to_owned(),
    })
}
