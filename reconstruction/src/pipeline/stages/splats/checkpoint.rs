//! Files of trainings that were not completed, in the bundle's folder and no part of the bundle:
//! one for each sector, with the state of its training or what a complete training left.
//!
//! Contract: a file is used only by a run with the same settings and inputs, and only if it is
//! whole. It is replaced in one step, so that a run that was killed while writing leaves the older
//! one. What cannot be used is discarded with a warning: the training then begins with its first
//! step.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::PathBuf;

use scene_bundle::layout;
use serde_json::{Value, json};
use splats::{CellBox, Cells};

const MAGIC: &[u8] = b"paws splats checkpoint 2\n";
/// Of a sector whose training is complete.
const COMPLETE: &[u8] = b"paws splats complete 2\n";
const HASH: usize = blake3::OUT_LEN;

/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 16 << 30;

/// Files of all sectors.
pub(super) struct CheckpointFiles {
    pub(super) folder: PathBuf,
    /// Version of the stage.
    pub(super) version: u32,
    pub(super) settings: Value,
    /// Hashes of the inputs.
    pub(super) inputs: Vec<String>,
}

impl CheckpointFiles {
    /// The file of a sector. Another division of the walk is another training.
    ///
    /// # Panics
    /// If there is no such cell.
    pub(super) fn of(&self, sector: usize, cells: &Cells) -> CheckpointFile {
        let count = cells.count();
        let CellBox { min_m, max_m } = cells.bounds(sector);
        let settings = json!({
            "version": self.version,
            "settings": self.settings,
            "sector": sector,
            "sectors": count,
            "min_m": min_m,
            "max_m": max_m,
        });
        let name = layout::splats_checkpoint((count > 1).then_some(sector));
        CheckpointFile::new(self.folder.join(name), &settings, &self.inputs)
    }
}

/// Where the state of a training is kept.
pub(super) struct CheckpointFile {
    path: PathBuf,
    /// Hashes of the settings and of the inputs.
    keys: [[u8; HASH]; 2],
}

/// Why a file cannot be used.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Unusable {
    /// Other settings, another version of the stage or another division into sectors.
    #[error("it is of other settings")]
    Settings,
    /// Other inputs.
    #[error("it is of other inputs")]
    Inputs,
    /// Damaged or of another version.
    #[error("it is damaged or of another version of this program")]
    Damaged,
}

impl CheckpointFile {
    pub(super) fn new(path: PathBuf, settings: &Value, inputs: &[String]) -> Self {
        let hash = |text: &str| *blake3::hash(text.as_bytes()).as_bytes();
        Self {
            path,
            keys: [hash(&settings.to_string()), hash(&inputs.join("\n"))],
        }
    }

    /// The state of a training in the file, if there is one that can be used.
    pub(super) fn read(&self) -> Option<Vec<u8>> {
        self.content(MAGIC)
    }

    /// What a complete training left, if that is in the file and can be used.
    pub(super) fn read_complete(&self) -> Option<Vec<u8>> {
        self.content(COMPLETE)
    }

