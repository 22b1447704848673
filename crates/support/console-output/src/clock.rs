//! The clocks of a host. Tests pass a stopped one.

use std::time::Duration;

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
