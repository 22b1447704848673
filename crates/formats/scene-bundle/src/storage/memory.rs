//! A disk in memory that distinguishes durable from volatile state, and fails at a given step.
//!
//! Every call that changes the disk is one step, counted from 0. A test runs its work once to count
//! the steps, then again for every step with [`Memory::cut_at`], takes the image that a [`Crash`]
//! leaves, and checks it.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard};

use super::{Storage, StoredFile};

/// State that a crash leaves of what was not yet durable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Crash {
    /// Everything: the process was killed, the system lives.
    Killed,
    /// Nothing: the power went, and the disk had done only what it had to.
    Forgotten,
    /// The names but not the bytes: the folders were written back first.
    NamesFirst,
    /// Of the names in each folder only the last change, and no bytes: names were written back out
    /// of order.
    LastNameFirst,
}

#[derive(Clone, Debug)]
enum Node {
    File {
        content: Vec<u8>,
        durable: Vec<u8>,
    },
    Folder {
        names: BTreeMap<String, u64>,
        durable: BTreeMap<String, u64>,
        /// Last change of names: to another file or none.
        last: Vec<(String, Option<u64>)>,
    },
}

#[derive(Clone, Debug)]
struct State {
    nodes: BTreeMap<u64, Node>,
    steps: u64,
    cut_at: Option<u64>,
}

const ROOT: u64 = 0;

/// A disk in memory. Clones share it.
#[derive(Clone, Debug)]
pub(crate) struct Memory(Arc<Mutex<State>>);

impl Memory {
    pub(crate) fn new() -> Self {
        Self::of(BTreeMap::from([(ROOT, folder(BTreeMap::new()))]))
    }

    fn of(nodes: BTreeMap<u64, Node>) -> Self {
        Self(Arc::new(Mutex::new(State {
            nodes,
            steps: 0,
            cut_at: None,
        })))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().expect("no test panics with the lock held")
    }

    /// From the step of this number on, nothing works.
    pub(crate) fn cut_at(&self, step: u64) {
        self.state().cut_at = Some(step);
    }

    /// Steps so far.
    pub(crate) fn steps(&self) -> u64 {
        self.state().steps
    }

    /// The disk as it is found after a crash at this instant: a new one that works.
    pub(crate) fn crash(&self, kind: Crash) -> Self {
        let old = self.state();
        let nodes = old.nodes.iter().map(|(id, node)| {
            let left = match node {
                Node::File { content, durable } => file(match kind {
                    Crash::Killed => content.clone(),
                    _ => durable.clone(),
                }),
                Node::Folder {
                    names,
                    durable,
                    last,
                } => folder(match kind {
                    Crash::Killed | Crash::NamesFirst => names.clone(),
                    Crash::Forgotten => durable.clone(),
                    Crash::LastNameFirst => {
                        let mut names = durable.clone();
                        names.retain(|name, _| !last.contains(&(name.clone(), None)));
                        let added = last.iter().cloned();
                        names.extend(added.filter_map(|(name, id)| Some((name, id?))));
                        names
                    }
                }),
            };
            (*id, left)
        });
        Self::of(nodes.collect())
    }

    /// Changes one byte of a file, as a bad disk does.
    pub(crate) fn damage(&self, path: &str, offset: usize) {
        let mut state = self.state();
        let id = state.find(path).expect("the file is there");
        match state.nodes.get_mut(&id) {
            Some(Node::File { content, durable }) => {
                content[offset] ^= 1;
                durable.clone_from(content);
            }
            _ => panic!("{path} is no file"),
        }
    }

    /// All files.
    pub(crate) fn paths(&self) -> Vec<String> {
        fn below(disk: &Memory, dir: &str, found: &mut Vec<String>) {
            for (name, is_dir) in disk.list(dir).expect("a folder can be listed") {
                let path = if dir.is_empty() {
                    name
                } else {
                    format!("{dir}/{name}")
                };
                if is_dir {
                    found.push(format!("{path}/"));
                    below(disk, &path, found);
                } else {
                    found.push(path);
                }
            }
        }
        let mut found = Vec::new();
        below(self, "", &mut found);
        found
    }
}

fn file(content: Vec<u8>) -> Node {
    Node::File {
        durable: content.clone(),
        content,
    }
}

fn folder(names: BTreeMap<String, u64>) -> Node {
    Node::Folder {
        durable: names.clone(),
        names,
        last: Vec::new(),
    }
}

fn missing() -> io::Error {
    io::ErrorKind::NotFound.into()
}

fn split(path: &str) -> (&str, &str) {
    path.rsplit_once('/').unwrap_or(("", path))
}

impl State {
    fn step(&mut self) -> io::Result<()> {
        let step = self.steps;
        self.steps += 1;
        match self.cut_at {
            Some(cut) if step >= cut => Err(io::Error::other("the power went")),
            _ => Ok(()),
        }
    }

    fn find(&self, path: &str) -> Option<u64> {
        let mut id = ROOT;
        for part in path.split('/').filter(|p| !p.is_empty()) {
            let Node::Folder { names, .. } = self.nodes.get(&id)? else {
                return None;
            };
            id = *names.get(part)?;
        }
        Some(id)
    }

