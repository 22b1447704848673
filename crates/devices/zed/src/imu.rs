//! The driver of the camera's IMU.
//!
//! [`Imu::open`] starts the stream; [`Imu::next`] waits for what comes and does, between reports,
//! what keeps the stream alive: a ping each second of the caller's clock, and a watchdog that stops
//! and starts a silent device, then closes and opens it. (Users of these cameras report an IMU that
//! says nothing until the program is started again: zed-open-capture, issue 22.)
//!
//! * *Early.* The first sample comes when the device sends it. A device that takes the command to
//!   start and sends nothing is silent, which the watchdog sees to.
//! * *Late.* Samples wait in the kernel, 64 at most. Call [`Imu::next`] from a thread that does
//!   little else.
//! * *A gap.* The device does not number its samples; [`crate::number`] does, and a number that
//!   jumps is a loss.
//! * *Silent, restarted, reopened.* Each is an [`Event`]; recovery begins before the next call
//!   waits.
//! * *Disconnected.* When a read fails the device is closed. [`Imu::try_reopen`] finds it again,
//!   whatever node it has then; the caller knows when to try: at each hotplug event, or each
//!   second. Numbers go on.
//! * *At the end.* [`Imu::finish`] stops the stream and takes what still waits; dropping the driver
//!   only stops it.
//!
//! A command that the device leaves unanswered blocks for as long as the kernel waits (5 s on USB).
//! Never run on a real device.

use std::time::Duration;

use crate::command::{Command, STREAM, is_streaming};
use crate::number::{Numbers, SampleNumber};
use crate::report::{ReportError, Sample};

#[cfg(test)]
mod fake;
pub mod hid;
mod link;
mod watchdog;

pub use hid::{HidLink, HidPort, ImuDevice, list};
pub use link::{Link, LinkError, OpenError, Port};
pub use watchdog::{PATIENCE_NS, SILENT_NS};

use watchdog::{Watchdog, WatchdogAction};

/// Longest read: a report with a number in front, and room to notice that it is longer.
const READ_BYTES: usize = 80;

/// What may wait after the stream was stopped: the kernel's queue, and reports in transit.
const MOST_LEFT: usize = 256;
/// After so long without a report nothing more comes from a stopped stream, ns.
const LAST_WAIT_NS: i64 = 20_000_000;

/// A sample as it arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// What the device sent.
    pub sample: Sample,
    /// When the read returned, ns of the caller's clock.
    pub host_ns: i64,
    /// Its number, and what is missing before it.
    pub numbered: SampleNumber,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// A sample, valid or not ([`Sample::valid`]).
    Sample(Arrival),
    /// A read that is no sample. It has no number: what it should have been shows as a loss.
    Malformed(ReportError),
    /// No report for half a second. The stream is about to be started again.
    Silent {
        /// When the last report came, ns.
        since_ns: i64,
    },
    /// The silent stream was stopped and started. Whether that helped shows by a sample.
    Restarted {
        /// What the device says of its stream now, where it says anything.
        streaming: Option<bool>,
    },
    /// The silent device was closed, opened and started.
    Reopened,
    /// The device is disconnected; see [`Imu::try_reopen`]. Until then each call returns this
    /// immediately.
    Gone {
        /// What exactly happened, for people.
        detail: String,
    },
    /// Nothing until the given time.
    Nothing,
}

/// What was counted since the driver was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Samples that arrived.
    pub samples: u64,
    /// Samples that are missing, by their numbers.
    pub lost: u64,
    /// Samples that the device itself calls not valid.
    pub not_valid: u64,
    /// Reads that were no sample.
    pub malformed: u64,
    /// Streams stopped and started by the watchdog.
    pub restarts: u64,
    /// Devices closed and opened, by the watchdog or after an absence.
    pub reopens: u64,
    /// Pings that the device did not take.
    pub pings_refused: u64,
}

/// The IMU of one camera. See the [module](self).
#[derive(Debug)]
pub struct Imu<P: Port> {
    port: P,
    link: Option<P::Link>,
    /// Why there is no link.
    detail: String,
    watchdog: Watchdog,
    numbers: Numbers,
    counters: Counters,
}

impl<P: Port> Imu<P> {
    /// Opens the device and starts its stream at `now`, ns.
    ///
    /// # Errors
    /// See [`OpenError`].
    pub fn open(mut port: P, now: i64) -> Result<Self, OpenError> {
        Ok(Self {
            link: Some(start(port.open()?)?),
            port,
            detail: String::new(),
            watchdog: Watchdog::new(now),
            numbers: Numbers::new(),
            counters: Counters::default(),
        })
    }

    /// Waits for the next event, until `until_ns` at the longest. `clock` reads the caller's clock,
    /// ns.
    pub fn next(&mut self, clock: &dyn Fn() -> i64, until_ns: i64) -> Event {
        loop {
            let now = clock();
            if self.link.is_none() {
                return Event::Gone {
                    detail: self.detail.clone(),
                };
            }
            while let Some(duty) = self.watchdog.due(now) {
                if let Some(event) = self.fulfil(duty) {
                    return event;
                }
            }
            let wait = until_ns.min(self.watchdog.next()).saturating_sub(now);
            if let Some(event) = self.read(clock, wait.max(0)) {
                return event;
            }
            if clock() >= until_ns {
                return Event::Nothing;
            }
        }
    }

