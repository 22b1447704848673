//! Losses of each stream in a session, by cause, and the alarm while samples are being lost.
//!
//! Contract: every number in a gap record, or reported to be in a future one, is counted once for
//! the alarm when the loss becomes known, and once for the account when the gap is written. *While
//! a stream loses samples* one alarm is active, from at most a second after the first loss until
//! [`CALM_CHECKS`] checks without one. Frames dropped on purpose are in the account and raise no
//! alarm, because load shedding raises its own. The same holds for disconnected devices.

use std::collections::BTreeMap;

use session_archive::record::paws::gap::Cause;

use crate::status::CauseCount;

/// Number of checks, one a second, without a loss after which the alarm ends.
const CALM_CHECKS: u32 = 5;

/// Losses of one stream.
#[derive(Debug, Default)]
pub(super) struct Losses {
    /// Missing samples by cause, as in gap records.
    account: BTreeMap<i32, u64>,
    /// Losses since the last check, with the cause of the newest.
    recent: Option<Cause>,
    alarm: Option<Alarm>,
}

#[derive(Debug)]
struct Alarm {
    text: String,
    calm: u32,
}

impl Losses {
    /// Counts `count` samples of a gap record.
    pub(super) fn gap(&mut self, cause: Cause, count: u64) {
        *self.account.entry(cause.into()).or_default() += count;
        // These were not reported before.
        if cause == Cause::Device {
            self.report(cause);
        }
    }

    /// Counts samples that are reported as lost.
    pub(super) fn report(&mut self, cause: Cause) {
        if !matches!(cause, Cause::LoadShed | Cause::Disconnected) {
            self.recent = Some(cause);
        }
    }

    /// Missing samples by cause, largest count first.
    pub(super) fn by_cause(&self) -> Vec<CauseCount> {
        let mut counts: Vec<CauseCount> = self
            .account
            .iter()
            .map(|(cause, count)| CauseCount {
                cause: cause_text(Cause::try_from(*cause).unwrap_or_default()).to_owned(),
                count: *count,
            })
            .collect();
        counts.sort_by_key(|of| std::cmp::Reverse(of.count));
        counts
    }

    /// To be called once a second: the alarms of the stream `name` that end and begin, each with
    /// its text.
    pub(super) fn check(&mut self, name: &str) -> Vec<(String, bool)> {
        let mut changes = Vec::new();
        match self.recent.take() {
            Some(cause) => {
                let text = format!("{name}: samples are being lost: {}", cause_text(cause));
                match &mut self.alarm {
                    Some(alarm) if alarm.text == text => alarm.calm = 0,
                    alarm => {
                        changes.extend(alarm.take().map(|over| (over.text, false)));
                        changes.push((text.clone(), true));
                        *alarm = Some(Alarm { text, calm: 0 });
                    }
                }
            }
            None => {
                if let Some(alarm) = &mut self.alarm {
                    alarm.calm += 1;
                    if alarm.calm >= CALM_CHECKS {
                        changes.extend(self.end());
                    }
                }
            }
        }
        changes
    }

    /// Ends the alarm with the session.
    pub(super) fn end(&mut self) -> Option<(String, bool)> {
        self.alarm.take().map(|over| (over.text, false))
    }
}

/// Description of a cause, for people.
fn cause_text(cause: Cause) -> &'static str {
    match cause {
        Cause::Unknown => "cause not known",
        Cause::Device => "the device skipped them",
        Cause::Disconnected => "the device was disconnected",
        Cause::EncoderOverload => "the machine is too slow to encode them",
        Cause::EncoderRestart => "the encoder failed",
        Cause::WriterOverload => "the disk is too slow",
        Cause::Storage => "the disk failed",
        Cause::Damaged => "found damaged",
        Cause::Late => "came too late",
        Cause::LoadShed => "dropped to reduce the load on the machine",
        Cause::MachineOverload => "the machine is too slow to take them",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alarm_is_active_exactly_while_samples_are_lost() {
        let mut losses = Losses::default();
        assert_eq!(losses.check("feet"), []);
        losses.report(Cause::EncoderOverload);
        losses.report(Cause::EncoderOverload);
        let text = "feet: samples are being lost: the machine is too slow to encode them";
        assert_eq!(losses.check("feet"), [(text.to_owned(), true)]);
        for _ in 1..CALM_CHECKS {
            assert_eq!(losses.check("feet"), []);
        }
        losses.report(Cause::EncoderOverload);
        assert_eq!(losses.check("feet"), [], "it stands already");
        for _ in 1..CALM_CHECKS {
            assert_eq!(losses.check("feet"), []);
        }
        assert_eq!(losses.check("feet"), [(text.to_owned(), false)]);
    }

    #[test]
    fn each_cause_has_its_own_alarm() {
        let mut losses = Losses::default();
        losses.report(Cause::WriterOverload);
        let first = losses.check("feet");
        losses.gap(Cause::Device, 3);
        let then = losses.check("feet");
        assert_eq!(then[0], (first[0].0.clone(), false));
        assert!(then[1].1 && then[1].0.contains("device"), "{then:?}");
        assert_eq!(losses.end(), Some((then[1].0.clone(), false)));
        assert_eq!(losses.check("feet"), []);
    }

    #[test]
    fn shed_samples_are_counted_without_an_alarm() {
        let mut losses = Losses::default();
        losses.report(Cause::LoadShed);
        losses.gap(Cause::LoadShed, 7);
        losses.gap(Cause::Late, 9);
        losses.gap(Cause::Late, 1);
        assert_eq!(losses.check("feet"), []);
        let counts: Vec<u64> = losses.by_cause().iter().map(|c| c.count).collect();
        assert_eq!(counts, [10, 7]);
    }
}
