//! What a person without a screen has to know, in order of priority.
//!
//! Contract: the operator's [`Status`] is handed over as a whole whenever a part changes; one
//! signal is shown at a time. An answer to a press ([`Once`]) comes before everything for a second.
//! Then, first to last: the question about discarding, a fault, the most urgent warning, the phase.
//! A warning keeps saying whether it records. While starting and saving, warnings wait.

use std::collections::BTreeSet;

/// What the recorder is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Phase {
    /// Getting ready: a press does nothing yet.
    #[default]
    Starting,
    /// A press starts a recording.
    Ready,
    /// Recording.
    Recording,
    /// The recording was stopped and is being made safe.
    Saving,
}

/// What a person can do something about. Most urgent first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Warning {
    /// A camera or IMU is silent, disconnected or shows the same frame again and again.
    Stream,
    /// Little room is left on the disk.
    Storage,
    /// The battery is low.
    Battery,
    /// The machine is so hot that it slows down.
    Heat,
}

/// Everything that lasts.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// What the recorder is doing.
    pub phase: Phase,
    /// What is wrong but does not end the recording.
    pub warnings: BTreeSet<Warning>,
    /// Recording has failed, or cannot be done.
    pub fault: bool,
    /// After a long press: waiting for the confirmation to discard.
    pub question: bool,
}

/// One-time signals that answer a press.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Once {
    /// A recording has begun.
    Started,
    /// The moment is marked.
    Marked,
    /// The recording is discarded.
    Discarded,
    /// The command cannot be fulfilled now.
    Refused,
}

/// One thing to show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Signal {
    /// A phase in which nothing is wrong.
    Phase(Phase),
    /// A warning.
    Warning {
        /// What is wrong.
        what: Warning,
        /// Whether it records.
        recording: bool,
    },
    /// Recording has failed, or cannot be done.
    Fault,
    /// Discard the recording?
    Question,
    /// An answer.
    Once(Once),
}

impl Warning {
    /// All, most urgent first.
    pub const ALL: [Self; 4] = [Self::Stream, Self::Storage, Self::Battery, Self::Heat];
}

impl Status {
    /// What to show, answers aside.
    pub fn signal(&self) -> Signal {
        let recording = self.phase == Phase::Recording;
        if self.question {
            Signal::Question
        } else if self.fault {
            Signal::Fault
        } else if let (Some(&what), Phase::Ready | Phase::Recording) =
            (self.warnings.first(), self.phase)
        {
            Signal::Warning { what, recording }
        } else {
            Signal::Phase(self.phase)
        }
    }
}

/// What a signal says in general: what a person must know within a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Meaning {
    /// Wait.
    Busy,
    /// It does not record and could.
    Ready,
    /// It records.
    Recording,
    /// It does not record, could, and something is wrong.
    ReadyWarning,
    /// It records and something is wrong.
    RecordingWarning,
    /// It has failed.
    Fault,
    /// It asks something.
    Question,
    /// It answers.
    Answer(Once),
}

impl Signal {
    /// Every signal, in the order in which a person meets them.
    pub fn all() -> Vec<Self> {
        use Signal::{Fault, Phase as P, Question};
        let mut all = vec![P(Phase::Starting), P(Phase::Ready)];
        all.extend([Self::Once(Once::Started), P(Phase::Recording)]);
        all.extend([Self::Once(Once::Marked), P(Phase::Saving)]);
        for recording in [true, false] {
            all.extend(Warning::ALL.map(|what| Self::Warning { what, recording }));
        }
        all.extend([Fault, Self::Once(Once::Refused)]);
        all.extend([Question, Self::Once(Once::Discarded)]);
        all
    }

    /// What it says in general.
    pub fn meaning(self) -> Meaning {
        match self {
            Self::Phase(Phase::Starting | Phase::Saving) => Meaning::Busy,
            Self::Phase(Phase::Ready) => Meaning::Ready,
            Self::Phase(Phase::Recording) => Meaning::Recording,
            Self::Warning {
                recording: true, ..
            } => Meaning::RecordingWarning,
            Self::Warning {
                recording: false, ..
            } => Meaning::ReadyWarning,
            Self::Fault => Meaning::Fault,
            Self::Question => Meaning::Question,
            Self::Once(once) => Meaning::Answer(once),
        }
    }

