//! Status of the recorder, for `pawsd status`, a button's light and logs.

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
    /// Ready: a press starts recording immediately.
    Armed,
    /// Recording.
    Recording,
    /// Stop requested; the last frames are in transit.
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
    /// The image has not changed for too long.
    pub frozen: bool,
}

/// Subject of an alarm, for which a person can do something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Concern {
    /// A camera or an IMU is silent, disconnected, frozen or cannot be encoded.
    Stream,
    /// The disk is slow, or little is free.
    Storage,
    /// The battery or the supply is low.
    Battery,
    /// The machine is hot, or is throttled.
    Heat,
}

/// The machine's battery.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BatteryStatus {
    /// Charge left, 0 to 100.
    pub percent: f64,
    /// Whether it is being charged.
    pub charging: bool,
    /// Remaining time at the present load, minutes.
    pub minutes_left: Option<f64>,
}

/// The machine's civil clock; no time in a session comes from it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockStatus {
    /// Civil time of the reading, ns UTC.
    pub civil: i64,
    /// Whether the system reports that its clock follows a reference.
    pub synchronised: bool,
    /// Discipline of the clock, as in `chrony`; empty if unknown.
    pub source: String,
    /// Offset that is still being slewed, ns.
    pub offset_ns: i64,
    /// Error estimated by the system, ns.
    pub error_ns: u64,
    /// Maximum error stated by the system, ns.
    pub max_error_ns: u64,
    /// Step of civil time since the last reading, ns.
    pub step_ns: i64,
}

/// State of the machine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MachineStatus {
    /// Hottest sensor, °C.
    pub temperature_c: Option<f64>,
    /// Whether it is throttled because of heat.
    pub throttled: Option<bool>,
    /// The battery.
    pub battery: Option<BatteryStatus>,
    /// The civil clock.
    pub clock: Option<ClockStatus>,
}

/// Complete status.
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
    /// Active alarms.
    pub alarms: Vec<String>,
    /// Deficiencies of recordings with this configuration, each with a remedy.
    #[serde(default)]
    pub notes: Vec<String>,
    /// Subjects of the alarms.
    #[serde(default)]
    pub concerns: BTreeSet<Concern>,
    /// The encoder of each camera.
    pub encoders: Vec<String>,
    /// State of the machine.
    #[serde(default)]
    pub machine: MachineStatus,
    /// Degradation step in force against overload of the machine; `normal` for none.
    #[serde(default)]
    pub degradation: String,
}

/// Missing samples of one cause.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CauseCount {
    /// The cause, for people.
    pub cause: String,
    /// Number of samples.
    pub count: u64,
}

/// Account of one stream in a session.
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
    /// Missing samples by cause, largest count first.
    pub causes: Vec<CauseCount>,
}

impl StreamAccount {
    /// Fraction of missing samples, 0 to 1.
    pub fn missing_share(&self) -> f64 {
        self.missing as f64 / (self.stored + self.missing).max(1) as f64
    }
}

impl std::fmt::Display for StreamAccount {
    /// Formats as `feet: 12.5 % of the frames are missing (15 of 120): the disk is too slow (15)`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = if self.is_camera { "frames" } else { "samples" };
        let (missing, all) = (self.missing, self.stored + self.missing);
        let share = 100.0 * self.missing_share();
        // One of a million must not be shown as zero.
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

/// An event of a recording, for its observers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Progress {
    /// A session has begun.
    Started {
        /// Its folder.
        session: PathBuf,
        /// Time of the request.
        at: HostTime,
        /// Deficiencies of the session, each with a remedy.
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
    /// A condition that needs attention began or ended.
    Alarm {
        /// The condition.
        text: String,
        /// Whether it began.
        active: bool,
    },
    /// A session has ended.
    Finished {
        /// Its folder.
        session: PathBuf,
        /// Reason.
        reason: String,
        /// Its length, from the first to the last log time, s.
        seconds: f64,
        /// Samples stored, all streams.
        stored: u64,
        /// Samples missing, all streams; each is accounted for in a gap record.
        missing: u64,
        /// Streams without any sample, so that the number of missing samples is unknown.
        #[serde(default)]
        absent: Vec<String>,
        /// Account of each stream, cameras first.
        #[serde(default)]
        streams: Vec<StreamAccount>,
        /// The failure, if the session was ended by one or a source failed during it.
        error: Option<String>,
    },
}

/// Request to the daemon; one JSON object per line.
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
        /// Text of the mark.
        #[serde(default)]
        text: String,
        /// Time; now, if absent.
        #[serde(default)]
        at: Option<HostTime>,
    },
    /// Stop and delete the session.
    Discard,
    /// Delete the last session, while nothing is being recorded.
    DiscardLast,
    /// Return the status.
    Status,
}

impl Request {
    /// Checks texts written by people, with the same rules for all clients.
    ///
    /// # Errors
    /// A name or a mark is too long, or contains characters that are no text.
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
    /// Done; this is the status now.
    Ok {
        /// State.
        status: Box<Status>,
    },
    /// Not done.
    Error {
        /// Reason.
        message: String,
    },
}
