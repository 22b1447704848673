//! One scan of a whole session: verification of every byte, and the statistics that validation
//! uses.
//!
//! Both read the session in parallel on two threads, so that the second finds in the page cache
//! what the first has read. Neither decodes images.

use std::thread;

use console_output::Progress;
use session_archive::reader::{ReadError, SessionReader};
use session_archive::verify::{Report, verify};

use crate::session_stats::SessionStats;

/// Result of a scan.
#[derive(Clone, Debug)]
pub struct SessionScan {
    /// Verification report: whether everything that was recorded is present.
    pub report: Report,
    /// Times of the samples, and the records of the recorder.
    pub stats: SessionStats,
}

/// Scans a session.
///
/// # Errors
/// An I/O error occurs. Damage of the session is a result, not an error.
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