    /// Looks for the device after it was disconnected, opens and starts it. Nothing is done if it
    /// is open.
    ///
    /// # Errors
    /// It is not there yet, or cannot be used: try again later.
    pub fn try_reopen(&mut self, now: i64) -> Result<(), OpenError> {
        if self.link.is_none() {
            self.link = Some(start(self.port.open()?)?);
            self.watchdog = Watchdog::new(now);
            self.counters.reopens += 1;
        }
        Ok(())
    }

    /// Stops the stream and takes the samples that still wait, so that none is lost; with the final
    /// counters.
    pub fn finish(mut self, clock: &dyn Fn() -> i64) -> (Vec<Arrival>, Counters) {
        let mut left = Vec::new();
        if let Some(link) = &mut self.link
            && link.set_feature(Command::Stop.report()).is_ok()
        {
            // A device that does not stop must not block the caller.
            while left.len() < MOST_LEFT
                && let Some(event) = self.read(clock, LAST_WAIT_NS)
            {
                if let Event::Sample(arrival) = event {
                    left.push(arrival);
                }
            }
            self.link = None;
        }
        (left, self.counters)
    }

    /// Whether the device is there, as far as is known.
    pub fn is_open(&self) -> bool {
        self.link.is_some()
    }

    /// Samples per second of the device's clock as measured, once two have come.
    pub fn rate_hz(&self) -> Option<f64> {
        self.numbers.rate_hz()
    }

    /// What was counted.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    fn fulfil(&mut self, duty: WatchdogAction) -> Option<Event> {
        let link = self.link.as_mut()?;
        match duty {
            WatchdogAction::Ping => {
                // If it is disconnected the next read says so.
                if let Err(error) = link.set_feature(Command::Ping.report()) {
                    self.counters.pings_refused += 1;
                    log::warn!("keeping the IMU's stream alive: {error}");
                }
                None
            }
            WatchdogAction::ReportSilence => Some(Event::Silent {
                since_ns: self.watchdog.last_report(),
            }),
            WatchdogAction::Restart => {
                self.counters.restarts += 1;
                let commands = [Command::Stop, Command::Start, Command::Ping];
                for command in commands {
                    if let Err(error) = link.set_feature(command.report()) {
                        log::warn!("starting a silent IMU again: {error}");
                    }
                }
                Some(Event::Restarted {
                    streaming: ask(link),
                })
            }
            WatchdogAction::Reopen => {
                self.link = None;
                match self.port.open().and_then(start) {
                    Ok(link) => {
                        self.link = Some(link);
                        self.counters.reopens += 1;
                        Some(Event::Reopened)
                    }
                    Err(error) => Some(self.gone(&error)),
                }
            }
        }
    }

    fn read(&mut self, clock: &dyn Fn() -> i64, wait_ns: i64) -> Option<Event> {
        let mut bytes = [0; READ_BYTES];
        let wait = Duration::from_nanos(wait_ns.unsigned_abs());
        let read = match self.link.as_mut()?.read(&mut bytes, wait) {
            Ok(0) => return None,
            Ok(read) => read,
            Err(error) => {
                self.link = None;
                return Some(self.gone(&error));
            }
        };
        let host_ns = clock();
        let sample = match Sample::parse(&bytes[..read.min(READ_BYTES)]) {
            Ok(sample) => sample,
            Err(error) => {
                self.counters.malformed += 1;
                return Some(Event::Malformed(error));
            }
        };
        self.watchdog.report(host_ns);
        let numbered = self.numbers.number(sample.ticks, host_ns);
        self.counters.samples += 1;
        self.counters.lost += numbered.lost;
        self.counters.not_valid += u64::from(!sample.valid);
        Some(Event::Sample(Arrival {
            sample,
            host_ns,
            numbered,
        }))
    }

    fn gone(&mut self, error: &dyn std::error::Error) -> Event {
        self.detail = error.to_string();
        let mut source = error.source();
        while let Some(cause) = source {
            self.detail.push_str(": ");
            self.detail.push_str(&cause.to_string());
            source = cause.source();
        }
        Event::Gone {
            detail: self.detail.clone(),
        }
    }
}

impl<P: Port> Drop for Imu<P> {
    fn drop(&mut self) {
        if let Some(link) = &mut self.link
            && let Err(error) = link.set_feature(Command::Stop.report())
        {
            log::debug!("stopping the IMU: {error}");
        }
    }
}

/// Starts the stream.
fn start<L: Link>(mut link: L) -> Result<L, OpenError> {
    for command in [Command::Start, Command::Ping] {
        link.set_feature(command.report())
            .map_err(OpenError::Start)?;
    }
    Ok(link)
}

/// Whether the device says that it streams.
fn ask(link: &mut impl Link) -> Option<bool> {
    let mut answer = [0; READ_BYTES];
    answer[0] = STREAM;
    let result = link
        .get_feature(&mut answer)
        .map_err(|e| e.to_string())
        .and_then(|n| is_streaming(&answer[..n.min(READ_BYTES)]).map_err(|e| e.to_string()));
    result.map_err(|error| log::warn!("{error}")).ok()
}

#[cfg(test)]
mod tests;
