//! Outcome of a command, and its exit code.

use std::process::ExitCode;

/// Outcome of a command, the better before the worse. An error is always [`Outcome::Failed`];
/// invalid arguments end with exit code 2 before a command starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Outcome {
    /// Success: 0.
    #[default]
    Fine,
    /// The work is done, but something recorded is missing or damaged: 3.
    Loss,
    /// The work could not be done, or the session must not be used: 1.
    Failed,
}

impl Outcome {
    /// The exit code.
    pub fn code(self) -> u8 {
        match self {
            Self::Fine => 0,
            Self::Failed => 1,
            Self::Loss => 3,
        }
    }
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        outcome.code().into()
    }
}
