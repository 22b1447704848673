//! An output that is being written.
//!
//! Contract: files are written into a folder of their own, hashed while they are written, and
//! synced when they are finished. Several threads may write files of one draft. [`Draft::commit`]
//! makes them the output in one atomic step; a draft that is dropped without it leaves nothing
//! behind. After a failed write the draft cannot be committed.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read, Write};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::bundle::Shared;
use crate::error::{BundleError, doing};
use crate::layout;
use crate::manifest::{FileEntry, Output, Record};
use crate::scene::Scene;
use crate::storage::{self, StoredFile};

/// An output that is being written.
///
/// An output appears complete or not at all; the older one remains until the commit:
///
/// ```
/// # use scene_bundle::Bundle;
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("walk.scene");
/// # let provenance = scene_bundle::Provenance {
/// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
/// #     handoff_blake3: "ab".repeat(32),
/// #     judgement: None,
/// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
/// #     program: "example".to_owned(),
/// #     program_version: "1.0".to_owned(),
/// #     started_civil_ns: 1_790_000_000_000_000_000,
/// #     ended_civil_ns: None,
/// # };
/// # let record = scene_bundle::Record {
/// #     stage: "example".to_owned(),
/// #     stage_version: 1,
/// #     settings: serde_json::json!({ "step": 2 }),
/// #     inputs: std::collections::BTreeMap::new(),
/// # };
/// let bundle = Bundle::create_or_open(&path, provenance)?;
/// let draft = bundle.begin("notes")?;
/// draft.write("notes.txt", b"first")?;
/// draft.commit(record)?;
///
/// let draft = bundle.begin("notes")?;
/// draft.write("notes.txt", b"second")?;
/// drop(draft); // the stage failed
/// assert_eq!(bundle.scene().output("notes")?.read("notes.txt")?, b"first");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Draft {
    inner: Arc<Inner>,
}

struct Inner {
    shared: Arc<Shared>,
    name: String,
    /// Its folder in the bundle.
    folder: String,
    content: Mutex<Content>,
}

#[derive(Default)]
struct Content {
    folders: BTreeSet<String>,
    /// By path: `None` while the file is being written, then its entry and whether the manifest
    /// names it.
    files: BTreeMap<String, Option<(FileEntry, HashLocation)>>,
}

/// Where a file's hash is recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum HashLocation {
    Manifest,
    Listing,
}

/// A file of a draft. It counts once it is [finished](DraftFile::finish).
pub struct DraftFile {
    inner: Arc<Inner>,
    path: String,
    hash_location: HashLocation,
    file: Box<dyn StoredFile>,
    waiting: Vec<u8>,
    bytes: u64,
    /// Hash of the bytes written; `None` once the start was overwritten.
    hasher: Option<blake3::Hasher>,
    /// A write failed: what the file holds is unknown.
    failed: bool,
}

/// Size of the write buffer, bytes.
const BUFFER: usize = 1 << 17;

impl Draft {
    pub(crate) fn begin(shared: &Arc<Shared>, name: &str) -> Result<Self, BundleError> {
        let root = shared.storage.root();
        let refused = |found: String, expected: &str| BundleError::Refused {
            path: root.to_owned(),
            found,
            expected: expected.to_owned(),
        };
        if !layout::is_output_name(name) {
            let expected = "lower-case letters, digits and -, beginning with a letter";
            return Err(refused(format!("an output called {name:?}"), expected));
        }
        if !shared.drafts().insert(name.to_owned()) {
            let found = format!("a second draft of output {name}");
            return Err(refused(
                found,
                "the first one to be committed or dropped before",
            ));
        }
        let folder = layout::draft(name);
        // From here on dropping it releases the name and removes the folder.
        let draft = Self {
            inner: Arc::new(Inner {
                shared: shared.clone(),
                name: name.to_owned(),
                folder: folder.clone(),
                content: Mutex::default(),
            }),
        };
        let made = shared.storage.create_dir(&folder);
        made.map_err(doing("making the folder of an output", root.join(folder)))?;
        Ok(draft)
    }

