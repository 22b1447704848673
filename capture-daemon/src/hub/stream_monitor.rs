//! Supervision of one stream: sample counts, unwrapped numbers, detection of silence and
//! disconnects.

use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, NS_PER_S};

use super::outgoing::{Out, Outgoing, StreamHealth};
use crate::sources::Disconnect;
use crate::sync::renumber::Renumber;

/// Interval at which [`Hub::tick`](super::Hub::tick) is to be called, ns.
pub const TICK_NS: i64 = 100_000_000;

/// A stream whose device is disconnected, or was since its last sample.
struct Absence {
    /// Arrival of the last sample.
    last: HostTime,
    disconnect: Disconnect,
}

/// Detects silence and counts samples.
#[derive(Default)]
pub(super) struct StreamMonitor {
    absence: Option<Absence>,
    received: u64,
    received_before: u64,
    /// Late or repeated samples since the last notice about them.
    rejected: u64,
    last: Option<HostTime>,
    period_ns: i64,
    limit_ns: i64,
    silent: bool,
}

impl StreamMonitor {
    pub(super) fn new(rate_hz: f64) -> Self {
        let period = if rate_hz > 0.0 {
            NS_PER_S as f64 / rate_hz
        } else {
            0.0
        };
        Self {
            period_ns: period as i64,
            limit_ns: 2 * period as i64 + NS_PER_S,
            ..Self::default()
        }
    }

    pub(super) fn sample_arrived(&mut self, at: HostTime, name: &str, out: &Out) {
        self.received += 1;
        self.last = Some(at);
        self.set_silent(false, at, name, out);
    }

    /// Maps the device's number to the stream's number; `None` if the sample is late or repeated. A
    /// restarted counter produces a notice.
    pub(super) fn number(
        &mut self,
        numbers: &mut Renumber,
        raw: u64,
        at: HostTime,
        name: &str,
        out: &Out,
    ) -> Option<u64> {
        if let (Some(absence), Some(newest)) = (self.absence.take(), numbers.newest()) {
            let number = numbers.resume(raw, self.missed(&absence, at));
            let disconnect = absence.disconnect.host_time;
            report_disconnect(&absence, newest + 1, number, disconnect, name, out);
            return Some(number);
        }
        let numbered = numbers.number(raw);
        if numbered.late {
            self.rejected += 1;
            return None;
        }
        if numbered.restarted {
            let text = format!(
                "{name}: the device counter restarted at {raw}, stored as {}; the number of samples \
                 missing between cannot be known",
                numbered.number
            );
            out(Outgoing::Notice {
                at,
                text,
                stream: name.to_owned(),
            });
        }
        Some(numbered.number)
    }

    /// The device is disconnected. Missed samples are reported repeatedly until it reconnects.
    pub(super) fn note_disconnect(&mut self, disconnect: &Disconnect) {
        // After two disconnects without a sample between them, the first one counts.
        self.absence.get_or_insert(Absence {
            last: self.last.unwrap_or(disconnect.host_time),
            disconnect: disconnect.clone(),
        });
    }

    /// Number of samples expected between the last one and `at`, by the nominal rate.
    fn missed(&self, absence: &Absence, at: HostTime) -> u64 {
        let periods = at.since(absence.last) as f64 / (self.period_ns as f64).max(1.0);
        (periods.round() as u64).saturating_sub(1)
    }

    /// Reports the samples missed so far by a disconnected device: a recording that ends meanwhile
    /// needs them.
    pub(super) fn report_absent(&self, numbers: &Renumber, at: HostTime, name: &str, out: &Out) {
        if let (Some(absence), Some(newest)) = (&self.absence, numbers.newest()) {
            // The sample that is due now may still arrive.
            let next = newest + 1 + self.missed(absence, at);
            report_disconnect(absence, newest + 1, next, at, name, out);
        }
    }

    /// At the end of all samples: reports, for the last time, the samples missed by a device that
    /// is still disconnected.
    pub(super) fn end(&mut self, numbers: &Renumber, at: HostTime, name: &str, out: &Out) {
        self.report_rejected(at, name, out);
        self.report_absent(numbers, at, name, out);
        self.absence = None;
    }

    /// Reports the number of late or repeated samples in one notice, because a device may repeat
    /// every sample.
    pub(super) fn report_rejected(&mut self, at: HostTime, name: &str, out: &Out) {
        let count = std::mem::take(&mut self.rejected);
        if count > 0 {
            out(Outgoing::Notice {
                at,
                text: format!("{name}: late or repeated samples, rejected: {count}"),
                stream: name.to_owned(),
            });
        }
    }

    pub(super) fn check(&mut self, name: &str, now: HostTime, out: &Out) {
        let last = *self.last.get_or_insert(now);
        // The next check, which may itself be a little late, would be too late for the limit.
        let silent = now.since(last) + TICK_NS * 3 / 2 > self.limit_ns;
        self.set_silent(silent, now, name, out);
    }

    /// Suspends the detection: the reason for the silence is known. Silence counts from the next
    /// [`Self::check`] on.
    pub(super) fn hold(&mut self) {
        if !self.silent {
            self.last = None;
        }
    }

    fn set_silent(&mut self, silent: bool, at: HostTime, name: &str, out: &Out) {
        if silent != self.silent {
            self.silent = silent;
            let text = format!("{name}: no samples");
            out(Outgoing::Alarm {
                at,
                text,
                stream: name.to_owned(),
                active: silent,
            });
        }
    }

    /// Whether the time without a new image is too long; the next frame would be too late to report
    /// it.
    pub(super) fn is_too_long(&self, span_ns: i64) -> bool {
        span_ns + self.period_ns > self.limit_ns
    }

    /// Starts the rate measurement.
    pub(super) fn begin_rates(&mut self) {
        self.received_before = self.received;
    }

    pub(super) fn health(&mut self, name: &str, span_ns: i64) -> StreamHealth {
        let new = self.received - self.received_before;
        self.received_before = self.received;
        StreamHealth {
            name: name.to_owned(),
            rate_hz: new as f64 * NS_PER_S as f64 / span_ns.max(1) as f64,
            received: self.received,
            silent: self.silent,
            ..StreamHealth::default()
        }
    }
}

/// Reports samples `first..next` as missed during the disconnect, noticed at `at`.
fn report_disconnect(
    absence: &Absence,
    first: u64,
    next: u64,
    at: HostTime,
    name: &str,
    out: &Out,
) {
    if next > first {
        out(Outgoing::Dropped {
            at,
            stream: name.to_owned(),
            first,
            last: next - 1,
            cause: Cause::Disconnected,
            detail: absence.disconnect.detail.clone(),
        });
    }
}
