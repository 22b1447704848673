//! The record of one imported file.

use serde::{Deserialize, Serialize};

/// File name of the import record in the session's folder.
pub(crate) const RECORD: &str = "import.json";

/// One copied file of a session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Path below the session's folder.
    pub path: String,
    /// Length.
    pub bytes: u64,
    /// Modification time of the source, ns since 1970.
    pub modified_ns: i64,
    /// BLAKE3 of the bytes read from the source, hex.
    pub blake3: String,
}
