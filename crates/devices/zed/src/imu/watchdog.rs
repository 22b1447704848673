//! When the device is to be pinged, and what to do about its silence. Pure: time in, actions out.
//!
//! Silence of [`SILENT_NS`] is reported, then the stream is stopped and started again. After
//! [`PATIENCE_NS`] more the device is closed and opened again; then all of it from the start, but
//! reported only once. A report ends it. The ping has its own time and is due whether or not
//! reports come: a loop that counted reports would be minutes late with a silent device, which
//! would then stay silent for want of pings.

use crate::command::PING_EVERY_NS;

/// Without a report for so long the device is silent, ns.
pub const SILENT_NS: i64 = 500_000_000;
/// How long a started stream has to bring a report before more is done, ns.
pub const PATIENCE_NS: i64 = 1_000_000_000;

/// Something that is due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WatchdogAction {
    /// Send a ping.
    Ping,
    /// Say that the device is silent.
    ReportSilence,
    /// Stop the stream and start it.
    Restart,
    /// Close the device and open it.
    Reopen,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Listening,
    Reported,
    Restarted,
}

#[derive(Clone, Debug)]
pub(super) struct Watchdog {
    stage: Stage,
    /// The last report, or what was done since.
    since: i64,
    /// The last report, or the opening.
    last_report: i64,
    pinged: i64,
    reported: bool,
}

impl Watchdog {
    /// The device was opened, started and pinged at `now`.
    pub(super) fn new(now: i64) -> Self {
        Self {
            stage: Stage::Listening,
            since: now,
            last_report: now,
            pinged: now,
            reported: false,
        }
    }

    /// A report came.
    pub(super) fn report(&mut self, now: i64) {
        *self = Self {
            pinged: self.pinged,
            ..Self::new(now)
        };
    }

    /// When the last report came, or the device was first opened.
    pub(super) fn last_report(&self) -> i64 {
        self.last_report
    }

    /// What is due at `now`. It is taken as done.
    pub(super) fn due(&mut self, now: i64) -> Option<WatchdogAction> {
        if now >= self.ping_at() {
            self.pinged = now;
            return Some(WatchdogAction::Ping);
        }
        if now < self.act_at() {
            return None;
        }
        match self.stage {
            Stage::Listening if !self.reported => {
                self.reported = true;
                self.stage = Stage::Reported;
                Some(WatchdogAction::ReportSilence)
            }
            Stage::Listening | Stage::Reported => {
                self.stage = Stage::Restarted;
                self.since = now;
                self.pinged = now;
                Some(WatchdogAction::Restart)
            }
            Stage::Restarted => {
                self.stage = Stage::Listening;
                self.since = now;
                self.pinged = now;
                Some(WatchdogAction::Reopen)
            }
        }
    }

    /// When something will be due.
    pub(super) fn next(&self) -> i64 {
        self.ping_at().min(self.act_at())
    }

    fn ping_at(&self) -> i64 {
        self.pinged.saturating_add(PING_EVERY_NS)
    }

    fn act_at(&self) -> i64 {
        self.since.saturating_add(match self.stage {
            Stage::Listening | Stage::Reported => SILENT_NS,
            Stage::Restarted => PATIENCE_NS,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs to `until` without a report; what was due when, ms.
    fn silence(dog: &mut Watchdog, until: i64) -> Vec<(i64, WatchdogAction)> {
        let mut done = Vec::new();
        while dog.next() < until {
            let now = dog.next();
            while let Some(duty) = dog.due(now) {
                done.push((now / 1_000_000, duty));
            }
        }
        done
    }

    #[test]
    fn silence_is_reported_once_and_acted_upon_again_and_again() {
        let mut dog = Watchdog::new(0);
        let done = silence(&mut dog, 3_600_000_000);
        let acts: Vec<_> = done
            .into_iter()
            .filter(|d| d.1 != WatchdogAction::Ping)
            .collect();
        let expected = [
            (500, WatchdogAction::ReportSilence),
            (500, WatchdogAction::Restart),
            (1500, WatchdogAction::Reopen),
            (2000, WatchdogAction::Restart),
            (3000, WatchdogAction::Reopen),
            (3500, WatchdogAction::Restart),
        ];
        assert_eq!(acts, expected);
        dog.report(4_000_000_000);
        assert_eq!(dog.last_report(), 4_000_000_000);
        let acts = silence(&mut dog, 4_600_000_000);
        assert!(
            acts.contains(&(4500, WatchdogAction::ReportSilence)),
            "{acts:?}"
        );
    }

    #[test]
    fn pings_come_each_second_whether_or_not_reports_do() {
        let mut dog = Watchdog::new(0);
        let mut pings = Vec::new();
        for now in (0..10_000).map(|k| k * 1_250_000) {
            dog.report(now);
            while let Some(duty) = dog.due(now) {
                assert_eq!(duty, WatchdogAction::Ping);
                pings.push(now / 1_000_000);
            }
        }
        assert_eq!(
            pings,
            (1..13)
                .map(|s| s * 1000)
                .take_while(|&s| s < 12_500)
                .collect::<Vec<_>>()
        );
        // A start of the stream counts as a ping, so none is more than a second late.
        let mut dog = Watchdog::new(0);
        let mut last = 0;
        for (at, _) in silence(&mut dog, 60_000_000_000) {
            assert!(at - last <= 1000);
            last = at;
        }
    }
}
