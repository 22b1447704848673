//! The recorder: keeps the last seconds, opens and closes sessions, accounts for every sample.
//!
//! It receives [`Outgoing`] items in order, and requests; it reads the clock that it was given, and
//! owns no thread. Contract:
//!
//! * *At a press* the session begins with the pre-roll: for every camera with a key frame from
//!   before it, so nothing has to be waited for. A camera without one, because a session has just
//!   ended or there is no pre-roll, begins with its next key frame, which is requested
//!   ([`Recorder::take_key_frame_requests`]). Without a pre-roll only clock maps are kept from
//!   before the press.
//! * *At a gap* a gap record contains the numbers and the cause. Frames and gaps together cover
//!   every number from a stream's first to its last.
//! * *At a stop* samples received before it are waited for: [`STOP_LIMIT_NS`], and longer while
//!   frames are still being encoded or queued, up to [`MAX_STOP_NS`].
//! * *While samples are lost* an alarm with the cause is active, within two seconds.
//! * *When the session's folder is removed* the recording ends as failed, at the latest with the
//!   next chunk.
//! * *When the disk is nearly full* it stops cleanly; *when it fails* the session is closed as far
//!   as it is on disk, samples that are not known to be on disk are counted as missing, and the
//!   state is a fault. Nothing here panics or retries without end.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use machine::ladder::{Cause, Change, Ladder, Mitigations, Pressure, Step};
use session_archive::manifest::{Camera, Imu, Stop};
use session_archive::record::paws::event::Kind;
use session_archive::record::paws::health::Stream as StreamRecord;
use session_archive::record::{CameraCalibration, ClockMap, Event, FrameTransforms, Health};
use session_archive::storage::Storage;
use session_archive::time::{CivilTime, HostTime, NS_PER_S};
use session_archive::writer::{Incident, SessionSpec, SessionWriter, WriteError};

use crate::clock::Clock;
use crate::disk::START_MARGIN_BYTES;
use crate::encoding::Encoding;
use crate::error_chain::with_causes;
use crate::hub::{Outgoing, StreamHealth};
use crate::status::{
    Concern, MachineStatus, Progress, Request, Response, State, Status, StreamStatus,
};

mod health;
mod losses;
mod preroll;
mod session;
#[cfg(test)]
mod tests;
mod timed;

use health::{battery_record, clock_record, frame_sync_record};
use preroll::{MAX_PRE_ROLL_BYTES, PreRoll};
use session::{Session, Stopping};
use timed::TimedStorage;

/// Time that a stop waits for streams of which nothing is being encoded or queued, ns.
pub const STOP_LIMIT_NS: i64 = 250_000_000;
/// Maximum time that a stop waits for samples that are being encoded or queued, ns.
pub const MAX_STOP_NS: i64 = 20 * NS_PER_S;
/// A warning is raised when less than this can still be recorded, s.
const MIN_SECONDS_LEFT: f64 = 600.0;
/// Source of alarms about earlier recordings; they are active until the next recording begins.
pub(crate) const RECOVERY: &str = "recovery";
/// Source of alarms about lost samples.
const LOSSES: &str = "losses";
const DISK_LOW: &str = "disk: less than 10 minutes can still be recorded";
const DISK_FULL: &str = "disk: too full to record";

/// Storage of sessions.
pub trait SessionStore: Send {
    /// Creates an empty folder for a session that began at this time, and an identifier for it.
    ///
    /// # Errors
    /// Any I/O error of the underlying file system.
    fn create(&mut self, started: CivilTime) -> io::Result<(PathBuf, Arc<dyn Storage>, String)>;

    /// Deletes a session's folder.
    ///
    /// # Errors
    /// Any I/O error of the underlying file system.
    fn discard(&mut self, path: &Path) -> io::Result<()>;

    /// Whether a session's folder still exists.
    fn is_there(&self, path: &Path) -> bool;

    /// Free space, bytes.
    fn free_bytes(&self) -> Option<u64>;

    /// State of the machine; called once a second. `recording`: the disk is being filled by a
    /// recording.
    fn machine(&mut self, now: HostTime, recording: bool) -> MachineReading;
}

