//! Every second: the state of the machine, and the measures that follow from it.

use machine::ladder::{Mitigations, Step};
use session_archive::record::paws::event::Kind;
use session_archive::time::HostTime;

use super::Recorder;

impl Recorder {
    /// Reads the state of the machine and applies the resulting measures.
    pub(super) fn check_machine(&mut self, at: HostTime) {
        let reading = self.store.machine(at, self.session.is_some());
        self.machine = reading.status;
        for text in reading.events {
            log::warn!("{text}");
            self.event(Kind::Warning, at, "clock", &text);
        }
        let changes = self.ladder.reading(at.0, &reading.pressure);
        self.report_changes(at, changes);
        if self.ladder.mitigations().stop && self.session.is_some() {
            let _ = self.stop("the machine cannot go on");
        }
    }

    /// Measures against overload of the machine that are in force.
    pub fn mitigations(&self) -> Mitigations {
        self.ladder.mitigations()
    }
}

pub(super) fn step_name(step: Step) -> &'static str {
    match step {
        Step::Normal => "normal",
        Step::Warn => "warn",
        Step::LowerPreview => "lower preview",
        Step::LowerBitrate => "lower bitrate",
        Step::LowerFrameRate => "lower frame rate",
        Step::StopCleanly => "stop",
    }
}
