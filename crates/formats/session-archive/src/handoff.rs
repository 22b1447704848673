//! The hand-off: a session, sealed for the programs that process it next.
//!
//! `handoff.json` names every recorded file of a session with its length and BLAKE3 hash; the seal
//! is the BLAKE3 of that list and nothing else, so the same recording has the same seal however
//! often it is handed over. Beside the seal, and not hashed into it, stand the derived files that
//! reading relies on, the verdict of the validation, the limits that it was reached with, and the
//! acceptance where a session is handed over in spite of its verdict. It lies in the session's
//! folder, so all paths are relative and the folder can be moved. Opening a hand-off checks the
//! document, the seal and the files; one that is not validated, failed without being accepted, or
//! changed is refused. A later validation does not change it ([`later_verdict`]).
//!
//! Version 1 had the verdict and `validation.json` in its seal. It is read, with a note
//! ([`HandOff::notes`]).

use std::io;

use serde::{Deserialize, Serialize};

use crate::layout;
use crate::storage::{self, Storage};
use crate::time::CivilTime;

mod acceptance;
mod file;
mod version1;

pub use acceptance::{Acceptance, Beyond};
pub use file::SealedFile;

/// Value of [`HandOff::format`].
pub const FORMAT: &str = "paws-handoff";
/// The version that this crate writes; it reads version 1 too.
pub const VERSION: u32 = 2;

/// Marks the line of the document's hash, which covers everything before it.
const HASH_KEY: &str = "\n  \"blake3\": \"";
/// Behind the hash.
const END: &str = "\"\n}\n";

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

/// The hand-off manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HandOff {
    /// [`FORMAT`].
    pub format: String,
    /// [`VERSION`], or 1.
    pub version: u32,
    /// The session.
    pub session_id: String,
    /// What was recorded: manifest, rig files, segments.
    pub files: Vec<SealedFile>,
    /// [`seal_of`] the session and its files; of version 1 the BLAKE3 of the whole document.
    pub seal: String,
    /// Seals of version 1 under which exactly these recorded files were handed over before.
    pub earlier_seals: Vec<String>,
    /// Files that were made of the recording and that reading relies on: the index.
    pub derived: Vec<SealedFile>,
    /// What wrote this.
    pub software: String,
    /// When, as well as the host knew.
    pub sealed: CivilTime,
    /// Verdict of the validation that it rests on.
    pub verdict: Verdict,
    /// The limits of that validation that were not those of the validator's own table, as
    /// `METRIC=WARN,FAIL`.
    pub limits: Vec<String>,
    /// The acceptance, where it is handed over in spite of the verdict.
    pub acceptance: Option<Acceptance>,
}

/// What accompanies a seal: the software, the time, and the result of the validation.
#[derive(Clone, Debug, PartialEq)]
pub struct Statement {
    /// As [`HandOff::software`].
    pub software: String,
    /// As [`HandOff::sealed`].
    pub sealed: CivilTime,
    /// As [`HandOff::verdict`].
    pub verdict: Verdict,
    /// As [`HandOff::limits`].
    pub limits: Vec<String>,
    /// As [`HandOff::acceptance`].
    pub acceptance: Option<Acceptance>,
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
    /// The session has no hand-off: run `paws handoff`.
    #[error("it has not been handed over, there is no {manifest}; `paws handoff` writes it", manifest = layout::HANDOFF)]
    Missing,
    /// The file system reports an I/O error.
    #[error("reading {path}")]
    Io {
        /// What was being read or written.
        path: String,
        /// What failed.
        #[source]
        error: io::Error,
    },
    /// The manifest is no hand-off of a version that is known, or was edited: hand over again.
    #[error("{manifest} is not valid: {0}; `paws handoff` writes it again", manifest = layout::HANDOFF)]
    Invalid(String),
    /// The validation failed, and nobody accepted that; the session must not be used.
    #[error(
        "the session failed its validation, and was not accepted in spite of it, as `paws handoff --accept FAIL` does"
    )]
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

/// The seal of a session: BLAKE3, hex, of the lines `paws-handoff 2\n`, `SESSION_ID\n`, and
/// `BLAKE3 BYTES PATH\n` of each recorded file in the order of the bytes of their paths.
///
/// The seal does not depend on the order of the list:
///
/// ```
/// use session_archive::handoff::{SealedFile, seal_of};
/// use session_archive::storage::FaultStorage;
///
/// let session = FaultStorage::new();
/// session.set_content("session.json", b"{}".to_vec());
/// session.set_content("segments/000000.mcap", b"chunks".to_vec());
/// let manifest = SealedFile::of(&session, "session.json", |_| {})?;
/// let segment = SealedFile::of(&session, "segments/000000.mcap", |_| {})?;
/// let seal = seal_of("0192aa00", &[manifest.clone(), segment.clone()]);
/// assert_eq!(seal, seal_of("0192aa00", &[segment, manifest.clone()]));
/// assert_ne!(seal, seal_of("0192aa00", &[manifest]));
/// # Ok::<(), session_archive::handoff::HandOffError>(())
/// ```
pub fn seal_of(session_id: &str, files: &[SealedFile]) -> String {
    let mut files: Vec<&SealedFile> = files.iter().collect();
    files.sort_by(|a, b| a.path.cmp(&b.path));
    let mut hasher = blake3::Hasher::new();
    hasher.update(format!("{FORMAT} {VERSION}\n{session_id}\n").as_bytes());
    for file in files {
        hasher.update(format!("{} {} {}\n", file.blake3, file.bytes, file.path).as_bytes());
    }
    hasher.finalize().to_hex().to_string()
}