/// Queues between the sources and the recorder.
pub struct Queues {
    /// Number of bytes that wait for the recorder.
    pub bytes: Box<dyn Fn() -> u64 + Send>,
    /// Frames inside the encoders.
    pub encoding: Encoding,
}

/// One reading of the machine's state.
#[derive(Clone, Debug, Default)]
pub struct MachineReading {
    /// For records, page and terminal.
    pub status: MachineStatus,
    /// Input of the degradation ladder.
    pub pressure: Pressure,
    /// Events of its clocks.
    pub events: Vec<String>,
}

/// Properties of the rig and the recording that do not change while the daemon runs.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The cameras, as the manifest lists them.
    pub cameras: Vec<Camera>,
    /// The IMUs, as the manifest lists them.
    pub imus: Vec<Imu>,
    /// Calibration per optical frame (`feet/left`).
    pub calibrations: Vec<(String, CameraCalibration)>,
    /// The rig's transforms.
    pub transforms: FrameTransforms,
    /// Files for `rig/`.
    pub rig_files: Vec<(String, Vec<u8>)>,
    /// Chunk length, ns.
    pub chunk_ns: i64,
    /// Pre-roll, ns.
    pub pre_roll_ns: i64,
    /// Recording ends when less than this is free, bytes.
    pub reserve_bytes: u64,
    /// Default name of sessions.
    pub name: String,
    /// Recording software, for the manifest.
    pub software: String,
}

impl Setup {
    /// Deficiencies of its sessions, each with a remedy.
    pub fn notes(&self) -> Vec<String> {
        let has_lens = |eye: String| self.calibrations.iter().any(|(known, _)| *known == eye);
        let cameras = self.cameras.iter().map(|camera| camera.name.as_str());
        let without: Vec<&str> = cameras
            .filter(|name| {
                !["left", "right"]
                    .map(|eye| has_lens(format!("{name}/{eye}")))
                    .iter()
                    .all(|is| *is)
            })
            .collect();
        calib::remedy::missing_intrinsics(&without)
            .into_iter()
            .collect()
    }
}

/// Callback for progress.
pub type OnProgress = Box<dyn FnMut(Progress) + Send>;

/// The recorder. See the module's documentation for its contract.
pub struct Recorder {
    setup: Setup,
    clock: Arc<dyn Clock>,
    store: Box<dyn SessionStore>,
    queues: Queues,
    on_progress: OnProgress,
    pre_roll: PreRoll,
    session: Option<Session>,
    last_session: Option<PathBuf>,
    /// Result of the last session: its length in s, and stored and missing samples per stream.
    last_totals: (f64, Vec<(u64, u64)>),
    /// Streams that have delivered.
    delivered: Vec<bool>,
    health: Vec<StreamHealth>,
    /// Active alarms, each with its subject.
    alarms: BTreeMap<String, Concern>,
    /// The active alarm about the disk.
    disk_alarm: Option<&'static str>,
    /// Texts of the alarms about earlier recordings.
    recovered: Vec<String>,
    pre_roll_alarm: bool,
    fault: Option<String>,
    free_bytes: Option<u64>,
    seconds_left: Option<f64>,
    machine: MachineStatus,
    ladder: Ladder,
    /// Texts of the active alarms of the degradation ladder, by cause.
    cause_alarms: BTreeMap<Cause, String>,
    key_frame_requests: Vec<usize>,
}

impl Recorder {
    /// Creates a recorder that waits for its sources.
    pub fn new(
        setup: Setup,
        clock: Arc<dyn Clock>,
        store: Box<dyn SessionStore>,
        queues: Queues,
        on_progress: OnProgress,
    ) -> Self {
        let streams = setup.cameras.len() + setup.imus.len();
        Self {
            pre_roll: PreRoll::new(setup.pre_roll_ns, setup.chunk_ns),
            free_bytes: store.free_bytes(),
            clock,
            store,
            queues,
            on_progress,
            session: None,
            last_session: None,
            last_totals: (0.0, Vec::new()),
            delivered: vec![false; streams],
            health: Vec::new(),
            alarms: BTreeMap::new(),
            disk_alarm: None,
            recovered: Vec::new(),
            pre_roll_alarm: false,
            fault: None,
            seconds_left: None,
            machine: MachineStatus::default(),
            ladder: Ladder::default(),
            cause_alarms: BTreeMap::new(),
            key_frame_requests: Vec::new(),
            setup,
        }
    }

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

