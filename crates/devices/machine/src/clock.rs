//! The clocks: reliability of civil time, and its steps.
//!
//! Recorded time is on `CLOCK_MONOTONIC`, which nobody can set. Civil time is known through the
//! offset `CLOCK_REALTIME - CLOCK_MONOTONIC`. Slewing (chrony, NTP, PTP at work) speeds both clocks
//! alike and leaves the offset as it is; it changes only when somebody sets the clock, at a leap
//! second, and when the machine was suspended. So any change beyond what reading the clocks costs
//! is an event, however small.
//!
//! Contract: [`ClockWatch::judge`] is pure. It reports each step once, at the first look after it,
//! with its size; two steps between two looks are one. A suspension is distinguished by
//! `CLOCK_BOOTTIME`, which goes on through it. [`read()`] reads the clocks, [`StepAlarm`] wakes a
//! thread at the step; where the kernel refuses either, less is known.

use serde::Serialize;

mod read;

pub use read::{Discipline, StepAlarm, discipline, read};

/// Smaller changes are not reported, ns: the clocks are read one after the other.
const LEAST_STEP_NS: i64 = 10_000;

/// The readings of the clocks at one time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockReading {
    /// `CLOCK_MONOTONIC`, ns.
    pub monotonic_ns: i64,
    /// `CLOCK_REALTIME` at that instant, ns since 1970, UTC.
    pub realtime_ns: i64,
    /// `CLOCK_BOOTTIME` at that instant, ns.
    pub boottime_ns: i64,
    /// Maximum time between the three readings, ns.
    pub apart_ns: i64,
    /// What the kernel knows of its clock's quality, where it tells.
    pub kernel: Option<Kernel>,
}

/// The kernel's account of its civil clock (adjtimex(2)).
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Kernel {
    /// Whether it is synchronised.
    pub synchronised: bool,
    /// What is still to be corrected, ns. Always 0 under chrony, which keeps its own account.
    pub offset_ns: i64,
    /// Estimated error, ns.
    pub estimated_error_ns: i64,
    /// Largest possible error, ns; grows by 500 µs per second that nobody corrects it.
    pub max_error_ns: i64,
    /// Correction of the crystal's frequency, parts per 10⁹.
    pub frequency_ppb: i64,
    /// TAI minus UTC, s; 0 if the kernel does not know it.
    pub tai_offset_s: i32,
    /// A leap second that is due or under way.
    pub leap: Leap,
}

/// Leap seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Leap {
    /// None is due.
    None,
    /// One will be inserted at the end of the day.
    Insert,
    /// One will be left out at the end of the day.
    Delete,
    /// It is being inserted now.
    Now,
    /// It has just been.
    Done,
}

/// The clocks, once a second.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockState {
    /// When, on `CLOCK_MONOTONIC`, ns.
    pub at_ns: i64,
    /// Civil time is this plus `CLOCK_MONOTONIC`, ns.
    pub civil_offset_ns: i64,
    /// How long the machine has been suspended since it booted, ns.
    pub suspended_ns: i64,
    /// Uncertainty of the offset due to reading, ns.
    pub apart_ns: i64,
    /// Whether the clock is synchronised; `None` where the kernel does not report it.
    pub synchronised: Option<bool>,
    /// The kernel's account.
    pub kernel: Option<Kernel>,
}

/// Something happened to the clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockEvent {
    /// Civil time was set by this much, ns; positive is forward.
    Step {
        /// By how much, ns.
        by_ns: i64,
    },
    /// The machine was suspended for this long, ns.
    Suspended {
        /// How long, ns.
        for_ns: i64,
    },
    /// The clock is kept right from now on, or no longer.
    Synchronised {
        /// Which.
        now: bool,
    },
}

impl std::fmt::Display for ClockEvent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let seconds = |ns: i64| ns as f64 / crate::NS_PER_S as f64;
        match *self {
            Self::Step { by_ns } => write!(
                f,
                "civil time was set by {:+.6} s; recorded time is untouched",
                seconds(by_ns)
            ),
            Self::Suspended { for_ns } => {
                write!(f, "the machine was suspended for {:.3} s", seconds(for_ns))
            }
            Self::Synchronised { now: true } => f.write_str("civil time is kept right"),
            Self::Synchronised { now: false } => f.write_str("civil time is no longer kept right"),
        }
    }
}

/// Compares readings.
#[derive(Clone, Debug, Default)]
pub struct ClockWatch {
    last: Option<ClockReading>,
}

impl ClockWatch {
    /// One that has seen nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// What a reading means, and what happened since the one before.
    pub fn judge(&mut self, reading: &ClockReading) -> (ClockState, Vec<ClockEvent>) {
        let state = ClockState {
            at_ns: reading.monotonic_ns,
            civil_offset_ns: reading.realtime_ns.saturating_sub(reading.monotonic_ns),
            suspended_ns: reading.boottime_ns.saturating_sub(reading.monotonic_ns),
            apart_ns: reading.apart_ns,
            synchronised: reading.kernel.as_ref().map(|kernel| kernel.synchronised),
            kernel: reading.kernel.clone(),
        };
        let mut events = Vec::new();
        if let Some(last) = self.last.replace(reading.clone()) {
            let noise = LEAST_STEP_NS
                .saturating_add(last.apart_ns)
                .saturating_add(reading.apart_ns);
            let change = |of: fn(&ClockReading) -> i64| of(reading).saturating_sub(of(&last));
            // Both clocks go on through a suspension, so that only a step parts them.
            let by_ns = change(|l| l.realtime_ns.saturating_sub(l.boottime_ns));
            let for_ns = change(|l| l.boottime_ns.saturating_sub(l.monotonic_ns));
            if for_ns > noise {
                events.push(ClockEvent::Suspended { for_ns });
            }
            if by_ns.saturating_abs() > noise {
                events.push(ClockEvent::Step { by_ns });
            }
            let synchronised = |l: &ClockReading| l.kernel.as_ref().map(|k| k.synchronised);
            if let (Some(before), Some(now)) = (synchronised(&last), synchronised(reading))
                && before != now
            {
                events.push(ClockEvent::Synchronised { now });
            }
        }
        (state, events)
    }
}

#[cfg(test)]
mod tests;
