//! Reading a bundle.
//!
//! Contract: corrupt data is never returned. Every file is checked against its hash when it is
//! read. Reading takes no lock: an output that a writer replaces meanwhile can no longer be read
//! through a [`Scene`] opened before; this is an error.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::error::{BundleError, doing};
use crate::layout;
use crate::manifest::{FileEntry, Manifest, Output};
use crate::storage::{self, Disk, Storage};

/// Maximum size of one file of an output, bytes.
const FILE_LIMIT: u64 = 16 << 30;

/// A bundle open for reading.
#[derive(Clone)]
pub struct Scene {
    storage: Arc<dyn Storage>,
    manifest: Manifest,
}

/// One output of a bundle, for reading its files.
pub struct OutputReader {
    storage: Arc<dyn Storage>,
    name: String,
    folder: String,
    output: Output,
    /// Hashes of the files that the manifest does not name, by path.
    listed: BTreeMap<String, String>,
}

impl Scene {
    /// Opens a bundle by its folder, or by the `scene.json` in it.
    ///
    /// # Errors
    /// [`BundleError::NotABundle`], [`BundleError::Io`].
    pub fn open(path: &Path) -> Result<Self, BundleError> {
        let folder = match path.file_name() {
            Some(name) if name == layout::MANIFEST && path.is_file() => {
                path.parent().unwrap_or(path)
            }
            _ => path,
        };
        let folder = if folder.as_os_str().is_empty() {
            Path::new(".")
        } else {
            folder
        };
        Self::open_on(Arc::new(Disk::new(folder)))
    }

    pub(crate) fn open_on(storage: Arc<dyn Storage>) -> Result<Self, BundleError> {
        let path = storage.root().join(layout::MANIFEST);
        let bytes = storage::read_all(&*storage, layout::MANIFEST, layout::MANIFEST_LIMIT)
            .map_err(|error| match error.kind() {
                io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => BundleError::NotABundle {
                    path: storage.root().to_owned(),
                    found: format!("no {}", layout::MANIFEST),
                    expected: "a folder with one".to_owned(),
                },
                _ => doing("reading the manifest of a scene bundle", &path)(error),
            })?;
        let manifest = Manifest::parse(&bytes, &path)?;
        Ok(Self::of(storage, manifest))
    }

    pub(crate) fn of(storage: Arc<dyn Storage>, manifest: Manifest) -> Self {
        Self { storage, manifest }
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The folder.
    pub fn path(&self) -> PathBuf {
        self.storage.root().to_owned()
    }

    /// Whether there is such an output.
    pub fn has(&self, output: &str) -> bool {
        self.manifest.outputs.contains_key(output)
    }

    /// An output, for reading its files.
    ///
    /// # Errors
    /// [`BundleError::NoOutput`]; for one with a listing what [`OutputReader::read`] may give.
    ///
    /// ```
    /// # use scene_bundle::{Bundle, BundleError, Scene};
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
    /// # Bundle::create_or_open(&path, provenance)?.finish(1_790_000_001_000_000_000)?;
    /// // A bundle in which no stage has written anything yet.
    /// let scene = Scene::open(&path)?;
    /// assert!(!scene.has("trajectory"));
    /// let missing = scene.output("trajectory").map(drop).unwrap_err();
    /// assert!(missing.to_string().contains("it has no output trajectory, only an empty table"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn output(&self, name: &str) -> Result<OutputReader, BundleError> {
        let Some(output) = self.manifest.outputs.get(name) else {
            let names: Vec<&str> = self.manifest.outputs.keys().map(String::as_str).collect();
            return Err(BundleError::NoOutput {
                path: self.path(),
                name: name.to_owned(),
                found: if names.is_empty() {
                    "an empty table".to_owned()
                } else {
                    names.join(", ")
                },
            });
        };
        let mut reader = OutputReader {
            storage: self.storage.clone(),
            name: name.to_owned(),
            folder: layout::folder(name, &output.hash),
            output: output.clone(),
            listed: BTreeMap::new(),
        };
        if output.files.iter().any(|f| f.path == layout::LISTING) {
            let text = reader.read(layout::LISTING)?;
            reader.listed = parse_listing(&text, &reader.file_path(layout::LISTING))?;
        }
        Ok(reader)
    }

    /// Whether every file of an output is intact.
    pub fn is_whole(&self, name: &str) -> bool {
        let Ok(output) = self.output(name) else {
            return false;
        };
        output
            .paths()
            .all(|path| output.check(path, &mut |_| {}).is_ok())
    }

    /// Names in the folder, or in one below it; for finding files that nothing names.
    pub(crate) fn list(&self, dir: &str) -> Result<Vec<(String, bool)>, BundleError> {
        let path = self.storage.root().join(dir);
        self.storage
            .list(dir)
            .map_err(doing("listing a scene bundle", path))
    }
}