    /// The output's name.
    pub fn name(&self) -> &str {
        &self.inner.name
    }

    /// Path of a file while it is written, for messages.
    pub(crate) fn file_path(&self, path: &str) -> PathBuf {
        self.inner.full(&format!("{}/{path}", self.inner.folder))
    }

    /// Begins a file that the manifest will name. `path` is below the output's folder, parts of
    /// ASCII letters, digits, `_`, `-` and `.` with `/` between them.
    ///
    /// # Errors
    /// [`BundleError::Refused`] for such a path or one that is taken, [`BundleError::Io`].
    ///
    /// ```
    /// use std::io::Write as _;
    /// # use scene_bundle::Bundle;
    /// # let folder = tempfile::tempdir()?;
    /// # let path = folder.path().join("walk.scene");
    /// # let provenance = scene_bundle::Provenance {
    /// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
    /// #     handoff_blake3: "ab".repeat(32),
    /// #     judgement: None,
    /// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
    /// #     program: "example".to_owned(),
    /// #     program_version: "1.0".to_owned(),
    /// #     started_civil_ns: 1_790_000_000_000_000_000,
    /// #     ended_civil_ns: None,
    /// # };
    /// # let record = scene_bundle::Record {
    /// #     stage: "example".to_owned(),
    /// #     stage_version: 1,
    /// #     settings: serde_json::json!({ "step": 2 }),
    /// #     inputs: std::collections::BTreeMap::new(),
    /// # };
    /// # let bundle = Bundle::create_or_open(&path, provenance)?;
    ///
    /// let draft = bundle.begin("notes")?;
    /// let mut file = draft.create("feet/left.txt")?;
    /// for line in 0..3 {
    ///     writeln!(file, "line {line}")?;
    /// }
    /// file.finish()?;
    /// let output = draft.commit(record)?;
    /// assert_eq!((output.files[0].path.as_str(), output.files[0].bytes), ("feet/left.txt", 21));
    ///
    /// let refused = bundle.begin("other")?.create("../notes.txt").map(drop);
    /// assert!(refused.is_err_and(|error| error.to_string().contains("../notes.txt")));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn create(&self, path: &str) -> Result<DraftFile, BundleError> {
        self.create_named(path, HashLocation::Manifest)
    }

    /// Begins a file that the output's listing will name, not the manifest: for outputs of very
    /// many files.
    ///
    /// # Errors
    /// As [`Self::create`].
    fn create_listed(&self, path: &str) -> Result<DraftFile, BundleError> {
        self.create_named(path, HashLocation::Listing)
    }

    /// Writes a whole file that the manifest will name.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn write(&self, path: &str, bytes: &[u8]) -> Result<(), BundleError> {
        self.create(path)?.whole(bytes)
    }

    /// Writes a whole file that the listing will name.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub(crate) fn write_listed(&self, path: &str, bytes: &[u8]) -> Result<(), BundleError> {
        self.create_listed(path)?.whole(bytes)
    }

    fn create_named(
        &self,
        path: &str,
        hash_location: HashLocation,
    ) -> Result<DraftFile, BundleError> {
        let inner = &self.inner;
        let refused = |expected: &str| BundleError::Refused {
            path: inner.shared.storage.root().join(&inner.folder),
            found: format!("a file called {path:?}"),
            expected: expected.to_owned(),
        };
        if !layout::is_file_path(path) || path == layout::LISTING {
            return Err(refused(
                "parts of ASCII letters, digits, _, - and . with / between them",
            ));
        }
        let full = format!("{}/{path}", inner.folder);
        let mut content = inner.content();
        if content.files.contains_key(path) {
            return Err(refused("each path once"));
        }
        let storage = &*inner.shared.storage;
        for (end, _) in path.match_indices('/') {
            let folder = &path[..end];
            if content.folders.insert(folder.to_owned()) {
                let folder = format!("{}/{folder}", inner.folder);
                storage
                    .create_dir(&folder)
                    .map_err(doing("making a folder of an output", inner.full(&folder)))?;
            }
        }
        let file = storage.create(&full);
        let file = file.map_err(doing("creating a file of an output", inner.full(&full)))?;
        content.files.insert(path.to_owned(), None);
        Ok(DraftFile {
            inner: inner.clone(),
            path: path.to_owned(),
            hash_location,
            file,
            waiting: Vec::new(),
            bytes: 0,
            hasher: Some(blake3::Hasher::new()),
            failed: false,
        })
    }

    /// Publishes the files as the output, replacing an older one. It is durable when this returns.
    ///
    /// The order: folders synced, draft renamed, bundle's folder synced, manifest replaced, older
    /// version removed. Should the removal fail, the next writer does it.
    ///
    /// # Errors
    /// [`BundleError::Refused`] when a file is not finished or the record is not allowed,
    /// [`BundleError::Io`]. The output is then the older one; should the very last step have
    /// failed, the bundle on disk may have the new one.
    pub fn commit(self, record: Record) -> Result<Output, BundleError> {
        let inner = &self.inner;
        inner.check(&record)?;
        self.write_listing()?;
        let files = inner.finished()?;
        let storage = &*inner.shared.storage;
        let folders = inner.content().folders.clone();
        let folders = folders
            .iter()
            .map(|folder| format!("{}/{folder}", inner.folder));
        for folder in folders.chain([inner.folder.clone()]) {
            let synced = storage.sync_dir(&folder);
            synced.map_err(doing("syncing a folder of an output", inner.full(&folder)))?;
        }

        let files: Vec<FileEntry> = files
            .into_iter()
            .filter(|(_, hash_location)| *hash_location == HashLocation::Manifest)
            .map(|(file, _)| file)
            .collect();
        let output = Output::new(record, files);
        let folder = layout::folder(&inner.name, &output.hash);
        // Held to the end: commits of other outputs wait.
        let mut manifest = inner.shared.manifest();
        let old = manifest.outputs.get(&inner.name);
        let old = old.map(|old| layout::folder(&inner.name, &old.hash));
        // The same content again. Its folder is not moved, unless it was damaged since.
        let stays = old.as_ref() == Some(&folder)
            && Scene::of(inner.shared.storage.clone(), manifest.clone()).is_whole(&inner.name);
        if !stays {
            let placed = storage::remove_all(storage, &folder)
                .and_then(|()| storage.rename(&inner.folder, &folder))
                .and_then(|()| storage.sync_dir(""));
            placed.map_err(doing("putting an output in its place", inner.full(&folder)))?;
        }
        let mut with_output = manifest.clone();
        with_output
            .outputs
            .insert(inner.name.clone(), output.clone());
        inner.shared.replace_manifest(&with_output)?;
        *manifest = with_output;
        if let Some(old) = old.filter(|old| *old != folder) {
            // Nothing names it any more; what cannot be removed now is removed by the next writer.
            let _ = storage::remove_all(storage, &old);
        }
        Ok(output)
    }

    fn write_listing(&self) -> Result<(), BundleError> {
        let files = self.inner.finished()?;
        let listed = files
            .iter()
            .filter(|(_, hash_location)| *hash_location == HashLocation::Listing);
        let text: String = listed
            .map(|(file, _)| format!("{}  {}\n", file.blake3, file.path))
            .collect();
        if text.is_empty() {
            return Ok(());
        }
        let inner = &self.inner;
        let full = format!("{}/{}", inner.folder, layout::LISTING);
        let file = inner.shared.storage.create(&full);
        let file = file.map_err(doing(
            "creating the listing of an output",
            inner.full(&full),
        ))?;
        inner
            .content()
            .files
            .insert(layout::LISTING.to_owned(), None);
        let file = DraftFile {
            inner: inner.clone(),
            path: layout::LISTING.to_owned(),
            hash_location: HashLocation::Manifest,
            file,
            waiting: Vec::new(),
            bytes: 0,
            hasher: Some(blake3::Hasher::new()),
            failed: false,
        };
        file.whole(text.as_bytes())
    }
}

