//! A disk in memory that keeps apart what is durable and what is not, and fails on demand.
//!
//! Every call that changes the disk is one operation, counted from 0. A test first runs its
//! workload without a fault to learn how many there are, then runs it again for every operation
//! and every [`FaultKind`], takes a [`crash`](FaultStorage::crash) image, and looks at what a
//! reader finds. Enumerating beats sampling: no cut point is left to chance.

use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{ReadAt, Storage, WriteFile};

/// How an operation goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultKind {
    /// The power fails: this operation and all after it fail and change nothing.
    PowerCut,
    /// The disk is full from here on: this and every later append takes what fits in
    /// [`Fault::keep`] bytes once, then nothing; other operations work.
    NoSpace,
    /// This operation fails with EIO once; an append keeps [`Fault::keep`] bytes. What a failed
    /// sync should have made durable never will be: as on Linux, a later sync of that file
    /// succeeds, but the bytes are lost.
    InputOutput,
}

/// Kind of an operation, so that a test can select it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// A file was created.
    Create,
    /// This many bytes were appended to a file.
    Append(usize),
    /// A file was synced.
    Sync,
    /// A file was cut to this length.
    Truncate(u64),
    /// A file was renamed.
    Rename,
    /// A file was removed.
    Remove,
    /// A folder was synced.
    SyncDir,
}

/// One planned failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Number of the operation, from 0.
    pub at: u64,
    /// How it goes wrong.
    pub kind: FaultKind,
    /// Bytes of a failing append that are taken all the same.
    pub keep: usize,
}

/// What a crash leaves of what was not yet durable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CrashKind {
    /// Everything written is there: the process died, the kernel lived.
    ProcessKilled,
    /// Nothing that was not synced is there.
    UnsyncedDropped,
    /// As `UnsyncedDropped`, but of the last append this many bytes reached the disk, the rest of
    /// it reads as zeros: the file's length was written before its content.
    LastWriteTorn(usize),
}

#[derive(Clone, Debug, Default)]
struct FileState {
    content: Vec<u8>,
    durable: usize,
    last_append: usize,
    /// A sync failed: nothing more of this file becomes durable.
    forgotten: bool,
}

impl FileState {
    fn durable(content: Vec<u8>) -> Self {
        Self {
            durable: content.len(),
            content,
            ..Self::default()
        }
    }
}

#[derive(Clone, Debug, Default)]
struct Disk {
    files: BTreeMap<u64, FileState>,
    names: BTreeMap<String, u64>,
    durable_names: BTreeMap<String, u64>,
    last_file: u64,
    log: Vec<Operation>,
    faults: Vec<Fault>,
    capacity: Option<usize>,
    full: bool,
    dead: bool,
}

/// What one operation may do.
enum Permit {
    Whole,
    Part(usize, io::Error),
}

fn enospc() -> io::Error {
    io::Error::from_raw_os_error(28)
}

fn eio() -> io::Error {
    io::Error::from_raw_os_error(5)
}

impl Disk {
    fn operation(&mut self, operation: Operation) -> Permit {
        let number = self.log.len() as u64;
        self.log.push(operation);
        let append = matches!(operation, Operation::Append(_));
        if self.dead {
            return Permit::Part(0, eio());
        }
        if self.full && append {
            return Permit::Part(0, enospc());
        }
        if let (Operation::Append(bytes), Some(capacity)) = (operation, self.capacity) {
            let used: usize = self
                .names
                .values()
                .map(|id| self.files[id].content.len())
                .sum();
            let room = capacity.saturating_sub(used);
            if room < bytes {
                return Permit::Part(room, enospc());
            }
        }
        let Some(fault) = self.faults.iter().copied().find(|f| f.at == number) else {
            return Permit::Whole;
        };
        match fault.kind {
            FaultKind::PowerCut => {
                self.dead = true;
                Permit::Part(if append { fault.keep } else { 0 }, eio())
            }
            FaultKind::NoSpace => {
                self.full = true;
                if append {
                    Permit::Part(fault.keep, enospc())
                } else {
                    Permit::Whole
                }
            }
            FaultKind::InputOutput => Permit::Part(fault.keep, eio()),
        }
    }

    fn plain(&mut self, operation: Operation) -> io::Result<()> {
        match self.operation(operation) {
            Permit::Whole => Ok(()),
            Permit::Part(_, e) => Err(e),
        }
    }
}

