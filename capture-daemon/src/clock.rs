//! Clocks of the daemon. Time is an argument everywhere: all code that needs it takes a [`Clock`],
//! so that the whole daemon runs on virtual time in tests. This module is the only one of the
//! daemon that reads the real clocks.

use std::sync::atomic::{AtomicI64, Ordering};

use session_archive::time::{CivilTime, HostTime, NS_PER_S};

/// A host clock.
pub trait Clock: Send + Sync {
    /// Current time on the host clock, on which all times of a session are.
    fn now(&self) -> HostTime;

    /// Current civil time, as accurate as the machine's clock.
    fn civil(&self) -> CivilTime;
}

/// The machine's clocks.
#[derive(Clone, Copy, Debug, Default)]
pub struct RealClock;

#[expect(
    clippy::disallowed_methods,
    reason = "this is where the clocks are read"
)]
impl Clock for RealClock {
    fn now(&self) -> HostTime {
        let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        HostTime(t.tv_sec * NS_PER_S + t.tv_nsec)
    }

    fn civil(&self) -> CivilTime {
        let t = rustix::time::clock_gettime(rustix::time::ClockId::Realtime);
        CivilTime(t.tv_sec * NS_PER_S + t.tv_nsec)
    }
}

/// A clock that is stopped until it is set.
#[derive(Debug)]
pub struct VirtualClock {
    now: AtomicI64,
    /// Civil time at host time zero.
    civil_at_zero: i64,
}

impl VirtualClock {
    /// A clock at `now`, with civil time `civil` at that instant.
    pub fn new(now: HostTime, civil: CivilTime) -> Self {
        Self {
            now: AtomicI64::new(now.0),
            civil_at_zero: civil.0 - now.0,
        }
    }

    /// Sets the clock. It never decreases.
    pub fn advance_to(&self, now: HostTime) {
        self.now.fetch_max(now.0, Ordering::SeqCst);
    }
}

impl Clock for VirtualClock {
    fn now(&self) -> HostTime {
        HostTime(self.now.load(Ordering::SeqCst))
    }

    fn civil(&self) -> CivilTime {
        CivilTime(self.civil_at_zero + self.now().0)
    }
}
