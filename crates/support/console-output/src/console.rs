//! Output and clocks of a command.
//!
//! Results go to standard output, so that they can be piped; progress and warnings go to standard
//! error. Tests pass a buffer and a stopped clock.

use std::fmt;
use std::io::{self, Write};
use std::time::Duration;

use command_line::output::harmless;

use crate::progress::Progress;

/// The clocks of a host. Civil time is only recorded; the monotonic clock is for rates.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    /// Current time, UTC, ns since 1970, by the machine's clock.
    pub civil_ns: fn() -> i64,
    /// Time since some fixed instant.
    pub monotonic: fn() -> Duration,
}

impl Clock {
    /// A stopped clock, for tests.
    pub const STILL: Self = Self {
        civil_ns: || 1_800_000_000_000_000_000,
        monotonic: || Duration::ZERO,
    };

    /// The machine's clocks.
    pub const MACHINE: Self = Self {
        civil_ns: machine_civil_ns,
        monotonic: machine_monotonic,
    };
}

#[expect(
    clippy::disallowed_methods,
    reason = "the only place that reads the civil clock"
)]
fn machine_civil_ns() -> i64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Realtime);
    t.tv_sec * 1_000_000_000 + t.tv_nsec
}

#[expect(
    clippy::disallowed_methods,
    reason = "the only place that reads the monotonic clock"
)]
fn machine_monotonic() -> Duration {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    Duration::new(t.tv_sec.max(0) as u64, t.tv_nsec as u32)
}

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Show {
    /// Not at all.
    Nothing,
    /// A line every few seconds, if standard error is no terminal.
    Lines,
    /// A bar.
    Bar,
}

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
    /// Writes one line of results. Control characters, as in names out of a session, are written as `\u001b`.
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
