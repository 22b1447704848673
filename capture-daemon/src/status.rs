//! What the recorder tells about itself: to `pawsd status`, to a button's light, to a log.

use std::collections::BTreeSet;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use session_archive::text::{NoteError, check_note};
use session_archive::time::HostTime;

/// State of the recorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Waiting for the sources: not every stream has delivered yet.
    Idle,
    /// Ready: a press starts recording at once.
    Armed,
    /// Recording.
    Recording,
    /// Asked to stop; the last frames are on their way.
    Stopping,
    /// Cannot record, see the alarms.
    Fault,
}

impl std::fmt::Display for State {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Idle => "idle",
            Self::Armed => "armed",
            Self::Recording => "recording",
            Self::Stopping => "stopping",
            Self::Fault => "fault",
        })
    }
}

/// One stream.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StreamStatus {
    /// Stream, as gap records name it.
    pub name: String,
    /// Samples per second received in the last second.
    pub rate_hz: f64,
    /// Samples received since the daemon started.
    pub received: u64,
    /// Samples stored in this session, or the last one.
    pub stored: u64,
    /// Samples missing in this session, or the last one.
    pub missing: u64,
    /// No sample for too long.
    pub silent: bool,
    /// The same picture for too long.
    pub frozen: bool,
}

/// What a person can do something about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Concern {
    /// A camera or an IMU is silent, gone, frozen or cannot be encoded.
    Stream,
    /// The disk is slow, or little is free.
    Storage,
    /// The battery or the supply is low.
    Battery,
    /// The machine is hot, or has slowed itself.
    Heat,
}

/// The machine's battery.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BatteryStatus {
    /// Charge left, 0 to 100.
    pub percent: f64,
    /// Whether it is being charged.
    pub charging: bool,
    /// How long it lasts at the present load, minutes.
    pub minutes_left: Option<f64>,
}

/// The machine's civil clock; no time in a session comes from it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockStatus {
    /// Civil time when this was looked at, ns UTC.
    pub civil: i64,
    /// Whether the system says that its clock follows a reference.
    pub synchronised: bool,
    /// What keeps it right, as in `chrony`; empty where that is not known.
    pub source: String,
    /// Offset that is still being slewed away, ns.
    pub offset_ns: i64,
    /// Error that the system estimates, ns.
    pub error_ns: u64,
    /// Error that the system does not expect to exceed, ns.
    pub max_error_ns: u64,
    /// By how much civil time has leapt since it was last looked at, ns.
    pub step_ns: i64,
}

/// What the machine says of itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MachineStatus {
    /// Hottest sensor, °C.
    pub temperature_c: Option<f64>,
    /// Whether it has slowed itself down because of heat.
    pub throttled: Option<bool>,
    /// The battery.
    pub battery: Option<BatteryStatus>,
    /// The civil clock.
    pub clock: Option<ClockStatus>,
}

/// Everything worth knowing now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// State.
    pub state: State,
    /// The session's folder while recording; afterwards that of the last session.
    pub session: Option<PathBuf>,
    /// Seconds recorded so far, pre-roll included, or length of the last session.
    pub seconds: f64,
    /// Everything with a log time up to here is on disk.
    pub durable_until: Option<HostTime>,
    /// The streams.
    pub streams: Vec<StreamStatus>,
    /// Free space where sessions go, bytes.
    pub free_bytes: Option<u64>,
    /// Seconds that can still be recorded at the present rate.
    pub seconds_left: Option<f64>,
    /// What is wrong now.
    pub alarms: Vec<String>,
    /// What recordings of this configuration lack, and what mends it.
    #[serde(default)]
    pub notes: Vec<String>,
    /// What the alarms are about.
    #[serde(default)]
    pub concerns: BTreeSet<Concern>,
    /// The encoder of each camera.
    pub encoders: Vec<String>,
    /// What the machine says of itself.
    #[serde(default)]
    pub machine: MachineStatus,
    /// What the recorder does to spare the machine; `normal` for nothing.
    #[serde(default)]
    pub degradation: String,
}

/// Missing samples of one cause.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CauseCount {
    /// The cause, for people.
    pub cause: String,
    /// How many.
    pub count: u64,
}