    /// Takes the next item.
    pub fn handle(&mut self, item: Outgoing) {
        match &item {
            Outgoing::Frame { camera, .. } => self.delivered[*camera] = true,
            Outgoing::Imu { imu, .. } => self.delivered[self.setup.cameras.len() + *imu] = true,
            Outgoing::Clock { at, map } if self.session.is_some() => {
                self.pre_roll.remember(*at, map)
            }
            _ => {}
        }
        match item {
            Outgoing::Health { at, streams } => self.on_health(at, streams),
            Outgoing::Alarm {
                at,
                text,
                stream,
                active,
            } => self.on_alarm(at, text, &stream, active),
            Outgoing::Notice { at, text, stream } => {
                log::warn!("{text}");
                self.event(Kind::Warning, at, &stream, &text);
            }
            item => self.sample(item),
        }
        self.after();
    }

    /// Lets time pass while nothing arrives.
    pub fn tick(&mut self) {
        let now = self.clock.now();
        if let Some(session) = &mut self.session {
            let polled = session.writer.poll(now);
            self.check(polled);
        }
        self.after();
    }

    /// Answers a request.
    pub fn request(&mut self, request: Request, source: &str) -> Response {
        let done = match request {
            Request::Start { name } => self.start(&name, source),
            Request::Stop => self.stop(source),
            Request::Mark { text, at } => match &self.session {
                Some(session) => {
                    let now = self.clock.now();
                    let at = at.unwrap_or(now).clamp(session.started, now);
                    self.event(Kind::Mark, at, source, &text);
                    Ok(())
                }
                None => Err(format!(
                    "nothing is being recorded; the state is {}",
                    self.state()
                )),
            },
            Request::Discard => self.discard(source),
            Request::DiscardLast => self.discard_last(source),
            Request::Status => Ok(()),
        };
        match done {
            Ok(()) => Response::Ok {
                status: Box::new(self.status()),
            },
            Err(message) => Response::Error { message },
        }
    }

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

    /// Cameras whose next frame should be a key frame, since the last call.
    pub fn take_key_frame_requests(&mut self) -> Vec<usize> {
        std::mem::take(&mut self.key_frame_requests)
    }

    /// Stops: samples received before now are still stored. The session is closed [`STOP_LIMIT_NS`]
    /// later, or when nothing from before it is left in encoders and queues, by [`Self::tick`] or
    /// [`Self::handle`].
    ///
    /// # Errors
    /// Nothing is being recorded.
    pub fn stop(&mut self, source: &str) -> Result<(), String> {
        let state = self.state();
        let at = self.clock.now();
        let streams = self.delivered.len();
        let Some(session) = &mut self.session else {
            return Err(format!("nothing is being recorded; the state is {state}"));
        };
        if session.stopping.is_none() {
            session.stopping = Some(Stopping {
                at,
                reason: source.to_owned(),
                waiting: vec![true; streams],
            });
            self.event(Kind::Stop, at, source, "");
        }
        Ok(())
    }

    /// Ends a session immediately, for when nothing more can arrive.
    pub fn close_now(&mut self, source: &str) {
        if self.stop(source).is_ok() {
            self.close(None);
        }
    }

    /// Stops and deletes the session.
    fn discard(&mut self, source: &str) -> Result<(), String> {
        let Some(mut session) = self.session.take() else {
            return Err(format!(
                "nothing is being recorded; the state is {}",
                self.state()
            ));
        };
        let path = session.path.clone();
        let ended = session.end_losses();
        drop(session);
        let now = self.clock.now();
        for (text, active) in ended {
            self.on_alarm(now, text, LOSSES, active);
        }
        log::info!("{} discarded by {source}", path.display());
        self.last_session = None;
        self.last_totals = (0.0, Vec::new());
        self.store
            .discard(&path)
            .map_err(|e| format!("deleting {}: {e}", path.display()))
    }

