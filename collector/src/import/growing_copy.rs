//! Reading a copy while it is being written.
//!
//! [`GrowingCopy`] presents the files as if they were complete; a read of bytes that are not
//! written yet waits for them. So the verification of a session runs in parallel to its copy, on
//! bytes that are still in the page cache. If the copy is aborted, every waiting read fails.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, OnceLock, PoisonError};

use session_archive::storage::{DiskStorage, ReadAt, Storage, WriteFile};

use super::file_record::FileRecord;
use super::source::SourceFile;

/// Progress of each file; shared by the copy and its reader.
#[derive(Clone)]
pub(super) struct CopyProgress(Arc<Shared>);

struct Shared {
    /// Final length of each file.
    lengths: BTreeMap<String, u64>,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// Readable bytes of each file.
    ready: BTreeMap<String, u64>,
    /// No more bytes will be written.
    closed: bool,
}

impl CopyProgress {
    /// Initial progress: reused files are complete, the others empty.
    pub(super) fn new(files: &[SourceFile], kept: &[FileRecord]) -> Self {
        let state = State {
            ready: kept.iter().map(|k| (k.path.clone(), k.bytes)).collect(),
            closed: false,
        };
        Self(Arc::new(Shared {
            lengths: files.iter().map(|f| (f.path.clone(), f.bytes)).collect(),
            state: Mutex::new(state),
            changed: Condvar::new(),
        }))
    }

    /// The first `bytes` of a file can be read.
    pub(super) fn ready(&self, path: &str, bytes: u64) {
        let mut state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
        match state.ready.get_mut(path) {
            Some(known) => *known = bytes,
            None => {
                state.ready.insert(path.to_owned(), bytes);
            }
        }
        drop(state);
        self.0.changed.notify_all();
    }

    /// The copy has ended, with or without success.
    pub(super) fn close(&self) {
        let mut state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.closed = true;
        drop(state);
        self.0.changed.notify_all();
    }

    /// Waits until the first `bytes` of a file can be read.
    fn wait(&self, path: &str, bytes: u64) -> io::Result<()> {
        let state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
        let existing = |state: &State| state.ready.get(path).is_some_and(|ready| *ready >= bytes);
        let state = self
            .0
            .changed
            .wait_while(state, |state| !existing(state) && !state.closed)
            .unwrap_or_else(PoisonError::into_inner);
        if existing(&state) {
            Ok(())
        } else {
            Err(io::Error::other("the copy was given up"))
        }
    }
}

/// The growing copy as a storage; see the module.
pub(super) struct GrowingCopy {
    disk: DiskStorage,
    copy_progress: CopyProgress,
}

impl GrowingCopy {
    pub(super) fn new(folder: &Path, copy_progress: &CopyProgress) -> Self {
        Self {
            disk: DiskStorage::new(folder),
            copy_progress: copy_progress.clone(),
        }
    }
}

/// A file of the copy. It is opened by the first read, so that a query of its length, which is
/// known from the source, does not wait.
struct GrowingFile {
    path: String,
    length: u64,
    disk: DiskStorage,
    opened: OnceLock<Box<dyn ReadAt>>,
    copy_progress: CopyProgress,
}

impl ReadAt for GrowingFile {
    fn len(&self) -> io::Result<u64> {
        Ok(self.length)
    }

    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize> {
        let end = offset.saturating_add(buf.len() as u64).min(self.length);
        if offset >= end {
            return Ok(0);
        }
        self.copy_progress.wait(&self.path, end)?;
        let file = match self.opened.get() {
            Some(file) => file,
            None => {
                let file = self.disk.open(&self.path)?;
                self.opened.get_or_init(|| file)
            }
        };
        let n = usize::try_from(end - offset).map_err(io::Error::other)?;
        file.read_at(&mut buf[..n], offset)
    }
}

fn read_only<T>() -> io::Result<T> {
    Err(io::Error::new(
        io::ErrorKind::Unsupported,
        "a copy in the making is only read here",
    ))
}

impl Storage for GrowingCopy {
    fn open(&self, path: &str) -> io::Result<Box<dyn ReadAt>> {
        let length = self.copy_progress.0.lengths.get(path).copied();
        let length = length.ok_or(io::ErrorKind::NotFound)?;
        Ok(Box::new(GrowingFile {
            path: path.to_owned(),
            length,
            disk: self.disk.clone(),
            opened: OnceLock::new(),
            copy_progress: self.copy_progress.clone(),
        }))
    }

    fn list(&self, dir: &str) -> io::Result<Vec<String>> {
        let inside = |path: &String| {
            let rest = match dir {
                "" => Some(path.as_str()),
                dir => path.strip_prefix(dir).and_then(|p| p.strip_prefix('/')),
            };
            rest.map(|rest| rest.split('/').next().unwrap_or(rest).to_owned())
        };
        let names: BTreeSet<String> = self
            .copy_progress
            .0
            .lengths
            .keys()
            .filter_map(inside)
            .collect();
        Ok(names.into_iter().collect())
    }

    fn create(&self, _: &str) -> io::Result<Box<dyn WriteFile>> {
        read_only()
    }

    fn create_dir(&self, _: &str) -> io::Result<()> {
        read_only()
    }

    fn rename(&self, _: &str, _: &str) -> io::Result<()> {
        read_only()
    }

    fn remove(&self, _: &str) -> io::Result<()> {
        read_only()
    }

    fn sync_dir(&self, _: &str) -> io::Result<()> {
        read_only()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_wait_for_bytes_and_fail_after_the_copy_is_aborted() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("segments")).unwrap();
        std::fs::write(folder.path().join("segments/a"), b"0123456789").unwrap();
        let file = SourceFile {
            path: "segments/a".to_owned(),
            bytes: 10,
            modified_ns: 0,
        };
        let copy_progress = CopyProgress::new(&[file], &[]);
        let follow = GrowingCopy::new(folder.path(), &copy_progress);
        assert_eq!(follow.list("segments").unwrap(), ["a"]);
        assert_eq!(follow.list("").unwrap(), ["segments"]);
        let missing = follow.open("other").err().unwrap();
        assert_eq!(missing.kind(), io::ErrorKind::NotFound);
        // Nothing is written yet, but the length is known.
        assert_eq!(follow.open("segments/a").unwrap().len().unwrap(), 10);
        std::thread::scope(|scope| {
            let reading = scope.spawn(|| {
                let file = follow.open("segments/a").unwrap();
                let mut buf = [0; 4];
                let first = file.read_at(&mut buf, 2).map(|_| buf);
                let beyond = file.read_at(&mut [0; 4], 10).unwrap();
                let second = file.read_at(&mut buf, 6);
                (first, beyond, second)
            });
            copy_progress.ready("segments/a", 3);
            copy_progress.ready("segments/a", 6);
            copy_progress.close();
            let (first, beyond, second) = reading.join().unwrap();
            assert_eq!(&first.unwrap(), b"2345");
            assert_eq!(beyond, 0);
            assert!(second.is_err());
        });
    }
}
