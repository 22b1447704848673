//! Looking at a whole session once: the check of every byte, and the facts that it is judged by.
//!
//! The two read the session side by side on two threads, so what one has read from the disk the other
//! finds in memory. Neither decodes pictures.

use std::thread;

use session_archive::reader::{ReadError, SessionReader};
use session_archive::verify::{Report, verify};

use crate::progress::Progress;
use crate::session_stats::SessionStats;

/// What was found.
#[derive(Clone, Debug)]
pub struct SessionScan {
    /// Whether everything that was recorded is there.
    pub report: Report,
    /// When the samples were taken, and what the recorder said meanwhile.
    pub stats: SessionStats,
}

/// Examines a session.
///
/// # Errors
/// The disk says no. What the session holds is never an error.
pub fn scan_session(reader: &SessionReader, progress: &Progress) -> Result<SessionScan, ReadError> {
    thread::scope(|scope| {
        let check = scope.spawn(|| verify(reader, |_| {}));
        let stats = SessionStats::gather(reader, |bytes| progress.add(bytes));
        let report = match check.join() {
            Ok(report) => report,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        Ok(SessionScan {
            report: report?,
            stats: stats?,
        })
    })
}