/// A disk in memory with planned faults. Clones share the disk.
#[derive(Clone, Debug, Default)]
pub struct FaultStorage(Arc<Mutex<Disk>>);

impl FaultStorage {
    /// A disk that works.
    pub fn new() -> Self {
        Self::default()
    }

    /// An empty disk that fails once as planned.
    ///
    /// ```
    /// use session_archive::storage::{Fault, FaultKind, FaultStorage, Operation, Storage};
    ///
    /// // Operation 0 creates the file, operation 1 is the first append: three bytes are taken, then the disk is full.
    /// let disk = FaultStorage::with_fault(Fault { at: 1, kind: FaultKind::NoSpace, keep: 3 });
    /// let mut file = disk.create("000000.mcap")?;
    /// assert!(file.append(b"a chunk").is_err());
    /// assert_eq!(disk.content("000000.mcap").as_deref(), Some(&b"a c"[..]));
    /// assert_eq!(disk.log()[0], Operation::Create);
    /// # Ok::<(), std::io::Error>(())
    /// ```
    pub fn with_fault(fault: Fault) -> Self {
        Self::with_faults([fault])
    }

    /// An empty disk that fails several times as planned.
    pub fn with_faults(faults: impl IntoIterator<Item = Fault>) -> Self {
        let disk = Disk {
            faults: faults.into_iter().collect(),
            ..Disk::default()
        };
        Self(Arc::new(Mutex::new(disk)))
    }

    /// An empty disk with room for this many bytes of content; cutting and removing files makes
    /// room again.
    pub fn with_capacity(bytes: usize) -> Self {
        let disk = Disk {
            capacity: Some(bytes),
            ..Disk::default()
        };
        Self(Arc::new(Mutex::new(disk)))
    }

    fn disk(&self) -> MutexGuard<'_, Disk> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How many operations there were so far.
    pub fn operations(&self) -> u64 {
        self.disk().log.len() as u64
    }

    /// What the operations so far were.
    pub fn log(&self) -> Vec<Operation> {
        self.disk().log.clone()
    }

    /// The disk as it is found after a crash at this instant: a new, working disk.
    ///
    /// ```
    /// use session_archive::storage::{CrashKind, FaultStorage, Storage};
    ///
    /// let disk = FaultStorage::new();
    /// let mut file = disk.create("000000.mcap")?;
    /// disk.sync_dir("")?;
    /// file.append(b"synced")?;
    /// file.sync_data()?;
    /// file.append(b", not synced")?;
    ///
    /// let found = disk.crash(CrashKind::UnsyncedDropped);
    /// assert_eq!(found.content("000000.mcap").as_deref(), Some(&b"synced"[..]));
    /// # Ok::<(), std::io::Error>(())
    /// ```
    #[must_use]
    pub fn crash(&self, kind: CrashKind) -> Self {
        let old = self.disk();
        let names = match kind {
            CrashKind::ProcessKilled => old.names.clone(),
            _ => old.durable_names.clone(),
        };
        let mut files = BTreeMap::new();
        for id in names.values() {
            let Some(state) = old.files.get(id) else {
                continue;
            };
            let mut content = state.content.clone();
            match kind {
                CrashKind::ProcessKilled => {}
                CrashKind::UnsyncedDropped => content.truncate(state.durable),
                CrashKind::LastWriteTorn(kept) => {
                    let torn = *id == old.last_file && state.durable < content.len();
                    if torn {
                        let from = (state.content.len() - state.last_append).max(state.durable);
                        let from = (from + kept).min(content.len());
                        content[from..].fill(0);
                    } else {
                        content.truncate(state.durable);
                    }
                }
            }
            files.insert(*id, FileState::durable(content));
        }
        let disk = Disk {
            files,
            durable_names: names.clone(),
            names,
            last_file: old.last_file,
            ..Disk::default()
        };
        Self(Arc::new(Mutex::new(disk)))
    }

    /// A copy of the disk as it is now, without planned faults.
    #[must_use]
    pub fn snapshot(&self) -> Self {
        self.crash(CrashKind::ProcessKilled)
    }

    /// Content of a file, for tests.
    pub fn content(&self, path: &str) -> Option<Vec<u8>> {
        let disk = self.disk();
        disk.names
            .get(path)
            .and_then(|id| disk.files.get(id))
            .map(|f| f.content.clone())
    }

