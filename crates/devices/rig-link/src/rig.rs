//! Interface of the server to the recorder.
//!
//! Contract of a [`Rig`]: [`Rig::status`], [`Rig::preview`] and [`Rig::is_recording`] return cached
//! values and never block; [`Rig::act`] may block until the recorder has finished. All are called
//! from the server's own threads, concurrently, and must not panic. A panic is caught and becomes
//! an error response.

use std::path::PathBuf;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// The recorder, as used by the server.
pub trait Rig: Send + Sync + 'static {
    /// Current status.
    fn status(&self) -> PageStatus;

    /// Executes an operator's action; the text of an error is shown on the phone.
    ///
    /// # Errors
    /// The recorder rejects the action, or it failed.
    fn act(&self, action: Action) -> Result<(), String>;

    /// The newest preview of the camera with this position in [`PageStatus::cameras`]; `None` if
    /// there is no such camera or no image yet. It is called only while a page is open, so previews
    /// need not be computed at other times.
    fn preview(&self, camera: usize) -> Option<Preview>;

    /// The folder with one folder per session.
    fn sessions_root(&self) -> PathBuf;

    /// Whether the session in the folder with this name is being recorded. True from before the
    /// folder exists until its last byte is synced; meanwhile nothing of it is served.
    fn is_recording(&self, session: &str) -> bool;
}

/// Actions of an operator.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
pub enum Action {
    /// Start recording.
    Start {
        /// Name of the session; may be empty.
        #[serde(default)]
        name: String,
    },
    /// Stop and keep the session.
    Stop,
    /// Mark this instant.
    Mark {
        /// Text of the mark; may be empty.
        #[serde(default)]
        text: String,
    },
    /// Delete the recording: stop and discard it, or discard the last one.
    Discard,
}

/// A preview image.
#[derive(Clone, Debug)]
pub struct Preview {
    /// A complete JPEG file.
    pub jpeg: Arc<[u8]>,
    /// Sequence number of the image; a phone that has this one does not receive it again.
    pub sequence: u64,
}

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
    /// Stop requested; the last frames are being written.
    Stopping,
    /// Cannot record, see the alarms.
    Fault,
}

/// One stream.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StreamStatus {
    /// Name of the stream, as in gap records.
    pub name: String,
    /// Samples per second received in the last second.
    pub rate_hz: f64,
    /// Nominal samples per second, if known.
    pub nominal_hz: Option<f64>,
    /// Samples received since the daemon started.
    pub received: u64,
    /// Samples stored in this session, or the last one.
    pub stored: u64,
    /// Samples missing in this session, or the last one.
    pub missing: u64,
    /// No sample for too long.
    pub silent: bool,
    /// The image is frozen.
    pub frozen: bool,
}

/// The battery.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Battery {
    /// Charge, percent.
    pub percent: f64,
    /// Whether it is being charged.
    pub charging: bool,
    /// Minutes left at the present load, if known.
    pub minutes_left: Option<f64>,
}

/// The machine's civil clock. Recorded time does not depend on it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockStatus {
    /// Whether it is synchronized.
    pub synchronised: bool,
    /// Clock offset reported by the source, ns.
    pub offset_ns: Option<i64>,
    /// Time source, as in `chrony` or `ptp`; empty if there is none.
    pub source: String,
}

/// Current status.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PageStatus {
    /// State.
    pub state: State,
    /// Name of the session's folder while recording; afterwards that of the last session.
    pub session: Option<String>,
    /// Seconds recorded so far, or length of the last session.
    pub seconds: f64,
    /// The cameras with previews, in this order.
    pub cameras: Vec<String>,
    /// The streams.
    pub streams: Vec<StreamStatus>,
    /// Free space for sessions, bytes.
    pub free_bytes: Option<u64>,
    /// Remaining recording time at the present rate, s.
    pub seconds_left: Option<f64>,
    /// Highest temperature of the machine, °C.
    pub temperature_c: Option<f64>,
    /// Battery, if readable.
    pub battery: Option<Battery>,
    /// Clock, if known.
    pub clock: Option<ClockStatus>,
    /// Active alarms, the worst first.
    pub alarms: Vec<String>,
    /// The encoder of each camera.
    pub encoders: Vec<String>,
}

impl PageStatus {
    /// A status with only the state known.
    pub fn new(state: State) -> Self {
        Self {
            state,
            session: None,
            seconds: 0.0,
            cameras: Vec::new(),
            streams: Vec::new(),
            free_bytes: None,
            seconds_left: None,
            temperature_c: None,
            battery: None,
            clock: None,
            alarms: Vec::new(),
            encoders: Vec::new(),
        }
    }
}
