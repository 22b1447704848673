//! Writing a bundle.
//!
//! Contract: a [`Bundle`] is the only writer of its folder; a second one is refused. Outputs are
//! written in drafts and appear complete or not at all. A process killed or a power cut at any
//! instant leaves a bundle that opens with its committed outputs: the output that was being
//! replaced is the old one or the new one. Remains of a killed writer are removed by the next one.

use std::collections::BTreeSet;
use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::draft::Draft;
use crate::error::{BundleError, doing};
use crate::layout;
use crate::manifest::{Manifest, Provenance, VERSION};
use crate::scene::Scene;
use crate::storage::{self, Disk, Storage};

/// A bundle open for writing.
///
/// A folder has one writer at a time, and one source for all of its life:
///
/// ```
/// use scene_bundle::{Bundle, BundleError};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("walk.scene");
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
/// let bundle = Bundle::create_or_open(&path, provenance.clone())?;
/// let second = Bundle::create_or_open(&path, provenance.clone());
/// assert!(matches!(second, Err(BundleError::Locked { .. })));
/// drop(bundle);
///
/// let mut other = provenance;
/// other.handoff_blake3 = "cd".repeat(32);
/// let refused = Bundle::create_or_open(&path, other);
/// assert!(matches!(refused, Err(BundleError::OtherSource { .. })));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Bundle {
    shared: Arc<Shared>,
}

/// State shared by a bundle and its drafts.
pub(crate) struct Shared {
    pub(crate) storage: Arc<dyn Storage>,
    pub(crate) manifest: Mutex<Manifest>,
    /// Names of outputs that are being written.
    pub(crate) drafts: Mutex<BTreeSet<String>>,
    /// Held as long as the bundle or one of its drafts lives.
    _lock: Option<File>,
}

impl Bundle {
    /// Opens the bundle in a folder for writing, or creates one, with missing parent folders.
    /// Unfinished work of an earlier writer is removed. An existing bundle must be of the same
    /// hand-off; the rest of its provenance (program, times, rig) is replaced.
    ///
    /// # Errors
    /// [`BundleError::Locked`], [`BundleError::OtherSource`], [`BundleError::NotABundle`] (also for
    /// a folder that holds something else), [`BundleError::Refused`] for a provenance without a
    /// hash, [`BundleError::Io`].
    pub fn create_or_open(path: &Path, provenance: Provenance) -> Result<Self, BundleError> {
        let disk = Disk::new(path);
        disk.make_root()
            .map_err(doing("making the folder of a scene bundle", path))?;
        let existing = storage::read_all(&disk, layout::MANIFEST, layout::MANIFEST_LIMIT);
        if matches!(&existing, Err(e) if e.kind() == io::ErrorKind::NotFound) {
            refuse_others(&disk)?;
        }
        let lock = lock(path)?;
        Self::open_on(Arc::new(disk), provenance, Some(lock))
    }

    /// On any storage, with the lock held.
    pub(crate) fn open_on(
        storage: Arc<dyn Storage>,
        provenance: Provenance,
        lock: Option<File>,
    ) -> Result<Self, BundleError> {
        let root = storage.root().to_owned();
        if !layout::is_hash(&provenance.handoff_blake3) {
            return Err(BundleError::Refused {
                path: root,
                found: format!(
                    "{:?} as the hash of the hand-off",
                    provenance.handoff_blake3
                ),
                expected: "64 hexadecimal digits".to_owned(),
            });
        }
        let path = root.join(layout::MANIFEST);
        let mut manifest =
            match storage::read_all(&*storage, layout::MANIFEST, layout::MANIFEST_LIMIT) {
                Ok(bytes) => Manifest::parse(&bytes, &path)?,
                Err(e) if e.kind() == io::ErrorKind::NotFound => Manifest::new(provenance.clone()),
                Err(e) => return Err(doing("reading the manifest of a scene bundle", path)(e)),
            };
        let source = |p: &Provenance| (p.session_id.clone(), p.handoff_blake3.clone());
        let (old, new) = (source(&manifest.provenance), source(&provenance));
        if old != new {
            let text =
                |(session, hash): (String, String)| format!("session {session} with seal {hash}");
            return Err(BundleError::OtherSource {
                path: root,
                found: text(old),
                expected: text(new),
            });
        }
        clean(&*storage, &manifest).map_err(doing(
            "removing what an earlier writer left in a scene bundle",
            &root,
        ))?;
        manifest.provenance = provenance;
        manifest.version = VERSION;
        let bundle = Self {
            shared: Arc::new(Shared {
                storage,
                manifest: Mutex::new(manifest.clone()),
                drafts: Mutex::default(),
                _lock: lock,
            }),
        };
        bundle.shared.replace_manifest(&manifest)?;
        Ok(bundle)
    }