impl Inner {
    fn content(&self) -> MutexGuard<'_, Content> {
        self.content.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn full(&self, path: &str) -> PathBuf {
        self.shared.storage.root().join(path)
    }

    fn refused(&self, found: String, expected: &str) -> BundleError {
        BundleError::Refused {
            path: self.full(&self.folder),
            found,
            expected: expected.to_owned(),
        }
    }

    fn check(&self, record: &Record) -> Result<(), BundleError> {
        if record.stage.is_empty() {
            return Err(self.refused("a stage without a name".to_owned(), "one"));
        }
        match record
            .inputs
            .iter()
            .find(|(_, hash)| !layout::is_hash(hash))
        {
            None => Ok(()),
            Some((name, hash)) => Err(self.refused(
                format!("{hash:?} as the hash of input {name}"),
                "64 hexadecimal digits",
            )),
        }
    }

    /// All files, sorted by path.
    fn finished(&self) -> Result<Vec<(FileEntry, HashLocation)>, BundleError> {
        let content = self.content();
        let files = content.files.iter().map(|(path, file)| {
            file.clone()
                .ok_or_else(|| self.refused(format!("{path} not finished"), "all files to be"))
        });
        files.collect()
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        // After a commit it is not there any more. What cannot be removed now is removed by the
        // next writer.
        let _ = storage::remove_all(&*self.shared.storage, &self.folder);
        self.shared.drafts().remove(&self.name);
    }
}

