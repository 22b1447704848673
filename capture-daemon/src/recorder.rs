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
use std::path::PathBuf;
use std::sync::Arc;

use machine::ladder::{Cause, Ladder};
use session_archive::record::Event;
use session_archive::record::paws::event::Kind;
use session_archive::time::{HostTime, NS_PER_S};
use session_archive::writer::{Incident, WriteError};

use crate::clock::Clock;
use crate::encoding::Encoding;
use crate::error_chain::with_causes;
use crate::hub::{Outgoing, StreamHealth};
use crate::status::{Concern, MachineStatus, Progress, Request, Response};

mod alarm_sources;
mod alarms;
mod disk_guard;
mod gap_records;
mod health;
mod losses;
mod machine_watch;
mod preroll;
mod report;
mod session;
mod session_store;
mod setup;
mod start;
mod stop;
mod stop_limits;
#[cfg(test)]
mod tests;
mod timed;

pub(crate) use alarm_sources::RECOVERY;
pub use session_store::{MachineReading, SessionStore};
pub use setup::Setup;
pub use stop_limits::{MAX_STOP_NS, STOP_LIMIT_NS};

use preroll::{MAX_PRE_ROLL_BYTES, PreRoll};
use session::Session;
use stop_limits::item_time;

/// Queues between the sources and the recorder.
pub struct Queues {
    /// Number of bytes that wait for the recorder.
    pub bytes: Box<dyn Fn() -> u64 + Send>,
    /// Frames inside the encoders.
    pub encoding: Encoding,
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

    /// Cameras whose next frame should be a key frame, since the last call.
    pub fn take_key_frame_requests(&mut self) -> Vec<usize> {
        std::mem::take(&mut self.key_frame_requests)
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
