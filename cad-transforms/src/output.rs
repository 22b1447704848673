//! Writing a file without losing another.
//!
//! Contract: an existing file is kept unless the caller says otherwise, and is then replaced
//! atomically. The bytes are written beside the file, under a hidden name that is not in use
//! (`.paws-PROCESS-NUMBER.part`), and appear under the name itself when they are complete: a reader
//! finds the old bytes or the new ones. After [`write()`] returned, the bytes and the name are on
//! disk. A program that is killed may leave a hidden file behind.
//!
//! On file systems without hard links (exFAT and the like), a new file is made as an empty one that
//! is exchanged in place: a reader may find it empty for a moment, never in part.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// What to do where a file is there already.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Existing {
    /// Leave it and fail.
    #[default]
    Refuse,
    /// Replace it.
    Replace,
}

/// Why a file was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The file exists: choose another name, or permit its replacement.
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
        /// The error of the operating system.
        source: io::Error,
    },
}

/// Writes a file whole.
///
/// # Errors
/// [`WriteError`]. An existing file is unchanged, unless only the last step failed: putting the new
/// name on disk.
pub fn write(path: &Path, bytes: &[u8], existing: Existing) -> Result<(), WriteError> {
    let io = |source: io::Error| WriteError::Io {
        path: path.to_owned(),
        source,
    };
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let (file, beside) = hidden(folder).map_err(io)?;
    let written = fill(file, bytes).and_then(|()| match existing {
        Existing::Refuse => appear(&beside, path),
        Existing::Replace => fs::rename(&beside, path),
    });
    if written.is_err() || existing == Existing::Refuse {
        // Ours. After a rename it no longer exists, and a failure to remove it is no second error.
        let _ = fs::remove_file(&beside);
    }
    written.map_err(|source| match (existing, source.kind()) {
        (Existing::Refuse, io::ErrorKind::AlreadyExists) => WriteError::Exists {
            path: path.to_owned(),
        },
        _ => io(source),
    })?;
    sync(folder).map_err(io)
}

/// A new empty file in a folder, under a hidden name that is not in use.
fn hidden(folder: &Path) -> io::Result<(File, PathBuf)> {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    loop {
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = folder.join(format!(".paws-{}-{number}.part", std::process::id()));
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(file) => return Ok((file, path)),
            // Left behind by a process of the same number.
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
}

fn fill(mut file: File, bytes: &[u8]) -> io::Result<()> {
    file.write_all(bytes)?;
    file.sync_all()
}

/// Gives a whole file a name that must be free.
fn appear(beside: &Path, path: &Path) -> io::Result<()> {
    match fs::hard_link(beside, path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
            claim_and_exchange(beside, path)
        }
        done_or_there => done_or_there,
    }
}

/// The same without hard links: the name is taken by an empty file first.
fn claim_and_exchange(beside: &Path, path: &Path) -> io::Result<()> {
    OpenOptions::new().write(true).create_new(true).open(path)?;
    fs::rename(beside, path).inspect_err(|_| {
        let _ = fs::remove_file(path);
    })
}

/// Puts the names in a folder on disk.
fn sync(folder: &Path) -> io::Result<()> {
    if cfg!(not(unix)) {
        return Ok(());
    }
    match File::open(folder)?.sync_all() {
        // Some file systems cannot sync a folder, and have nothing to sync then.
        Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
        done => done,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    #[test]
    fn nothing_is_overwritten_without_force() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        write(&path, b"first", Existing::Refuse).unwrap();
        let error = write(&path, b"second", Existing::Refuse).unwrap_err();
        assert!(matches!(error, WriteError::Exists { .. }), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        write(&path, b"second", Existing::Replace).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"second");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);

        let below = path.join("b.toml");
        let error = write(&below, b"", Existing::Refuse).unwrap_err();
        assert!(matches!(error, WriteError::Io { .. }), "{error}");
        let missing = folder.path().join("no/such/folder.toml");
        let error = write(&missing, b"", Existing::Replace).unwrap_err();
        assert!(error.to_string().contains("no/such/folder.toml"), "{error}");
    }

    #[test]
    fn files_beside_it_are_nobodys_business() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("a.toml.part"), b"the user's").unwrap();
        // What an older process of this number may have left.
        let old: Vec<PathBuf> = (0..64)
            .map(|n| at(&format!(".paws-{}-{n}.part", std::process::id())))
            .collect();
        old.iter().for_each(|path| fs::write(path, b"old").unwrap());
        for existing in [Existing::Refuse, Existing::Replace] {
            write(&at("a.toml"), b"new", existing).unwrap();
        }
        assert_eq!(fs::read(at("a.toml")).unwrap(), b"new");
        assert_eq!(fs::read(at("a.toml.part")).unwrap(), b"the user's");
        assert!(old.iter().all(|path| fs::read(path).unwrap() == b"old"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2 + 64);
    }

    /// A reader that looks all the time finds nothing or everything.
    #[test]
    fn a_file_appears_whole() {
        let folder = tempfile::tempdir().unwrap();
        let bytes = vec![7; 4 << 20];
        for turn in 0..5 {
            let path = folder.path().join(turn.to_string());
            let over = AtomicBool::new(false);
            let found = std::thread::scope(|scope| {
                let reader = scope.spawn(|| {
                    loop {
                        let over = over.load(Ordering::Acquire);
                        match fs::read(&path) {
                            Ok(found) => return found.len(),
                            Err(error) => assert!(!over, "{error}"),
                        }
                    }
                });
                let written = write(&path, &bytes, Existing::Refuse);
                over.store(true, Ordering::Release);
                written.unwrap();
                reader.join().unwrap()
            });
            assert_eq!(found, bytes.len());
        }
    }

    #[test]
    fn without_hard_links_nothing_is_overwritten_either() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("new"), b"new").unwrap();
        claim_and_exchange(&at("new"), &at("a")).unwrap();
        assert_eq!(fs::read(at("a")).unwrap(), b"new");
        fs::write(at("newer"), b"newer").unwrap();
        let error = claim_and_exchange(&at("newer"), &at("a")).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(fs::read(at("a")).unwrap(), b"new");
        assert!(claim_and_exchange(&at("gone"), &at("b")).is_err());
        assert!(!at("b").exists());
    }
}