/// The verdict in `validation.json`, which the last validation left beside the hand-off; none if
/// there is none that can be read.
///
/// ```
/// use session_archive::handoff::{Verdict, later_verdict};
/// use session_archive::storage::FaultStorage;
///
/// let session = FaultStorage::new();
/// assert_eq!(later_verdict(&session), None);
/// session.set_content("validation.json", br#"{ "verdict": "WARN" }"#.to_vec());
/// assert_eq!(later_verdict(&session), Some(Verdict::Warn));
/// ```
pub fn later_verdict(storage: &dyn Storage) -> Option<Verdict> {
    #[derive(Deserialize)]
    struct Validation {
        verdict: Verdict,
    }
    let text = storage::read_all(storage, layout::VALIDATION).ok()?;
    let validation: Validation = serde_json::from_slice(&text).ok()?;
    Some(validation.verdict)
}

impl HandOff {
    /// A hand-off of files that were hashed: recorded ones, and derived ones beside them.
    pub fn new(
        session_id: &str,
        files: Vec<SealedFile>,
        derived: Vec<SealedFile>,
        said: Statement,
    ) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            session_id: session_id.to_owned(),
            seal: seal_of(session_id, &files),
            files,
            earlier_seals: Vec::new(),
            derived,
            software: said.software,
            sealed: said.sealed,
            verdict: said.verdict,
            limits: said.limits,
            acceptance: said.acceptance,
        }
    }

    /// Hashes the files at `paths` as they are, and writes a hand-off of them that accepts nothing.
    /// The index among them is taken as derived.
    ///
    /// # Errors
    /// A file is missing, or the file system reports an I/O error.
    ///
    /// ```
    /// use session_archive::handoff::{Check, HandOff, Verdict};
    /// use session_archive::storage::FaultStorage;
    /// use session_archive::time::CivilTime;
    ///
    /// let session = FaultStorage::new();
    /// session.set_content("session.json", b"{}".to_vec());
    /// session.set_content("segments/000000.mcap", b"chunks".to_vec());
    /// let paths = ["session.json".to_owned(), "segments/000000.mcap".to_owned()];
    /// let sealed = HandOff::seal(&session, "0192aa00", Verdict::Pass, "example", CivilTime(0), &paths, |_| {})?;
    ///
    /// let opened = HandOff::open(&session, Check::Content, |_| {})?;
    /// assert_eq!(opened.seal, sealed.seal);
    ///
    /// session.set_content("segments/000000.mcap", b"Chunks".to_vec());
    /// let refused = HandOff::open(&session, Check::Content, |_| {}).unwrap_err();
    /// assert_eq!(
    ///     refused.to_string(),
    ///     "segments/000000.mcap changed since it was handed over: its content has another hash"
    /// );
    /// # Ok::<(), session_archive::handoff::HandOffError>(())
    /// ```
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
        let files = files.collect::<Result<Vec<_>, _>>()?;
        let (derived, files) = (files.into_iter()).partition(|file| file.path == layout::INDEX);
        let said = Statement {
            software: software.to_owned(),
            sealed,
            verdict,
            limits: Vec::new(),
            acceptance: None,
        };
        let handoff = Self::new(session_id, files, derived, said);
        handoff.write(storage)?;
        Ok(handoff)
    }

    /// Writes it into the session's folder.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    pub fn write(&self, storage: &dyn Storage) -> Result<(), HandOffError> {
        storage::replace(storage, layout::HANDOFF, &self.to_bytes()).map_err(|error| {
            HandOffError::Io {
                path: layout::HANDOFF.to_owned(),
                error,
            }
        })
    }

    /// The hand-off as it is written, with its own checks (the document's hash, the seal), but
    /// without a check of any file, and whatever its verdict is.
    ///
    /// # Errors
    /// [`HandOffError::Missing`], [`HandOffError::Io`], [`HandOffError::Invalid`].
    pub fn read(storage: &dyn Storage) -> Result<Self, HandOffError> {
        #[derive(Deserialize)]
        struct Which {
            format: String,
            version: u32,
        }
        let text =
            storage::read_all(storage, layout::HANDOFF).map_err(|error| match error.kind() {
                io::ErrorKind::NotFound => HandOffError::Missing,
                _ => HandOffError::Io {
                    path: layout::HANDOFF.to_owned(),
                    error,
                },
            })?;
        let which: Which =
            serde_json::from_slice(&text).map_err(|e| HandOffError::Invalid(e.to_string()))?;
        let handoff = match (which.format.as_str(), which.version) {
            (FORMAT, 1) => version1::parse(&text)?,
            (FORMAT, VERSION) => Self::from_bytes(&text)?,
            (format, version) => {
                return Err(HandOffError::Invalid(format!(
                    "it is {format} version {version}, expected {FORMAT} version 1 or {VERSION}"
                )));
            }
        };
        let mut paths = handoff.files.iter().chain(&handoff.derived);
        match paths.find(|file| !file.path.split('/').all(layout::is_file_name)) {
            Some(file) => Err(HandOffError::Invalid(format!(
                "it names the file {:?}, which is no path in the session's folder",
                file.path
            ))),
            None => Ok(handoff),
        }
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
        let handoff = Self::read(storage)?;
        if handoff.verdict == Verdict::Fail && !handoff.is_accepted() {
            return Err(HandOffError::Failed);
        }
        for file in handoff.files.iter().chain(&handoff.derived) {
            file.check(storage, check, &mut progress)?;
        }
        Ok(handoff)
    }

    /// Whether somebody accepted it with the verdict that it has.
    ///
    /// ```
    /// use session_archive::handoff::{Acceptance, Check, HandOff, HandOffError, Statement, Verdict};
    /// use session_archive::storage::FaultStorage;
    /// use session_archive::time::CivilTime;
    ///
    /// let session = FaultStorage::new();
    /// let failed = Statement {
    ///     software: "example".to_owned(),
    ///     sealed: CivilTime(0),
    ///     verdict: Verdict::Fail,
    ///     limits: Vec::new(),
    ///     acceptance: None,
    /// };
    /// let mut handoff = HandOff::new("0192aa00", Vec::new(), Vec::new(), failed);
    /// handoff.write(&session)?;
    /// assert!(matches!(HandOff::open(&session, Check::Content, |_| {}), Err(HandOffError::Failed)));
    ///
    /// # let (accepted, metrics, limits) = (CivilTime(0), Vec::new(), Vec::new());
    /// handoff.acceptance = Some(Acceptance { level: Verdict::Fail, accepted, verdict: Verdict::Fail, metrics, limits });
    /// handoff.write(&session)?;
    /// assert!(HandOff::open(&session, Check::Content, |_| {})?.is_accepted());
    /// # Ok::<(), HandOffError>(())
    /// ```
    pub fn is_accepted(&self) -> bool {
        let acceptance = self.acceptance.as_ref();
        acceptance.is_some_and(|a| a.level >= self.verdict)
    }

    /// Whether the hand-off lists this file.
    pub fn names(&self, path: &str) -> bool {
        let mut files = self.files.iter().chain(&self.derived);
        files.any(|file| file.path == path)
    }

    /// Whether this seal stands for the same recording.
    pub fn is_known_as(&self, seal: &str) -> bool {
        self.seal == seal || self.earlier_seals.iter().any(|earlier| earlier == seal)
    }

    /// Notes for its readers, a sentence each: that it is of an older version, that it was accepted
    /// in spite of its verdict, that it was judged by other limits.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.version < VERSION {
            notes.push(format!(
                "the hand-off is of version {}, whose seal covers the verdict too; `paws handoff` writes it as version \
                 {VERSION}, and scene bundles that were made of it stay valid",
                self.version
            ));
        }
        if let Some(acceptance) = &self.acceptance {
            let what: Vec<&str> = (acceptance.metrics.iter())
                .filter(|m| m.verdict == acceptance.verdict)
                .map(|m| m.text.as_str())
                .collect();
            notes.push(format!(
                "the verdict on the session is {}, and it was handed over in spite of that (--accept {}, {}): {}",
                self.verdict,
                acceptance.level,
                acceptance.accepted,
                what.join("; ")
            ));
        }
        if !self.limits.is_empty() {
            notes.push(format!(
                "the session was judged by limits other than those of the table: {}",
                self.limits.join(" ")
            ));
        }
        notes
    }

    /// The document with its hash at the end.
    fn to_bytes(&self) -> Vec<u8> {
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.truncate(text.len().saturating_sub("\n}".len()));
        text.push(',');
        let hash = blake3::hash(text.as_bytes()).to_hex();
        text.push_str(&format!("{HASH_KEY}{hash}{END}"));
        text.into_bytes()
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self, HandOffError> {
        let invalid = |what: &str| HandOffError::Invalid(what.to_owned());
        let text = std::str::from_utf8(bytes).map_err(|_| invalid("it is not UTF-8"))?;
        let at = text
            .rfind(HASH_KEY)
            .ok_or_else(|| invalid("it has no hash"))?;
        let stored = text[at + HASH_KEY.len()..].strip_suffix(END);
        let found = blake3::hash(&bytes[..at]).to_hex();
        if stored != Some(found.as_str()) {
            return Err(invalid("its hash does not match"));
        }
        let handoff: Self = serde_json::from_str(text).map_err(|e| invalid(&e.to_string()))?;
        if handoff.seal != seal_of(&handoff.session_id, &handoff.files) {
            return Err(invalid("its seal does not match"));
        }
        Ok(handoff)
    }
}
