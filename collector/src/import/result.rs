//! The result of an import.

use session_archive::verify::Report;

use crate::condition::Condition;

/// Result of an import: a session in the library.
#[derive(Clone, Debug)]
pub struct ImportResult {
    /// Its key in the library.
    pub key: String,
    /// Condition of the session.
    pub condition: Condition,
    /// Verification report.
    pub report: Report,
    /// Bytes copied by this import; 0 if the session was in the library already.
    pub copied: u64,
    /// Bytes that an earlier, interrupted import had copied.
    pub resumed: u64,
    /// Whether it was in the library before.
    pub already_imported: bool,
    /// Entries of the source that were not copied: names that are not UTF-8, folders nested too
    /// deeply.
    pub skipped: Vec<String>,
    /// Key of the damaged or cut off session that it replaced.
    pub replaced: Option<String>,
}
