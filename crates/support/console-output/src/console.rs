//! Output and clocks of a command.
//!
//! Results go to standard output, so that they can be piped; progress and warnings go to standard
//! error. Tests pass a buffer and a stopped clock.

use std::fmt;
use std::io::{self, Write};

use command_line::output::harmless;

use crate::clock::Clock;
use crate::progress::{Progress, Show};

/// Output and clocks of a command.
pub struct Console<'a> {
    /// Results.
    pub out: &'a mut dyn Write,
    /// How progress is shown.
    pub show: Show,
    /// The clocks.
    pub clock: Clock,
}

impl Console<'_> {
    /// Writes one line of results. Control characters, as in names out of a session, are written as
    /// `\u001b`.
    ///
    /// # Errors
    /// The reader of the output has closed it.
    pub fn line(&mut self, text: impl fmt::Display) -> io::Result<()> {
        writeln!(self.out, "{}", harmless(&text.to_string()))
    }

    /// Progress over `total` bytes.
    pub fn progress(&self, label: &str, total: u64) -> Progress {
        Progress::bytes(label, total, self.show, self.clock)
    }
}