impl DraftFile {
    /// Writes over bytes at the beginning of the file, which must have been written before: for
    /// headers that state the length of what follows.
    ///
    /// # Errors
    /// Any I/O error, or fewer bytes were written so far.
    pub(crate) fn overwrite_start(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.flush()?;
        if self.bytes < bytes.len() as u64 {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        self.hasher = None;
        self.failed = true;
        self.file.overwrite_start(bytes)?;
        self.failed = false;
        Ok(())
    }

    /// Makes the file durable and a part of the draft.
    ///
    /// # Errors
    /// [`BundleError::Io`]; the draft cannot be committed then.
    pub fn finish(mut self) -> Result<(), BundleError> {
        let full = format!("{}/{}", self.inner.folder, self.path);
        let path = self.inner.full(&full);
        self.flush()
            .and_then(|()| self.file.sync())
            .map_err(doing("writing a file of an output", &path))?;
        let hasher = match self.hasher {
            Some(hasher) => hasher,
            None => hash_again(&self.inner, &full)
                .map_err(doing("reading a file of an output again", &path))?,
        };
        let entry = FileEntry {
            path: self.path.clone(),
            bytes: self.bytes,
            blake3: hasher.finalize().to_hex().to_string(),
        };
        self.inner
            .content()
            .files
            .insert(self.path, Some((entry, self.hash_location)));
        Ok(())
    }

    fn whole(mut self, bytes: &[u8]) -> Result<(), BundleError> {
        let path = self
            .inner
            .full(&format!("{}/{}", self.inner.folder, self.path));
        self.write_all(bytes)
            .map_err(doing("writing a file of an output", path))?;
        self.finish()
    }

    /// The file's path, for messages.
    pub(crate) fn file_path(&self) -> PathBuf {
        self.inner
            .full(&format!("{}/{}", self.inner.folder, self.path))
    }
}

fn hash_again(inner: &Inner, full: &str) -> io::Result<blake3::Hasher> {
    let mut file = inner.shared.storage.open(full)?;
    let (mut hasher, mut buffer) = (blake3::Hasher::new(), vec![0; BUFFER]);
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(hasher),
            n => hasher.update(&buffer[..n]),
        };
    }
}

impl Write for DraftFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.waiting.extend(bytes);
        if self.waiting.len() >= BUFFER {
            self.flush()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.failed {
            return Err(io::Error::other("an earlier write to this file failed"));
        }
        if self.waiting.is_empty() {
            return Ok(());
        }
        self.failed = true;
        self.file.append(&self.waiting)?;
        self.failed = false;
        if let Some(hasher) = &mut self.hasher {
            hasher.update(&self.waiting);
        }
        self.bytes += self.waiting.len() as u64;
        self.waiting.clear();
        Ok(())
    }
}
