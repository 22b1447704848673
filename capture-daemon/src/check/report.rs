//! Findings, and the report that collects them.

use std::fmt;

use serde::Serialize;

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Correct.
    Ok,
    /// A recording is possible, but may differ from what is intended.
    Warning,
    /// No recording is possible.
    Error,
}

/// Result of one check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Severity.
    pub level: Level,
    /// Part of the configuration: `session`, `camera feet`.
    pub about: String,
    /// What was found and, if that is not sufficient, a remedy.
    pub message: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let level = match self.level {
            Level::Ok => "ok",
            Level::Warning => "warning",
            Level::Error => "error",
        };
        write!(f, "{level:<8} {}: {}", self.about, self.message)
    }
}

#[derive(Default)]
pub(super) struct Report {
    pub(super) about: String,
    pub(super) findings: Vec<Finding>,
}

impl Report {
    pub(super) fn add(&mut self, level: Level, message: impl Into<String>) {
        self.findings.push(Finding {
            level,
            about: self.about.clone(),
            message: message.into(),
        });
    }

    pub(super) fn ok(&mut self, message: impl Into<String>) {
        self.add(Level::Ok, message);
    }

    pub(super) fn warning(&mut self, message: impl Into<String>) {
        self.add(Level::Warning, message);
    }

    pub(super) fn error(&mut self, message: impl Into<String>) {
        self.add(Level::Error, message);
    }
}