/// What one stream came to in a session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamAccount {
    /// Stream, as gap records name it.
    pub name: String,
    /// Whether its samples are frames.
    pub is_camera: bool,
    /// Samples stored.
    pub stored: u64,
    /// Samples missing; each is accounted for in a gap record.
    pub missing: u64,
    /// Those missing by cause, most first.
    pub causes: Vec<CauseCount>,
}

impl StreamAccount {
    /// Missing samples as a share of all, 0 to 1.
    pub fn missing_share(&self) -> f64 {
        self.missing as f64 / (self.stored + self.missing).max(1) as f64
    }
}

impl std::fmt::Display for StreamAccount {
    /// As `feet: 12.5 % of the frames are missing (15 of 120): the disk is too slow (15)`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = if self.is_camera { "frames" } else { "samples" };
        let (missing, all) = (self.missing, self.stored + self.missing);
        let share = 100.0 * self.missing_share();
        // One of a million is not none.
        let share = match share {
            s if s > 0.0 && s < 0.1 => "less than 0.1".to_owned(),
            s => format!("{s:.1}"),
        };
        write!(
            f,
            "{}: {share} % of the {what} are missing ({missing} of {all})",
            self.name
        )?;
        for (i, CauseCount { cause, count }) in self.causes.iter().enumerate() {
            let before = if i == 0 { ": " } else { ", " };
            write!(f, "{before}{cause} ({count})")?;
        }
        Ok(())
    }
}

/// Something that just happened, for whoever watches a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Progress {
    /// A session has begun.
    Started {
        /// Its folder.
        session: PathBuf,
        /// When it was asked for.
        at: HostTime,
        /// What it will lack, and what mends that.
        #[serde(default)]
        notes: Vec<String>,
    },
    /// Everything with a log time up to `until` is on disk.
    Durable {
        /// Log time.
        until: HostTime,
        /// Messages on disk.
        messages: u64,
    },
    /// Something needs attention, or no longer does.
    Alarm {
        /// What.
        text: String,
        /// Whether it began.
        active: bool,
    },
    /// A session has ended.
    Finished {
        /// Its folder.
        session: PathBuf,
        /// Why.
        reason: String,
        /// Its length, from the first to the last log time, s.
        seconds: f64,
        /// Samples stored, all streams.
        stored: u64,
        /// Samples missing, all streams; each is accounted for in a gap record.
        missing: u64,
        /// Streams of which nothing came at all, so that nobody knows how many samples are missing.
        #[serde(default)]
        absent: Vec<String>,
        /// What each stream came to, cameras first.
        #[serde(default)]
        streams: Vec<StreamAccount>,
        /// What failed, if the session was ended by a failure or a source failed during it.
        error: Option<String>,
    },
}

/// What can be asked of the daemon; one JSON object per line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
pub enum Request {
    /// Start recording.
    Start {
        /// Name of the session.
        #[serde(default)]
        name: String,
    },
    /// Stop and keep the session.
    Stop,
    /// Mark this instant.
    Mark {
        /// What to write beside it.
        #[serde(default)]
        text: String,
        /// When; now, if it is left out.
        #[serde(default)]
        at: Option<HostTime>,
    },
    /// Stop and delete the session.
    Discard,
    /// Delete the last session, while nothing is being recorded.
    DiscardLast,
    /// Tell the state.
    Status,
}

impl Request {
    /// Checks what people wrote in it: the same for everybody who can ask.
    ///
    /// # Errors
    /// A name or a mark is too long, or has characters that are no text.
    pub fn check(&self) -> Result<(), NoteError> {
        match self {
            Self::Start { name } => check_note(name),
            Self::Mark { text, .. } => check_note(text),
            Self::Stop | Self::Discard | Self::DiscardLast | Self::Status => Ok(()),
        }
    }
}

/// The daemon's answer; one JSON object per line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "result", rename_all = "snake_case")]
pub enum Response {
    /// Done; this is the state now.
    Ok {
        /// State.
        status: Box<Status>,
    },
    /// Not done.
    Error {
        /// Why.
        message: String,
    },
}
