//! Cache of rendered images of walks.
//!
//! Contract: `FOLDER/HASH/CAMERA.grey` has the frames of one camera that are in sets, or the first
//! of them, each the left eye's rows and then the right eye's, without header or gaps;
//! `HASH/walk.txt` is the hashed text. A file with too few frames is rendered again.
//! The hash covers all inputs of an image: settings, faults, rig, and the simulator, as what it
//! renders now (see [`simulator`]): changes of its code that change no image keep the cache.
//! *On failure* a partial file has another name, and is rewritten. Two programs may render the same
//! walk simultaneously: the file is the same whichever finishes first.

use std::collections::{HashMap, VecDeque};
use std::fs::{self, File};
use std::io::{BufReader, BufWriter, Read as _};
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex};
use std::thread;

use anyhow::{Context as _, Result, ensure};
use rig_sim::simulation::FrameSource as _;

use super::Reader;
use super::walk::{Walk, WalkCamera};

/// Rendering threads.
const THREADS: usize = 2;
/// Number of frames of each camera that identify the simulator, evenly over the walk.
const PROBES: u64 = 4;
/// Sources of the simulator, relative to this crate.
const SOURCES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../synthetic/rig-sim/src");

/// The cached images of one camera.
#[derive(Clone, Debug)]
pub(super) struct CachedCamera {
    path: PathBuf,
    /// Size of one eye's image, bytes.
    eye: usize,
}

impl CachedCamera {
    /// Reads pairs in order.
    pub(super) fn reader(&self) -> Result<Reader> {
        let path = self.path.clone();
        let eye = self.eye;
        let file = File::open(&path).with_context(|| format!("opening {}", path.display()))?;
        let mut file = BufReader::with_capacity(2 * eye, file);
        Ok(Box::new(move || {
            let mut pair = [vec![0; eye], vec![0; eye]];
            for pixels in &mut pair {
                let read = file.read_exact(pixels);
                read.with_context(|| format!("reading {}", path.display()))?;
            }
            Ok(pair)
        }))
    }
}

/// Renders images that are not in the cache: of each camera its first `pairs`.
pub(super) fn store(walk: &Walk, pairs: &[usize], folder: &Path) -> Result<Vec<CachedCamera>> {
    let key = format!("{}\n{}\n", walk.key, simulator(walk)?);
    let hash = blake3::hash(key.as_bytes()).to_hex();
    let folder = folder.join(&hash[..16]);
    fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
    let settings = walk.simulation.settings();
    let eye = settings.width as usize * settings.height as usize;
    let stored = |camera: &WalkCamera| CachedCamera {
        path: folder.join(format!("{}.grey", camera.name)),
        eye,
    };
    let has_images = |camera: &WalkCamera, pairs: usize| {
        let file = fs::metadata(stored(camera).path);
        file.is_ok_and(|file| file.len() >= (pairs * 2 * eye) as u64)
    };
    let absent: VecDeque<(&WalkCamera, usize)> = (walk.cameras.iter().zip(pairs.iter().copied()))
        .filter(|(camera, pairs)| !has_images(camera, *pairs))
        .collect();
    if !absent.is_empty() {
        replace(&folder.join("walk.txt"), |file| {
            Ok(file.write_all(key.as_bytes())?)
        })?;
    }
    let queue = Mutex::new(absent);
    let work = || -> Result<()> {
        loop {
            let next = queue.lock().expect("no thread panics with it").pop_front();
            let Some((camera, pairs)) = next else {
                return Ok(());
            };
            replace(&stored(camera).path, |file| {
                for eye in walk.frames(camera).take(pairs).flatten() {
                    file.write_all(&eye)?;
                }
                Ok(())
            })?;
        }
    };
    thread::scope(|scope| {
        let running: Vec<_> = (0..THREADS).map(|_| scope.spawn(work)).collect();
        (running.into_iter())
            .try_for_each(|thread| thread.join().expect("rendering does not panic"))
    })?;
    for (camera, pairs) in walk.cameras.iter().zip(pairs) {
        let path = stored(camera).path;
        let found = fs::metadata(&path)?.len();
        let expected = (pairs * 2 * eye) as u64;
        ensure!(
            found >= expected && found.is_multiple_of(2 * eye as u64),
            "found {found} bytes of images, expected {expected} or more: remove {}",
            path.display()
        );
    }
    Ok(walk.cameras.iter().map(stored).collect())
}

/// Writes a file under a temporary name, and then renames it.
fn replace(path: &Path, write: impl FnOnce(&mut dyn std::io::Write) -> Result<()>) -> Result<()> {
    let folder = path.parent().context("a file has a parent folder")?;
    let beside = tempfile::NamedTempFile::new_in(folder)?;
    let mut file = BufWriter::with_capacity(1 << 20, beside);
    write(&mut file).with_context(|| format!("writing {}", path.display()))?;
    let beside = file.into_inner().map_err(|e| e.into_error())?;
    beside.persist(path)?;
    Ok(())
}

/// Hash that identifies what the simulator renders. Without faults: some frames of every camera,
/// and the trajectory of the rig at all frames. Faults act on images in between: with them also the
/// simulator's sources. The hash is computed once per walk and program.
fn simulator(walk: &Walk) -> Result<String> {
    static KNOWN: LazyLock<Mutex<HashMap<String, String>>> = LazyLock::new(Mutex::default);
    let known = || KNOWN.lock().expect("no thread panics with it");
    if let Some(hash) = known().get(&walk.key) {
        return Ok(hash.clone());
    }
    let simulation = &walk.simulation;
    let settings = simulation.settings();
    let frames = settings.frame_count();
    let probe = |camera: usize| {
        let mut hasher = blake3::Hasher::new();
        let mut renderer = simulation.frames(camera);
        for k in 0..PROBES {
            let number = k * (frames - 1) / (PROBES - 1);
            let frame = renderer.render_frame(number, settings.frame_ns(number));
            hasher.update(&frame.i420);
        }
        hasher.finalize()
    };
    let mut hasher = blake3::Hasher::new();
    thread::scope(|scope| {
        let cameras = 0..simulation.cameras().len();
        let probes: Vec<_> = cameras.map(|c| scope.spawn(move || probe(c))).collect();
        for probe in probes {
            let probe = probe.join().expect("rendering does not panic");
            hasher.update(probe.as_bytes());
        }
    });
    for number in 0..frames {
        let (position, rotation) = simulation.world_from_rig(settings.frame_ns(number));
        for value in position.iter().chain(rotation.coords.iter()) {
            hasher.update(&value.to_le_bytes());
        }
    }
    let mut hash = hasher.finalize().to_hex().to_string();
    if walk.has_faults() {
        hash += &format!(" {}", sources()?);
    }
    known().insert(walk.key.clone(), hash.clone());
    Ok(hash)
}

/// Hash of the simulator's sources.
fn sources() -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    let mut folders = vec![PathBuf::from(SOURCES)];
    while let Some(folder) = folders.pop() {
        let entries = fs::read_dir(&folder).with_context(|| {
            format!(
                "reading the sources of the simulator in {}",
                folder.display()
            )
        })?;
        let mut paths = (entries.map(|e| e.map(|e| e.path()))).collect::<Result<Vec<_>, _>>()?;
        paths.sort();
        for path in paths {
            match path.is_dir() {
                true => folders.push(path),
                false => drop(hasher.update(&fs::read(&path)?)),
            }
        }
    }
    Ok(hasher.finalize().to_hex().to_string())
}
