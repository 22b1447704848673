//! Hand-offs of version 1, whose seal is over the whole document, the verdict and `validation.json`
//! included.
//!
//! They are still read, never written. `validation.json` is not looked at: a later validation
//! replaces it, and the verdict stands in the hand-off.

use serde::{Deserialize, Serialize};

use super::{HandOff, HandOffError, SealedFile, Verdict};
use crate::layout;
use crate::time::CivilTime;

/// The document. The order of its fields is part of its seal.
#[derive(Clone, Serialize, Deserialize)]
struct Document {
    format: String,
    version: u32,
    session_id: String,
    software: String,
    sealed: CivilTime,
    verdict: Verdict,
    files: Vec<SealedFile>,
    seal: String,
}

/// Reads a document, and checks its seal.
pub(super) fn parse(text: &[u8]) -> Result<HandOff, HandOffError> {
    let document: Document =
        serde_json::from_slice(text).map_err(|e| HandOffError::Invalid(e.to_string()))?;
    let unsealed = Document {
        seal: String::new(),
        ..document.clone()
    };
    let unsealed = serde_json::to_vec(&unsealed).unwrap_or_default();
    if blake3::hash(&unsealed).to_hex().as_str() != document.seal {
        return Err(HandOffError::Invalid("its seal does not match".to_owned()));
    }
    let (derived, files) = (document.files.into_iter())
        .filter(|file| file.path != layout::VALIDATION)
        .partition(|file| file.path == layout::INDEX);
    Ok(HandOff {
        format: document.format,
        version: document.version,
        session_id: document.session_id,
        files,
        seal: document.seal,
        earlier_seals: Vec::new(),
        derived,
        software: document.software,
        sealed: document.sealed,
        verdict: document.verdict,
        limits: Vec::new(),
        acceptance: None,
    })
}
