//! The start of a session.

use std::io;
use std::sync::Arc;

use machine::ladder::Step;
use session_archive::record::ClockMap;
use session_archive::record::paws::event::Kind;
use session_archive::time::{CivilTime, HostTime};
use session_archive::writer::{SessionSpec, SessionWriter, WriteError};

use super::Recorder;
use super::alarm_sources::RECOVERY;
use super::session::Session;
use super::stop_limits::item_time;
use super::timed::TimedStorage;
use crate::disk::START_MARGIN_BYTES;
use crate::error_chain::with_causes;
use crate::hub::Outgoing;
use crate::status::Progress;

impl Recorder {
    /// Starts a session with the pre-roll and the samples that arrive from now on.
    ///
    /// # Errors
    /// The reason why it cannot start, for people.
    pub fn start(&mut self, name: &str, source: &str) -> Result<(), String> {
        if let Some(session) = &self.session {
            return Err(format!("already recording {}", session.path.display()));
        }
        self.free_bytes = self.store.free_bytes();
        let needed = self.setup.reserve_bytes.saturating_add(START_MARGIN_BYTES);
        if let Some(free) = self.free_bytes
            && free < needed
        {
            return Err(format!(
                "too little space to start: {} MB are free, {} MB are needed (reserve {} MB)",
                free >> 20,
                needed >> 20,
                self.setup.reserve_bytes >> 20
            ));
        }
        if self.ladder.mitigations().stop {
            let reasons = self.ladder.reasons().into_iter();
            let reasons: Vec<String> = reasons
                .filter(|(_, step, _)| *step == Step::StopCleanly)
                .map(|(_, _, text)| text)
                .collect();
            return Err(format!("not now: {}", reasons.join("; ")));
        }
        let at = self.clock.now();
        for text in std::mem::take(&mut self.recovered) {
            self.on_alarm(at, text, RECOVERY, false);
        }
        let changes = self.ladder.begin_recording(at.0);
        self.report_changes(at, changes);
        let beginning = self
            .pre_roll
            .take(at + -self.setup.pre_roll_ns, self.setup.cameras.len());
        let session = match self.open(name, at, &beginning.items) {
            Ok(session) => session,
            Err(e) => {
                self.pre_roll.put_back(beginning);
                let message = format!("the session cannot be created: {}", with_causes(&e));
                self.fault = Some(message.clone());
                return Err(message);
            }
        };
        self.fault = None;
        let path = session.path.clone();
        self.last_session = Some(path.clone());
        self.session = Some(session);
        (self.on_progress)(Progress::Started {
            session: path,
            at,
            notes: self.setup.notes(),
        });
        self.statics(at, &beginning.maps);
        for item in beginning.items {
            if let Outgoing::Clock { at, map } = &item {
                self.pre_roll.remember(*at, map);
            }
            self.sample(item);
            // Reports every chunk meanwhile: with a slow disk this takes a while.
            self.after();
        }
        let without_key = self
            .session
            .iter()
            .flat_map(|s| s.without_key.iter().enumerate());
        self.key_frame_requests = without_key
            .filter(|(_, w)| **w)
            .map(|(camera, _)| camera)
            .collect();
        self.event(Kind::Start, at, source, name);
        self.after();
        if self.session.is_some() {
            Ok(())
        } else {
            Err(self
                .fault
                .clone()
                .unwrap_or_else(|| "the session could not be written".to_owned()))
        }
    }

    fn open(&mut self, name: &str, at: HostTime, items: &[Outgoing]) -> io::Result<Session> {
        let setup = &self.setup;
        let started = items
            .iter()
            .filter_map(item_time)
            .min()
            .map_or(at, |t| t.min(at));
        // The host clock and civil time of the same instant.
        let started_civil = CivilTime(self.clock.civil().0 - (self.clock.now() - started));
        let (path, storage, session_id) = self.store.create(started_civil)?;
        let timed = Arc::new(TimedStorage::new(storage, self.clock.clone()));
        let spec = SessionSpec {
            session_id,
            name: if name.is_empty() {
                setup.name.clone()
            } else {
                name.to_owned()
            },
            software: setup.software.clone(),
            started,
            started_civil,
            chunk_ns: setup.chunk_ns,
            cameras: setup.cameras.clone(),
            imus: setup.imus.clone(),
            rig: setup.rig_files.clone(),
        };
        let writer = SessionWriter::create(timed.clone(), spec).map_err(|e| {
            // It is still empty.
            let _ = self.store.discard(&path);
            io::Error::other(e)
        })?;
        Ok(Session::new(path, writer, timed, setup, started))
    }

    /// Stores records that do not change during a recording: transforms, calibrations, and the
    /// clock maps so far.
    fn statics(&mut self, at: HostTime, maps: &[ClockMap]) {
        let Some(session) = &mut self.session else {
            return;
        };
        let writer = &mut session.writer;
        let setup = &self.setup;
        let mut write = || -> Result<(), WriteError> {
            if !setup.transforms.transforms.is_empty() {
                writer.append("", at, at, &setup.transforms)?;
            }
            for (frame, calibration) in &setup.calibrations {
                writer.append(frame, at, at, calibration)?;
            }
            for map in maps {
                writer.append(&map.clock, at, at, map)?;
            }
            Ok(())
        };
        let written = write();
        self.check(written);
    }
}