    fn names(&self, dir: &str) -> io::Result<&BTreeMap<String, u64>> {
        let id = self.find(dir).ok_or_else(missing)?;
        match &self.nodes[&id] {
            Node::Folder { names, .. } => Ok(names),
            Node::File { .. } => Err(io::ErrorKind::NotADirectory.into()),
        }
    }

    /// One change of names: each becomes another file or none. All must be in one folder, or each
    /// change is one of its own.
    fn change(&mut self, changes: &[(&str, Option<u64>)]) -> io::Result<()> {
        let dirs: Vec<&str> = changes.iter().map(|(path, _)| split(path).0).collect();
        for dir in &dirs {
            let id = self.find(dir).ok_or_else(missing)?;
            let Some(Node::Folder { names, last, .. }) = self.nodes.get_mut(&id) else {
                return Err(io::ErrorKind::NotADirectory.into());
            };
            last.clear();
            for (path, to) in changes.iter().filter(|(path, _)| split(path).0 == *dir) {
                let name = split(path).1.to_owned();
                last.push((name.clone(), *to));
                match to {
                    Some(id) => names.insert(name, *id),
                    None => names.remove(&name),
                };
            }
        }
        Ok(())
    }

    fn add(&mut self, path: &str, node: Node) -> io::Result<u64> {
        if self.find(path).is_some() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        let id = self.nodes.keys().next_back().map_or(0, |id| id + 1);
        self.change(&[(path, Some(id))])?;
        self.nodes.insert(id, node);
        Ok(id)
    }
}

impl Storage for Memory {
    fn root(&self) -> &Path {
        Path::new("memory.scene")
    }

    fn create(&self, path: &str) -> io::Result<Box<dyn StoredFile>> {
        let mut state = self.state();
        state.step()?;
        let id = state.add(path, file(Vec::new()))?;
        Ok(Box::new(MemoryFile {
            disk: self.clone(),
            id,
        }))
    }

    fn open(&self, path: &str) -> io::Result<Box<dyn Read + Send>> {
        let state = self.state();
        let id = state.find(path).ok_or_else(missing)?;
        match &state.nodes[&id] {
            Node::File { content, .. } => Ok(Box::new(io::Cursor::new(content.clone()))),
            Node::Folder { .. } => Err(io::ErrorKind::IsADirectory.into()),
        }
    }

    fn length(&self, path: &str) -> io::Result<u64> {
        let state = self.state();
        match &state.nodes[&state.find(path).ok_or_else(missing)?] {
            Node::File { content, .. } => Ok(content.len() as u64),
            Node::Folder { .. } => Err(io::ErrorKind::IsADirectory.into()),
        }
    }

    fn list(&self, dir: &str) -> io::Result<Vec<(String, bool)>> {
        let state = self.state();
        let names = state.names(dir)?.clone();
        let is_dir = |id: &u64| matches!(state.nodes[id], Node::Folder { .. });
        Ok(names
            .iter()
            .map(|(name, id)| (name.clone(), is_dir(id)))
            .collect())
    }

    fn create_dir(&self, dir: &str) -> io::Result<()> {
        let mut state = self.state();
        state.step()?;
        state.add(dir, folder(BTreeMap::new())).map(|_| ())
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        let mut state = self.state();
        state.step()?;
        if let Some(id) = state.find(to)
            && matches!(&state.nodes[&id], Node::Folder { names, .. } if !names.is_empty())
        {
            return Err(io::ErrorKind::DirectoryNotEmpty.into());
        }
        let id = state.find(from).ok_or_else(missing)?;
        state.change(&[(from, None), (to, Some(id))])
    }

    fn remove_file(&self, path: &str) -> io::Result<()> {
        let mut state = self.state();
        state.find(path).ok_or_else(missing)?;
        state.step()?;
        state.change(&[(path, None)])
    }

    fn remove_dir(&self, dir: &str) -> io::Result<()> {
        let mut state = self.state();
        state.step()?;
        if !state.names(dir)?.is_empty() {
            return Err(io::ErrorKind::DirectoryNotEmpty.into());
        }
        state.change(&[(dir, None)])
    }

    fn sync_dir(&self, dir: &str) -> io::Result<()> {
        let mut state = self.state();
        state.step()?;
        let id = state.find(dir).ok_or_else(missing)?;
        match state.nodes.get_mut(&id) {
            Some(Node::Folder {
                names,
                durable,
                last,
            }) => {
                durable.clone_from(names);
                last.clear();
                Ok(())
            }
            _ => Err(io::ErrorKind::NotADirectory.into()),
        }
    }
}

struct MemoryFile {
    disk: Memory,
    id: u64,
}

impl MemoryFile {
    fn change(&self, change: impl FnOnce(&mut Vec<u8>, &mut Vec<u8>)) -> io::Result<()> {
        let mut state = self.disk.state();
        state.step()?;
        if let Some(Node::File { content, durable }) = state.nodes.get_mut(&self.id) {
            change(content, durable);
        }
        Ok(())
    }
}

impl StoredFile for MemoryFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.change(|content, _| content.extend(bytes))
    }

    fn overwrite_start(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.change(|content, _| content[..bytes.len()].copy_from_slice(bytes))
    }

    fn sync(&mut self) -> io::Result<()> {
        self.change(|content, durable| durable.clone_from(content))
    }
}
