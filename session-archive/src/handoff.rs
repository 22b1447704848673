//! The hand-off: a session, sealed for whoever works on it next.
//!
//! `handoff.json` names every file that makes up a validated session, with its length and BLAKE3
//! hash, the verdict of the validation, and a seal: the BLAKE3 hash of the rest of the manifest. It
//! lies in the session's folder, so all paths are relative and the folder can be moved. Opening a
//! hand-off checks the seal and the files; one that is not validated, failed, or changed is refused.

use std::io;

use serde::{Deserialize, Serialize};

use crate::layout;
use crate::storage::{self, Storage};
use crate::time::CivilTime;

/// Value of [`HandOff::format`].
pub const FORMAT: &str = "paws-handoff";
/// The version that this crate writes and reads.
pub const VERSION: u32 = 1;

/// Outcome of a validation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Verdict {
    /// All metrics within their limits.
    Pass,
    /// Usable, with something to look at.
    Warn,
    /// Not to be used.
    Fail,
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Pass => "PASS",
            Self::Warn => "WARN",
            Self::Fail => "FAIL",
        })
    }
}

/// A sealed file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SealedFile {
    /// Path below the session's folder.
    pub path: String,
    /// Length, bytes.
    pub bytes: u64,
    /// BLAKE3 of the content, hex.
    pub blake3: String,
}

/// The hand-off manifest.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HandOff {
    /// [`FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// The session.
    pub session_id: String,
    /// What sealed it.
    pub software: String,
    /// When, as well as the host knew.
    pub sealed: CivilTime,
    /// Verdict of the validation that it rests on.
    pub verdict: Verdict,
    /// Manifest, rig files, segments, index and validation report.
    pub files: Vec<SealedFile>,
    /// BLAKE3 of this manifest with an empty seal, hex.
    pub seal: String,
}

/// How much of a hand-off's files to check when opening it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Check {
    /// Every byte.
    Content,
    /// Presence and length only: for opening a hand-off again that was checked before.
    Lengths,
}

/// Why a hand-off is refused.
#[derive(Debug, thiserror::Error)]
pub enum HandOffError {
    /// There is none, or the disk says no: run `paws handoff`.
    #[error("reading {path}")]
    Io {
        /// What was being read or written.
        path: String,
        /// What failed.
        #[source]
        error: io::Error,
    },
    /// The manifest is no hand-off of this version, or was edited.
    #[error("{manifest} is not valid: {0}", manifest = layout::HANDOFF)]
    Invalid(String),
    /// The validation failed; the session must not be used.
    #[error("the session failed its validation")]
    Failed,
    /// A file is not what was sealed: validate and hand over again.
    #[error("{path} changed since it was handed over: {what}")]
    Changed {
        /// The file.
        path: String,
        /// How it differs.
        what: String,
    },
}

impl HandOff {
    /// Seals the files at `paths` as they are, and writes the manifest.
    ///
    /// # Errors
    /// A file is missing, or the disk says no.
    pub fn seal(
        storage: &dyn Storage,
        session_id: &str,
        verdict: Verdict,
        software: &str,
        sealed: CivilTime,
        paths: &[String],
        mut progress: impl FnMut(u64),
    ) -> Result<Self, HandOffError> {
        let files = paths.iter();
        let files = files.map(|path| SealedFile::of(storage, path, &mut progress));
        let files = files.collect::<Result<_, _>>()?;
        Self::seal_files(storage, session_id, verdict, software, sealed, files)
    }

    /// Seals files that were hashed before, and writes the manifest.
    ///
    /// # Errors
    /// The disk says no.
    pub fn seal_files(
        storage: &dyn Storage,
        session_id: &str,
        verdict: Verdict,
        software: &str,
        sealed: CivilTime,
        files: Vec<SealedFile>,
    ) -> Result<Self, HandOffError> {
        let mut handoff = Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            session_id: session_id.to_owned(),
            software: software.to_owned(),
            sealed,
            verdict,
            files,
            seal: String::new(),
        };
        handoff.seal = handoff.computed_seal();
        let text = serde_json::to_vec_pretty(&handoff).unwrap_or_default();
        storage::replace(storage, layout::HANDOFF, &text).map_err(|error| HandOffError::Io {
            path: layout::HANDOFF.to_owned(),
            error,
        })?;
        Ok(handoff)
    }

    /// Opens the hand-off in a session's folder.
    ///
    /// # Errors
    /// See [`HandOffError`].
    pub fn open(
        storage: &dyn Storage,
        check: Check,
        mut progress: impl FnMut(u64),
    ) -> Result<Self, HandOffError> {
        let text =
            storage::read_all(storage, layout::HANDOFF).map_err(|error| HandOffError::Io {
                path: layout::HANDOFF.to_owned(),
                error,
            })?;
        let handoff: Self =
            serde_json::from_slice(&text).map_err(|e| HandOffError::Invalid(e.to_string()))?;
        if handoff.format != FORMAT || handoff.version != VERSION {
            let found = format!("it is {} version {}", handoff.format, handoff.version);
            return Err(HandOffError::Invalid(found));
        }
        if handoff.computed_seal() != handoff.seal {
            return Err(HandOffError::Invalid("its seal does not match".to_owned()));
        }
        if handoff.verdict == Verdict::Fail {
            return Err(HandOffError::Failed);
        }
        for file in &handoff.files {
            file.check(storage, check, &mut progress)?;
        }
        Ok(handoff)
    }

    fn computed_seal(&self) -> String {
        let unsealed = Self {
            seal: String::new(),
            ..self.clone()
        };
        let text = serde_json::to_vec(&unsealed).unwrap_or_default();
        blake3::hash(&text).to_hex().to_string()
    }
}

impl SealedFile {
    /// A file as it is now; `progress` is called with the bytes read.
    ///
    /// # Errors
    /// The file is missing, or the disk says no.
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

    fn check(
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
                return Err(changed("it is gone".to_owned()));
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
