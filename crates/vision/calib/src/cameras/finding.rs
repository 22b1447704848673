//! Objections to a result.

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Information.
    Note,
    /// The result is usable with care.
    Warn,
    /// The result must not be used.
    Fail,
}

/// An objection to a result, or information for its user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Severity.
    pub severity: Severity,
    /// What was found and what was expected.
    pub text: String,
}

impl Finding {
    pub(super) fn new(severity: Severity, text: String) -> Self {
        Self { severity, text }
    }
}
