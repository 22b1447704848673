//! How a verb ended, and the exit code that says so.

use std::process::ExitCode;

/// How a verb ended, the better before the worse. An error is always [`Outcome::Failed`]; bad
/// arguments end with exit code 2 before any verb begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Outcome {
    /// Everything as it should be: 0.
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