    /// The content after one of the two first lines; nothing is said of a file with the other one.
    fn content(&self, first: &[u8]) -> Option<Vec<u8>> {
        let bytes = match plain_file::read(&self.path, MAX_BYTES) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return None,
            Err(error) => {
                log::warn!("reading a checkpoint: {error}: {}", self.path.display());
                return None;
            }
        };
        let other = if first == MAGIC { COMPLETE } else { MAGIC };
        // A file of neither is one of a training.
        if bytes.starts_with(other) || (first == COMPLETE && !bytes.starts_with(COMPLETE)) {
            return None;
        }
        match self.parse(&bytes, first) {
            Ok(state) => Some(state.to_vec()),
            Err(why) => {
                self.discarded(&why.to_string());
                None
            }
        }
    }

    /// Warns that the file is not used.
    pub(super) fn discarded(&self, why: &str) {
        log::warn!(
            "the checkpoint of the training is discarded, {why}: {}",
            self.path.display()
        );
    }

    fn parse<'b>(&self, bytes: &'b [u8], first: &[u8]) -> Result<&'b [u8], Unusable> {
        let rest = bytes.strip_prefix(first).ok_or(Unusable::Damaged)?;
        let (hashes, state) = rest.split_at_checked(3 * HASH).ok_or(Unusable::Damaged)?;
        let (hashes, _) = hashes.as_chunks::<HASH>();
        if hashes[0] != self.keys[0] {
            return Err(Unusable::Settings);
        }
        if hashes[1] != self.keys[1] {
            return Err(Unusable::Inputs);
        }
        match hashes[2] == *blake3::hash(state).as_bytes() {
            true => Ok(state),
            false => Err(Unusable::Damaged),
        }
    }

    /// Replaces the file by the state of a training, which goes on where this fails: it only loses
    /// more when it is killed.
    pub(super) fn write(&self, state: &[u8]) {
        self.replace(MAGIC, state);
    }

    /// Replaces the file by what a complete training left; as [`Self::write`].
    pub(super) fn write_complete(&self, content: &[u8]) {
        self.replace(COMPLETE, content);
    }

    fn replace(&self, first: &[u8], state: &[u8]) {
        let temporary = self.path.with_extension("checkpoint.tmp");
        let hash = blake3::hash(state);
        let written = File::create(&temporary).and_then(|mut file| {
            file.write_all(first)?;
            file.write_all(self.keys.as_flattened())?;
            file.write_all(hash.as_bytes())?;
            file.write_all(state)?;
            file.sync_all()?;
            fs::rename(&temporary, &self.path)
        });
        if let Err(error) = written {
            let _ = fs::remove_file(&temporary);
            log::warn!("writing a checkpoint: {error}: {}", self.path.display());
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;
    use splats::SectorConfig;

    use super::*;

    #[test]
    fn only_whole_checkpoints_of_the_same_training_are_used() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("splats.checkpoint");
        let inputs = ["a".to_owned(), "b".to_owned()];
        let of = |steps: u32, inputs: &[String]| {
            CheckpointFile::new(path.clone(), &json!({ "steps": steps }), inputs)
        };
        let file = of(7, &inputs);
        assert_eq!(file.read(), None);
        file.write(b"state");
        file.write(b"later state");
        assert_eq!(file.read(), Some(b"later state".to_vec()));
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1);

        let bytes = fs::read(&path).expect("a file");
        assert_eq!(of(8, &inputs).parse(&bytes, MAGIC), Err(Unusable::Settings));
        assert_eq!(of(8, &inputs).read(), None);
        assert_eq!(
            of(7, &inputs[..1]).parse(&bytes, MAGIC),
            Err(Unusable::Inputs)
        );
        for length in 0..bytes.len() {
            assert_eq!(
                file.parse(&bytes[..length], MAGIC),
                Err(Unusable::Damaged),
                "{length}"
            );
        }
        assert_eq!(file.read_complete(), None);
        file.write_complete(b"Gaussians");
        assert_eq!(file.read(), None);
        assert_eq!(file.read_complete(), Some(b"Gaussians".to_vec()));
        assert_eq!(of(8, &inputs).read_complete(), None);
        // A folder that cannot be written to costs the checkpoint and nothing else.
        let nowhere = folder.path().join("none/splats.checkpoint");
        CheckpointFile::new(nowhere, &json!({}), &[]).write(b"state");
    }

    #[test]
    fn sectors_do_not_take_each_others_files() {
        let folder = tempfile::tempdir().expect("a folder");
        let of_version = |version| CheckpointFiles {
            folder: folder.path().to_owned(),
            version,
            settings: json!({ "steps": 7 }),
            inputs: vec!["a".to_owned()],
        };
        let files = of_version(3);
        // Of 10 positions each, m.
        let cells = |count: u32, from_m: f64| {
            let positions = (0..10 * count).map(|k| [from_m + f64::from(k), 0.0, 0.0]);
            let positions: Vec<[f64; 3]> = positions.collect();
            Cells::of_positions(&positions, 10, &SectorConfig::default())
        };
        let three = cells(3, 0.0);
        assert_eq!(three.count(), 3);
        files.of(0, &three).write_complete(b"first");
        files.of(1, &three).write(b"second");
        assert_eq!(files.of(0, &three).read_complete(), Some(b"first".to_vec()));
        assert_eq!(files.of(1, &three).read(), Some(b"second".to_vec()));
        // Another version, other borders, and the same borders in another number of cells.
        assert_eq!(of_version(4).of(0, &three).read_complete(), None);
        assert_eq!(files.of(0, &cells(3, 0.5)).read_complete(), None);
        let two = cells(2, 0.0);
        assert_eq!(two.bounds(0), three.bounds(0));
        assert_eq!(files.of(0, &two).read_complete(), None);
        let one = |version: u32| of_version(version).of(0, &cells(1, 0.0));
        one(3).write(b"all");
        assert_eq!(one(3).read(), Some(b"all".to_vec()));
        assert_eq!(one(4).read(), None);
        let path = |sector: usize| folder.path().join(format!("splats-00{sector}.checkpoint"));
        fs::copy(path(0), path(2)).expect("a copy");
        assert_eq!(files.of(2, &three).read_complete(), None);
    }
}
