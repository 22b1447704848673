//! Alarms: raised and ended, logged, reported to observers, and stored as events.

use machine::ladder::{Cause, Change, Step};
use session_archive::record::paws::event::Kind;
use session_archive::time::HostTime;

use super::Recorder;
use super::alarm_sources::{LOSSES, RECOVERY, cause_name, concern_of};
use crate::status::Progress;

impl Recorder {
    pub(super) fn on_alarm(&mut self, at: HostTime, text: String, stream: &str, active: bool) {
        if active {
            log::warn!("{text}");
            self.alarms.insert(text.clone(), concern_of(stream));
            if stream == RECOVERY {
                self.recovered.push(text.clone());
            }
        } else {
            log::info!("over: {text}");
            self.alarms.remove(&text);
        }
        // First: if the event cannot be written, the session ends, and with it some alarms.
        (self.on_progress)(Progress::Alarm {
            text: text.clone(),
            active,
        });
        self.event(
            if active { Kind::Fault } else { Kind::Cleared },
            at,
            stream,
            &text,
        );
    }

    /// Reports streams that are losing samples, and streams that no longer do.
    pub(super) fn check_losses(&mut self, at: HostTime) {
        let streams = self.session.iter_mut().flat_map(|s| &mut s.streams);
        let changes: Vec<_> = streams.flat_map(|s| s.losses.check(&s.name)).collect();
        for (text, active) in changes {
            // Writing one may end the session, and with it the active alarms.
            if self.session.is_some() || !active {
                self.on_alarm(at, text, LOSSES, active);
            }
        }
    }

    /// Reports scarce resources: one alarm per cause, whose text follows the measures taken.
    pub(super) fn report_changes(&mut self, at: HostTime, changes: Vec<Change>) {
        for change in changes {
            let source = cause_name(change.cause);
            if let Some(over) = self.cause_alarms.remove(&change.cause) {
                self.on_alarm(at, over, source, false);
            }
            // Low disk space is reported by the disk's own alarm.
            let is_reported = change.cause == Cause::Disk && change.to == Step::Warn;
            if change.to > Step::Normal && !is_reported {
                self.on_alarm(at, change.text.clone(), source, true);
                self.cause_alarms.insert(change.cause, change.text);
            }
        }
    }
}