/// Lines `HASH  PATH`, as `b3sum` writes them.
fn parse_listing(text: &[u8], place: &Path) -> Result<BTreeMap<String, String>, BundleError> {
    let wrong = |line: usize, found: &str| BundleError::Malformed {
        path: place.to_owned(),
        place: format!("line {line}"),
        found: format!("{found:?}"),
        expected: "a hash, two blanks and a path in the output's folder".to_owned(),
    };
    let text = std::str::from_utf8(text).map_err(|_| wrong(1, "bytes that are no UTF-8"))?;
    let mut listed = BTreeMap::new();
    for (line, text) in (1..).zip(text.lines()) {
        let parts = text.split_once("  ");
        let (hash, path) = parts
            .filter(|(hash, path)| layout::is_hash(hash) && layout::is_file_path(path))
            .ok_or_else(|| wrong(line, text))?;
        listed.insert(path.to_owned(), hash.to_owned());
    }
    Ok(listed)
}

impl OutputReader {
    /// The output's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its provenance and files.
    pub fn output(&self) -> &Output {
        &self.output
    }

    /// Paths of all its files below its folder, those of the manifest first.
    pub fn paths(&self) -> impl Iterator<Item = &str> {
        let named = self.output.files.iter().map(|f| f.path.as_str());
        named.chain(self.listed.keys().map(String::as_str))
    }

    /// Its folder in the bundle.
    pub fn folder(&self) -> &str {
        &self.folder
    }

    /// Path of a file, for messages and for programs that read it themselves, unchecked.
    pub fn file_path(&self, path: &str) -> PathBuf {
        self.storage.root().join(&self.folder).join(path)
    }

    /// The content of a file, checked against its hash.
    ///
    /// # Errors
    /// [`BundleError::Changed`] when it is not what was written, or the output has no such file;
    /// [`BundleError::Io`].
    pub fn read(&self, path: &str) -> Result<Vec<u8>, BundleError> {
        let (bytes, hash) = self.expected_content(path)?;
        let full = format!("{}/{path}", self.folder);
        let content = match storage::read_all(
            &*self.storage,
            &full,
            bytes.unwrap_or(FILE_LIMIT).min(FILE_LIMIT),
        ) {
            Err(e) => match (too_long(&e), bytes) {
                // Longer than written: it is not read at all.
                (Some(found), Some(bytes)) => {
                    let found = format!("{found} bytes");
                    return Err(self.changed(path, &found, &bytes.to_string()));
                }
                _ => return Err(self.unreadable(path, e)),
            },
            Ok(content) => content,
        };
        let found = FileEntry {
            path: path.to_owned(),
            bytes: content.len() as u64,
            blake3: blake3::hash(&content).to_hex().to_string(),
        };
        self.compare(&found, bytes, hash)?;
        Ok(content)
    }

    /// Checks a file without keeping its content; gives its length. `progress` is called with bytes
    /// read.
    pub(crate) fn check(
        &self,
        path: &str,
        progress: &mut dyn FnMut(u64),
    ) -> Result<u64, BundleError> {
        let (bytes, hash) = self.expected_content(path)?;
        let full = format!("{}/{path}", self.folder);
        let mut file = self
            .storage
            .open(&full)
            .map_err(|e| self.unreadable(path, e))?;
        let (mut hasher, mut length, mut buffer) = (blake3::Hasher::new(), 0, vec![0; 1 << 18]);
        loop {
            let n = file
                .read(&mut buffer)
                .map_err(|e| self.unreadable(path, e))?;
            if n == 0 {
                break;
            }
            hasher.update(&buffer[..n]);
            length += n as u64;
            progress(n as u64);
        }
        let found = FileEntry {
            path: path.to_owned(),
            bytes: length,
            blake3: hasher.finalize().to_hex().to_string(),
        };
        self.compare(&found, bytes, hash)?;
        Ok(length)
    }

    /// Length, where it is known, and hash of a file as it was written.
    fn expected_content(&self, path: &str) -> Result<(Option<u64>, &str), BundleError> {
        let named = self.output.files.iter().find(|f| f.path == path);
        let named = named.map(|f| (Some(f.bytes), f.blake3.as_str()));
        let listed = || Some((None, self.listed.get(path)?.as_str()));
        named.or_else(listed).ok_or_else(|| {
            let expected = format!(
                "one of the {} files of output {}",
                self.paths().count(),
                self.name
            );
            self.changed(path, "a file that nothing names", &expected)
        })
    }

    fn compare(
        &self,
        found: &FileEntry,
        bytes: Option<u64>,
        hash: &str,
    ) -> Result<(), BundleError> {
        if let Some(bytes) = bytes.filter(|bytes| *bytes != found.bytes) {
            let (found_bytes, expected) = (format!("{} bytes", found.bytes), format!("{bytes}"));
            return Err(self.changed(&found.path, &found_bytes, &expected));
        }
        if found.blake3 != hash {
            let content = format!("content with the hash {}", found.blake3);
            return Err(self.changed(&found.path, &content, hash));
        }
        Ok(())
    }

    fn changed(&self, path: &str, found: &str, expected: &str) -> BundleError {
        BundleError::Changed {
            path: self.file_path(path),
            found: found.to_owned(),
            expected: expected.to_owned(),
        }
    }

    fn unreadable(&self, path: &str, error: io::Error) -> BundleError {
        if error.kind() == io::ErrorKind::NotFound {
            return self.changed(path, "no file", "the one that was written");
        }
        doing("reading a file of a scene bundle", self.file_path(path))(error)
    }
}

/// The length of a file that was refused for it.
fn too_long(error: &io::Error) -> Option<u64> {
    let found = error.get_ref()?.downcast_ref::<plain_file::TooLong>()?;
    Some(found.found)
}