    /// Deletes the last session.
    fn discard_last(&mut self, source: &str) -> Result<(), String> {
        if let Some(session) = &self.session {
            return Err(format!("still recording {}", session.path.display()));
        }
        let Some(path) = self.last_session.clone() else {
            return Err("there is no last recording that could be discarded".to_owned());
        };
        let discarded = self.store.discard(&path);
        // A session that could not be deleted can be deleted later; one that a host has removed
        // meanwhile no longer exists.
        let is_left = matches!(&discarded, Err(e) if e.kind() != io::ErrorKind::NotFound);
        if !is_left {
            self.last_session = None;
            self.last_totals = (0.0, Vec::new());
        }
        discarded.map_err(|e| format!("deleting {}: {e}", path.display()))?;
        log::info!("{} discarded by {source}", path.display());
        Ok(())
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

    /// Stores a sample, or the report that it is lost, in the session or in the pre-roll.
    fn sample(&mut self, item: Outgoing) {
        let Some(session) = &mut self.session else {
            return self.keep(item);
        };
        if let Some(stopping) = &mut session.stopping
            && item_time(&item).is_some_and(|t| t > stopping.at)
        {
            match item {
                Outgoing::Frame { camera, .. } => stopping.waiting[camera] = false,
                Outgoing::Imu { imu, .. } => {
                    stopping.waiting[self.setup.cameras.len() + imu] = false;
                }
                _ => {}
            }
            return self.keep(item);
        }
        let stored = session.store(item);
        self.check(stored);
    }

    /// Keeps an item that may become the beginning of the next session.
    fn keep(&mut self, item: Outgoing) {
        if self.setup.pre_roll_ns == 0 {
            // No later item would push it out: frames that nobody stores are not encoded.
            if let Outgoing::Clock { at, map } = &item {
                self.pre_roll.remember(*at, map);
            }
            return;
        }
        self.pre_roll.keep(item);
        let cut = self.pre_roll.is_cut();
        if cut != self.pre_roll_alarm {
            self.pre_roll_alarm = cut;
            let text = format!(
                "pre-roll: {} MB hold less than the {:.1} s of the configuration",
                MAX_PRE_ROLL_BYTES >> 20,
                self.setup.pre_roll_ns as f64 / NS_PER_S as f64
            );
            self.on_alarm(self.clock.now(), text, "pre-roll", cut);
        }
    }

    /// Ends the session if a write failed.
    fn check(&mut self, result: Result<(), WriteError>) {
        if let Err(e) = result {
            self.close(Some(with_causes(&e)));
        }
    }

    /// Handles the consequences of the last writes.
    fn after(&mut self) {
        let Some(session) = &mut self.session else {
            return;
        };
        session.record_incidents();
        for incident in std::mem::take(&mut session.incidents) {
            let text = describe(&incident);
            log::error!("{text}");
            let event = Event {
                kind: Kind::Fault.into(),
                source: "disk".to_owned(),
                text: text.clone(),
            };
            let at = session.last;
            if let Err(e) = session.writer.append("", at, at, &event) {
                return self.close(Some(with_causes(&e)));
            }
            (self.on_progress)(Progress::Alarm { text, active: true });
        }
        let durable = session.writer.durability();
        if durable.chunks != session.chunks_reported {
            session.chunks_reported = durable.chunks;
            session.record_durable();
            let (until, messages) = (durable.until, durable.messages);
            (self.on_progress)(Progress::Durable { until, messages });
            if !self.store.is_there(&session.path) {
                let removed = "the session's folder was removed while it was being recorded";
                return self.close(Some(removed.to_owned()));
            }
        }
        if self.is_stop_over() {
            self.close(None);
        }
    }

    /// Whether all samples from before a stop have arrived, or the limit has passed.
    fn is_stop_over(&self) -> bool {
        let Some(stopping) = self.session.as_ref().and_then(|s| s.stopping.as_ref()) else {
            return false;
        };
        let waited_ns = self.clock.now().since(stopping.at);
        if stopping.waiting.iter().all(|waits| !waits) || waited_ns >= MAX_STOP_NS {
            return true;
        }
        // In this order: frames are queued before they count as encoded.
        let mut cameras = 0..self.setup.cameras.len();
        let is_encoding =
            cameras.any(|camera| stopping.waiting[camera] && self.queues.encoding.is_busy(camera));
        waited_ns >= STOP_LIMIT_NS && !is_encoding && (self.queues.bytes)() == 0
    }

    /// Closes the session; after a failure, as far as the disk permits.
    fn close(&mut self, error: Option<String>) {
        let Some(mut session) = self.session.take() else {
            return;
        };
        let now = self.clock.now();
        let stopping = session.stopping.take();
        let settled = session.settle();
        let error = error.or_else(|| settled.err().map(|e| with_causes(&e)));
        let reason = match (&error, &stopping) {
            (Some(e), _) => format!("failure: {e}"),
            (None, Some(s)) => s.reason.clone(),
            (None, None) => "closed".to_owned(),
        };
        let at = stopping.map_or(now, |s| s.at);
        let closed = session.close(Stop {
            at,
            reason: reason.clone(),
        });
        for incident in std::mem::take(&mut session.incidents) {
            let text = describe(&incident);
            log::error!("{text}");
            (self.on_progress)(Progress::Alarm { text, active: true });
        }
        let failed = error.or_else(|| closed.err().map(|e| with_causes(&e)));
        if failed.is_some() {
            session.write_off();
        }
        let seconds = session.seconds();
        self.last_totals = (
            seconds,
            session
                .streams
                .iter()
                .map(|s| (s.stored, s.missing))
                .collect(),
        );
        let stored = session.streams.iter().map(|s| s.stored).sum();
        let missing = session.streams.iter().map(|s| s.missing).sum();
        let absent = session.absent();
        let streams = session.account();
        let ended = session.end_losses();
        let path = session.path;
        if let Some(e) = &failed {
            let text = format!(
                "recording ended by a failure: {e}; {seconds:.1} s are in {}",
                path.display()
            );
            log::error!("{text}");
            self.fault = Some(text);
        }
        (self.on_progress)(Progress::Finished {
            session: path,
            reason,
            seconds,
            stored,
            missing,
            absent,
            streams,
            error: failed,
        });
        for (text, active) in ended {
            self.on_alarm(now, text, LOSSES, active);
        }
    }

    fn event(&mut self, kind: Kind, at: HostTime, source: &str, text: &str) {
        let Some(session) = &mut self.session else {
            return;
        };
        let event = Event {
            kind: kind.into(),
            source: source.to_owned(),
            text: text.to_owned(),
        };
        let written = session.writer.append("", at, at, &event);
        self.check(written);
    }

    fn on_alarm(&mut self, at: HostTime, text: String, stream: &str, active: bool) {
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

    fn on_health(&mut self, at: HostTime, streams: Vec<StreamHealth>) {
        // While nobody stores frames, this shows that they arrive.
        for (delivered, stream) in self.delivered.iter_mut().zip(&streams) {
            *delivered |= stream.received > 0;
        }
        self.health = streams;
        self.free_bytes = self.store.free_bytes();
        self.check_machine(at);
        self.check_losses(at);
        let Some(session) = &mut self.session else {
            return self.guard_disk(at, None);
        };
        let (write_max_ns, sync_max_ns) = session.timed.take_max_durations();
        let durability = session.writer.durability();
        let mut written = 0;
        let streams = self
            .health
            .iter()
            .zip(&mut session.streams)
            .map(|(health, tally)| {
                let bytes = tally.bytes - tally.bytes_before;
                tally.bytes_before = tally.bytes;
                written += bytes;
                StreamRecord {
                    name: health.name.clone(),
                    rate_hz: health.rate_hz,
                    received: health.received,
                    stored: tally.stored,
                    missing: tally.missing,
                    queue_bytes: health.queue_bytes,
                    bitrate: 8.0 * bytes as f64,
                    silent: health.silent,
                    frozen: health.frozen,
                    frame_sync: health.frame_sync.map(frame_sync_record),
                }
            });
        let record = Health {
            streams: streams.collect(),
            writer_queue_bytes: (self.queues.bytes)(),
            write_max_ns,
            sync_max_ns,
            free_bytes: self.free_bytes.unwrap_or(0),
            temperature_c: self.machine.temperature_c,
            durable_until: durability.until.0,
            clock: self.machine.clock.as_ref().map(clock_record),
            battery: self.machine.battery.as_ref().map(battery_record),
            throttled: self.machine.throttled,
            degradation: step_name(self.ladder.step()).to_owned(),
        };
        let stored = session.writer.append("", at, at, &record);
        self.check(stored);
        self.guard_disk(at, Some(written));
    }

    /// Reports streams that are losing samples, and streams that no longer do.
    fn check_losses(&mut self, at: HostTime) {
        let streams = self.session.iter_mut().flat_map(|s| &mut s.streams);
        let changes: Vec<_> = streams.flat_map(|s| s.losses.check(&s.name)).collect();
        for (text, active) in changes {
            // Writing one may end the session, and with it the active alarms.
            if self.session.is_some() || !active {
                self.on_alarm(at, text, LOSSES, active);
            }
        }
    }

    /// Reads the state of the machine and applies the resulting measures.
    fn check_machine(&mut self, at: HostTime) {
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

    /// Reports scarce resources: one alarm per cause, whose text follows the measures taken.
    fn report_changes(&mut self, at: HostTime, changes: Vec<Change>) {
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

    /// Measures against overload of the machine that are in force.
    pub fn mitigations(&self) -> Mitigations {
        self.ladder.mitigations()
    }

    /// Warns when free space runs low or is too little to begin; stops cleanly when it has run out.
    fn guard_disk(&mut self, at: HostTime, bytes_per_second: Option<u64>) {
        let Some(free) = self.free_bytes else {
            return;
        };
        let usable = free.saturating_sub(self.setup.reserve_bytes);
        self.seconds_left = bytes_per_second.map(|rate| usable as f64 / rate.max(1) as f64);
        let full = match bytes_per_second {
            Some(_) => usable == 0,
            None => usable < START_MARGIN_BYTES,
        };
        let alarm = match self.seconds_left {
            _ if full => Some(DISK_FULL),
            Some(left) if left < MIN_SECONDS_LEFT => Some(DISK_LOW),
            _ => None,
        };
        if alarm != self.disk_alarm {
            if let Some(over) = std::mem::replace(&mut self.disk_alarm, alarm) {
                self.on_alarm(at, over.to_owned(), "disk", false);
            }
            if let Some(text) = alarm {
                self.on_alarm(at, text.to_owned(), "disk", true);
            }
        }
        if full && self.session.is_some() {
            let _ = self.stop("disk full");
        }
    }
}

fn step_name(step: Step) -> &'static str {
    match step {
        Step::Normal => "normal",
        Step::Warn => "warn",
        Step::LowerPreview => "lower preview",
        Step::LowerBitrate => "lower bitrate",
        Step::LowerFrameRate => "lower frame rate",
        Step::StopCleanly => "stop",
    }
}

fn cause_name(cause: Cause) -> &'static str {
    match cause {
        Cause::Heat => "heat",
        Cause::Throttling => "throttling",
        Cause::Battery => "battery",
        Cause::Supply => "supply",
        Cause::Disk => "disk",
        Cause::Encoder => "encoder",
    }
}

/// Subject of an alarm from this source.
fn concern_of(source: &str) -> Concern {
    match source {
        "disk" | RECOVERY => Concern::Storage,
        "battery" | "supply" => Concern::Battery,
        "heat" | "throttling" => Concern::Heat,
        _ => Concern::Stream,
    }
}

/// Description of an incident that the writer handled, for people.
fn describe(incident: &Incident) -> String {
    let what = if incident.lost.is_empty() {
        "nothing is lost"
    } else {
        "data are lost"
    };
    format!(
        "segment {} was given up ({}); {what}, recording goes on in a new one",
        incident.segment, incident.error
    )
}

/// Time that decides whether an item belongs before or after a stop.
fn item_time(item: &Outgoing) -> Option<HostTime> {
    match item {
        Outgoing::Frame { frame, .. } => Some(HostTime(frame.time)),
        Outgoing::Imu { batch, .. } => batch.times.first().map(|t| HostTime(*t)),
        Outgoing::Dropped { at, .. } => Some(*at),
        _ => None,
    }
}
