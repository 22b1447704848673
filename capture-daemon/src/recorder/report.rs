//! The state and the status of the recorder.

use super::Recorder;
use super::machine_watch::step_name;
use super::session::Session;
use crate::status::{State, Status, StreamStatus};

impl Recorder {
    /// The state.
    pub fn state(&self) -> State {
        match &self.session {
            Some(Session {
                stopping: Some(_), ..
            }) => State::Stopping,
            Some(_) => State::Recording,
            None if self.fault.is_some() => State::Fault,
            None if self.delivered.iter().all(|s| *s) => State::Armed,
            None => State::Idle,
        }
    }

    /// Complete status of the recorder.
    pub fn status(&self) -> Status {
        let session = self.session.as_ref();
        let cameras = self.setup.cameras.iter().map(|c| &c.name);
        let names = cameras.chain(self.setup.imus.iter().map(|i| &i.name));
        let streams = names.enumerate().map(|(i, name)| {
            let health = self.health.get(i).cloned().unwrap_or_default();
            let last = self.last_totals.1.get(i).copied().unwrap_or_default();
            let (stored, missing) =
                session.map_or(last, |s| (s.streams[i].stored, s.streams[i].missing));
            StreamStatus {
                name: name.clone(),
                rate_hz: health.rate_hz,
                received: health.received,
                stored,
                missing,
                silent: health.silent,
                frozen: health.frozen,
            }
        });
        Status {
            state: self.state(),
            session: session
                .map(|s| s.path.clone())
                .or_else(|| self.last_session.clone()),
            seconds: session.map_or(self.last_totals.0, Session::seconds),
            durable_until: session.map(|s| s.writer.durability().until),
            streams: streams.collect(),
            free_bytes: self.free_bytes,
            seconds_left: self.seconds_left,
            alarms: self
                .alarms
                .keys()
                .cloned()
                .chain(self.fault.clone())
                .collect(),
            notes: self.setup.notes(),
            concerns: self.alarms.values().copied().collect(),
            encoders: self
                .setup
                .cameras
                .iter()
                .map(|c| c.encoder.clone())
                .collect(),
            machine: self.machine.clone(),
            degradation: step_name(self.ladder.step()).to_owned(),
        }
    }
}
