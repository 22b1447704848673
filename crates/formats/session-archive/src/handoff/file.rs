//! A file of a hand-off: its length and its hash.

use std::io;

use serde::{Deserialize, Serialize};

use super::{Check, HandOffError};
use crate::storage::Storage;

/// A file with the length and the hash of its content.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SealedFile {
    /// Path below the session's folder.
    pub path: String,
    /// Length, bytes.
    pub bytes: u64,
    /// BLAKE3 of the content, hex.
    pub blake3: String,
}

impl SealedFile {
    /// A file as it is now; `progress` is called with the bytes read.
    ///
    /// # Errors
    /// The file is missing, or the file system reports an I/O error.
    pub fn of(
        storage: &dyn Storage,
        path: &str,
        mut progress: impl FnMut(u64),
    ) -> Result<Self, HandOffError> {
        let (bytes, blake3) = hash(storage, path, &mut progress)?;
        Ok(Self {
            path: path.to_owned(),
            bytes,
            blake3,
        })
    }

    /// Checks that the file still has this length and hash.
    pub(super) fn check(
        &self,
        storage: &dyn Storage,
        check: Check,
        progress: &mut impl FnMut(u64),
    ) -> Result<(), HandOffError> {
        let changed = |what: String| HandOffError::Changed {
            path: self.path.clone(),
            what,
        };
        let length = match storage.open(&self.path).and_then(|f| f.len()) {
            Ok(length) => length,
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                return Err(changed("it is missing".to_owned()));
            }
            Err(error) => {
                return Err(HandOffError::Io {
                    path: self.path.clone(),
                    error,
                });
            }
        };
        if length != self.bytes {
            return Err(changed(format!("{length} bytes instead of {}", self.bytes)));
        }
        if check == Check::Content && hash(storage, &self.path, progress)?.1 != self.blake3 {
            return Err(changed("its content has another hash".to_owned()));
        }
        Ok(())
    }
}

/// Length and BLAKE3 of a file, a piece at a time.
fn hash(
    storage: &dyn Storage,
    path: &str,
    progress: &mut impl FnMut(u64),
) -> Result<(u64, String), HandOffError> {
    let failed = |error| HandOffError::Io {
        path: path.to_owned(),
        error,
    };
    let file = storage.open(path).map_err(failed)?;
    let mut hasher = blake3::Hasher::new();
    let mut buf = vec![0; 1 << 20];
    let mut at = 0;
    loop {
        let n = file.read_at(&mut buf, at).map_err(failed)?;
        if n == 0 {
            return Ok((at, hasher.finalize().to_hex().to_string()));
        }
        hasher.update(&buf[..n]);
        at += n as u64;
        progress(n as u64);
    }
}