    /// What it says, for the table.
    pub fn says(self) -> &'static str {
        match self {
            Self::Phase(Phase::Starting) => "Starting up",
            Self::Phase(Phase::Ready) => "Ready, not recording",
            Self::Phase(Phase::Recording) => "RECORDING, all is well",
            Self::Phase(Phase::Saving) => "Stopped, saving",
            Self::Warning { what, recording } => match (what, recording) {
                (Warning::Stream, true) => "RECORDING, a sensor fails",
                (Warning::Stream, false) => "Ready, a sensor fails",
                (Warning::Storage, true) => "RECORDING, disk nearly full",
                (Warning::Storage, false) => "Ready, disk nearly full",
                (Warning::Battery, true) => "RECORDING, battery low",
                (Warning::Battery, false) => "Ready, battery low",
                (Warning::Heat, true) => "RECORDING, too hot",
                (Warning::Heat, false) => "Ready, too hot",
            },
            Self::Fault => "FAULT, it does not record",
            Self::Question => "Discard the recording?",
            Self::Once(Once::Started) => "The recording has begun",
            Self::Once(Once::Marked) => "Moment marked",
            Self::Once(Once::Discarded) => "The recording is discarded",
            Self::Once(Once::Refused) => "Refused, not possible now",
        }
    }

    /// What the person does about it, for the table.
    pub(crate) fn do_what(self) -> &'static str {
        match self {
            Self::Phase(Phase::Starting) => "Wait; after a minute see the phone page",
            Self::Phase(Phase::Ready) => "Press to start",
            Self::Phase(Phase::Recording) => "Walk; press to stop, twice to mark",
            Self::Phase(Phase::Saving) => "Wait; leave the power on",
            Self::Warning { what, .. } => match what {
                Warning::Stream => "Check cables; the phone page says which",
                Warning::Storage => "Finish soon; fetch the recordings",
                Warning::Battery => "Finish soon; change the battery",
                Warning::Heat => "Find shade; free the vents",
            },
            Self::Fault => "Stop walking; the phone page says why",
            Self::Question => "Press within 5 s to discard, or wait",
            Self::Once(Once::Started) => "Walk",
            Self::Once(Once::Marked) => "Walk on",
            Self::Once(Once::Discarded) => "Press to start again",
            Self::Once(Once::Refused) => "See what the light shows next",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(phase: Phase, warnings: &[Warning], fault: bool, question: bool) -> Signal {
        let warnings = warnings.iter().copied().collect();
        let status = Status {
            phase,
            warnings,
            fault,
            question,
        };
        status.signal()
    }

    #[test]
    fn the_most_urgent_is_reported() {
        use Warning::{Battery, Heat, Storage, Stream};
        let warning = |what, recording| Signal::Warning { what, recording };
        let all = [Heat, Battery, Storage, Stream];
        for (phase, warnings, fault, question, expected) in [
            (
                Phase::Ready,
                &[][..],
                false,
                false,
                Signal::Phase(Phase::Ready),
            ),
            (Phase::Ready, &[Heat], false, false, warning(Heat, false)),
            (Phase::Recording, &all, false, false, warning(Stream, true)),
            (
                Phase::Recording,
                &all[..3],
                false,
                false,
                warning(Storage, true),
            ),
            (Phase::Recording, &all, true, false, Signal::Fault),
            (Phase::Recording, &all, true, true, Signal::Question),
            (
                Phase::Saving,
                &all,
                false,
                false,
                Signal::Phase(Phase::Saving),
            ),
            (
                Phase::Starting,
                &all,
                false,
                false,
                Signal::Phase(Phase::Starting),
            ),
        ] {
            assert_eq!(status(phase, warnings, fault, question), expected);
        }
    }

    #[test]
    fn every_signal_is_listed_once() {
        let all = Signal::all();
        let different: std::collections::HashSet<_> = all.iter().collect();
        assert_eq!(different.len(), all.len());
        assert_eq!(all.len(), 4 + 2 * Warning::ALL.len() + 2 + 4);
    }
}
