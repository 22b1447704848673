//! The file of a training that was not completed, in the bundle's folder and no part of the bundle.
//!
//! Contract: it is used only by a run with the same settings and inputs, and only if it is whole.
//! It is replaced in one step, so that a run that was killed while writing leaves the older one.
//! What cannot be used is discarded with a warning: the training then begins with its first step.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::PathBuf;

use serde_json::Value;

const MAGIC: &[u8] = b"paws splats checkpoint 1\n";
const HASH: usize = blake3::OUT_LEN;

/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 16 << 30;

/// Where the state of a training is kept.
pub(super) struct CheckpointFile {
    path: PathBuf,
    /// Hashes of the settings and of the inputs.
    keys: [[u8; HASH]; 2],
}

/// Why a file cannot be used.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Unusable {
    /// Other settings.
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

    /// The state in the file, if there is one that can be used.
    pub(super) fn read(&self) -> Option<Vec<u8>> {
        let bytes = match plain_file::read(&self.path, MAX_BYTES) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return None,
            Err(error) => {
                log::warn!("reading a checkpoint: {error}: {}", self.path.display());
                return None;
            }
        };
        match self.parse(&bytes) {
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

    fn parse<'b>(&self, bytes: &'b [u8]) -> Result<&'b [u8], Unusable> {
        let rest = bytes.strip_prefix(MAGIC).ok_or(Unusable::Damaged)?;
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

    /// Replaces the file. A training goes on where this fails: it only loses more when it is
    /// killed.
    pub(super) fn write(&self, state: &[u8]) {
        let temporary = self.path.with_extension("checkpoint.tmp");
        let hash = blake3::hash(state);
        let written = File::create(&temporary).and_then(|mut file| {
            file.write_all(MAGIC)?;
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
        assert_eq!(of(8, &inputs).parse(&bytes), Err(Unusable::Settings));
        assert_eq!(of(8, &inputs).read(), None);
        assert_eq!(of(7, &inputs[..1]).parse(&bytes), Err(Unusable::Inputs));
        for length in 0..bytes.len() {
            assert_eq!(
                file.parse(&bytes[..length]),
                Err(Unusable::Damaged),
                "{length}"
            );
        }
        // A folder that cannot be written to costs the checkpoint and nothing else.
        let nowhere = folder.path().join("none/splats.checkpoint");
        CheckpointFile::new(nowhere, &json!({}), &[]).write(b"state");
    }
}
