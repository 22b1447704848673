//! Files that a host derives beside a recording.

use session_archive::layout;

/// File name of the HTML report in the session's folder.
pub(crate) const REPORT: &str = "report.html";

/// Files that a host derives beside a recording and can derive again.
pub const DERIVED: [&str; 4] = [layout::INDEX, layout::VALIDATION, layout::HANDOFF, REPORT];
