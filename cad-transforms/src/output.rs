//! Writing a file without losing another.
//!
//! Contract: a file that exists stays as it is unless the caller said otherwise, and then it is exchanged
//! in one step: whoever reads it finds the old bytes or the new ones. After [`write`] returned, the bytes are on disk.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// What to do where a file is there already.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Existing {
    /// Leave it and fail.
    #[default]
    Refuse,
    /// Exchange it.
    Replace,
}

/// Why a file was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// There is one: choose another name, or say that it may go.
    #[error("writing a file: there is one already, and it was left as it is: {}", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The system refused.
    #[error("writing a file: {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// Writes a file whole.
///
/// # Errors
/// [`WriteError`]. What was there before is as it was.
pub fn write(path: &Path, bytes: &[u8], existing: Existing) -> Result<(), WriteError> {
    let wrap = |source: io::Error| match source.kind() {
        io::ErrorKind::AlreadyExists => WriteError::Exists {
            path: path.to_owned(),
        },
        _ => WriteError::Io {
            path: path.to_owned(),
            source,
        },
    };
    let mut beside = path.as_os_str().to_owned();
    beside.push(".part");
    let beside = PathBuf::from(beside);
    let target = match existing {
        Existing::Refuse => path,
        Existing::Replace => &beside,
    };
    let mut options = OpenOptions::new();
    match existing {
        Existing::Refuse => options.write(true).create_new(true),
        Existing::Replace => options.write(true).create(true).truncate(true),
    };
    let file = options.open(target).map_err(wrap)?;
    let written = fill(file, bytes).and_then(|()| match existing {
        Existing::Refuse => Ok(()),
        Existing::Replace => std::fs::rename(&beside, path),
    });
    if let Err(source) = written {
        // Ours and incomplete; that it cannot be removed is no second error.
        let _ = std::fs::remove_file(target);
        return Err(wrap(source));
    }
    Ok(())
}

fn fill(mut file: File, bytes: &[u8]) -> io::Result<()> {
    file.write_all(bytes)?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_overwritten_unless_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        write(&path, b"first", Existing::Refuse).unwrap();
        let error = write(&path, b"second", Existing::Refuse).unwrap_err();
        assert!(matches!(error, WriteError::Exists { .. }), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        write(&path, b"second", Existing::Replace).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"second");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);

        let missing = folder.path().join("no/such/folder.toml");
        let error = write(&missing, b"", Existing::Replace).unwrap_err();
        assert!(error.to_string().contains("no/such/folder.toml"), "{error}");
    }
}