    /// Begins an output. It is invisible until it is committed; the previous version remains until
    /// then.
    ///
    /// # Errors
    /// [`BundleError::Refused`] for a name that the format does not allow, or an output that is
    /// already being written; [`BundleError::Io`].
    pub fn begin(&self, output: &str) -> Result<Draft, BundleError> {
        Draft::begin(&self.shared, output)
    }

    /// The manifest as it is on disk.
    pub fn manifest(&self) -> Manifest {
        self.shared.manifest().clone()
    }

    /// The bundle for reading, in its current state. Outputs committed later are not in it, and one
    /// that is replaced can no longer be read through it.
    pub fn scene(&self) -> Scene {
        Scene::of(self.shared.storage.clone(), self.manifest())
    }

    /// Records the time at which the program ended, ns of UTC since 1970.
    ///
    /// # Errors
    /// [`BundleError::Io`].
    pub fn finish(self, ended_civil_ns: i64) -> Result<(), BundleError> {
        let mut manifest = self.manifest();
        manifest.provenance.ended_civil_ns = Some(ended_civil_ns);
        self.shared.replace_manifest(&manifest)
    }

    /// The folder.
    pub fn path(&self) -> PathBuf {
        self.shared.storage.root().to_owned()
    }
}

impl Shared {
    pub(crate) fn manifest(&self) -> MutexGuard<'_, Manifest> {
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn drafts(&self) -> MutexGuard<'_, BTreeSet<String>> {
        self.drafts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn replace_manifest(&self, manifest: &Manifest) -> Result<(), BundleError> {
        let path = self.storage.root().join(layout::MANIFEST);
        storage::replace(&*self.storage, layout::MANIFEST, &manifest.to_json())
            .map_err(doing("writing the manifest of a scene bundle", path))
    }
}

/// A folder without a manifest may hold nothing but remains of a killed writer.
fn refuse_others(disk: &Disk) -> Result<(), BundleError> {
    let root = disk.root();
    let entries = disk
        .list("")
        .map_err(doing("listing the folder of a scene bundle", root))?;
    let other = entries
        .iter()
        .find(|(name, _)| name != layout::LOCK && !layout::is_ours(name));
    match other {
        None => Ok(()),
        Some((name, _)) => Err(BundleError::NotABundle {
            path: root.to_owned(),
            found: format!("a folder that holds {name:?} and no {}", layout::MANIFEST),
            expected: "a bundle, or an empty or new folder".to_owned(),
        }),
    }
}

fn lock(root: &Path) -> Result<File, BundleError> {
    let path = root.join(layout::LOCK);
    let file = File::options()
        .write(true)
        .create(true)
        .truncate(false)
        .open(&path)
        .map_err(doing("opening the lock of a scene bundle", &path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(BundleError::Locked {
            path: root.to_owned(),
        }),
        Err(TryLockError::Error(error)) => Err(doing("locking a scene bundle", &path)(error)),
    }
}

/// Removes drafts, versions that the manifest does not name, and a manifest that was being written.
fn clean(storage: &dyn Storage, manifest: &Manifest) -> io::Result<()> {
    let outputs = manifest.outputs.iter();
    let named: BTreeSet<String> = outputs
        .map(|(name, output)| layout::folder(name, &output.hash))
        .collect();
    for (name, is_dir) in storage.list("")? {
        if !layout::is_ours(&name) || named.contains(&name) {
            continue;
        }
        if is_dir {
            storage::remove_all(storage, &name)?;
        } else {
            storage.remove_file(&name)?;
        }
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests;