    /// Replaces the content of a file (or makes it), durable immediately, for tests.
    pub fn set_content(&self, path: &str, content: Vec<u8>) {
        let mut disk = self.disk();
        let fresh = disk.files.keys().next_back().map_or(0, |id| id + 1);
        let id = disk.names.get(path).copied().unwrap_or(fresh);
        disk.names.insert(path.to_owned(), id);
        disk.durable_names.insert(path.to_owned(), id);
        disk.files.insert(id, FileState::durable(content));
    }

    /// Paths of all files.
    pub fn paths(&self) -> Vec<String> {
        self.disk().names.keys().cloned().collect()
    }
}

struct FaultFile {
    disk: FaultStorage,
    id: u64,
}

impl Storage for FaultStorage {
    fn create(&self, path: &str) -> io::Result<Box<dyn WriteFile>> {
        let mut disk = self.disk();
        disk.plain(Operation::Create)?;
        if disk.names.contains_key(path) {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        let id = disk.files.keys().next_back().map_or(0, |id| id + 1);
        disk.files.insert(id, FileState::default());
        disk.names.insert(path.to_owned(), id);
        Ok(Box::new(FaultFile {
            disk: self.clone(),
            id,
        }))
    }

    fn open(&self, path: &str) -> io::Result<Box<dyn ReadAt>> {
        self.content(path)
            .map(|content| Box::new(content) as Box<dyn ReadAt>)
            .ok_or_else(|| io::ErrorKind::NotFound.into())
    }

    fn list(&self, dir: &str) -> io::Result<Vec<String>> {
        let prefix = if dir.is_empty() {
            String::new()
        } else {
            format!("{dir}/")
        };
        let disk = self.disk();
        let mut names: Vec<String> = disk
            .names
            .keys()
            .filter_map(|p| p.strip_prefix(&prefix))
            .map(|p| p.split('/').next().unwrap_or(p).to_owned())
            .collect();
        names.dedup();
        Ok(names)
    }

    /// Folders cost nothing here: a path is only a name.
    fn create_dir(&self, _dir: &str) -> io::Result<()> {
        Ok(())
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        let mut disk = self.disk();
        disk.plain(Operation::Rename)?;
        let id = disk.names.remove(from).ok_or(io::ErrorKind::NotFound)?;
        disk.names.insert(to.to_owned(), id);
        Ok(())
    }

    fn remove(&self, path: &str) -> io::Result<()> {
        let mut disk = self.disk();
        if !disk.names.contains_key(path) {
            return Err(io::ErrorKind::NotFound.into());
        }
        disk.plain(Operation::Remove)?;
        disk.names.remove(path);
        Ok(())
    }

    fn sync_dir(&self, dir: &str) -> io::Result<()> {
        let mut disk = self.disk();
        disk.plain(Operation::SyncDir)?;
        let inside = |path: &str| path.rsplit_once('/').map_or("", |(d, _)| d) == dir;
        let now: Vec<_> = disk
            .names
            .iter()
            .filter(|(p, _)| inside(p))
            .map(|(p, i)| (p.clone(), *i))
            .collect();
        disk.durable_names.retain(|p, _| !inside(p));
        disk.durable_names.extend(now);
        Ok(())
    }
}

impl WriteFile for FaultFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut disk = self.disk.disk();
        let permit = disk.operation(Operation::Append(bytes.len()));
        let (n, result) = match permit {
            Permit::Whole => (bytes.len(), Ok(())),
            Permit::Part(n, e) => (n.min(bytes.len()), Err(e)),
        };
        disk.last_file = self.id;
        if let Some(file) = disk.files.get_mut(&self.id) {
            file.content.extend(&bytes[..n]);
            file.last_append = n;
        }
        result
    }

    fn sync_data(&mut self) -> io::Result<()> {
        let mut disk = self.disk.disk();
        let result = disk.plain(Operation::Sync);
        if let Some(file) = disk.files.get_mut(&self.id) {
            file.forgotten |= result.is_err();
            if !file.forgotten {
                file.durable = file.content.len();
            }
        }
        result
    }

    fn truncate(&mut self, len: u64) -> io::Result<()> {
        let mut disk = self.disk.disk();
        disk.plain(Operation::Truncate(len))?;
        if let Some(file) = disk.files.get_mut(&self.id) {
            file.content.truncate(len as usize);
            file.durable = file.durable.min(file.content.len());
        }
        Ok(())
    }
}
