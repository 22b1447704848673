//! What the server asks of the recorder.
//!
//! Contract of a [`Rig`]: [`Rig::status`], [`Rig::preview`] and [`Rig::is_recording`] answer from what is
//! known and wait for nothing; [`Rig::act`] may take as long as the recorder needs. All are called from the
//! server's own threads, several at once, and must not panic. A panic is caught and answered as an
//! error.

use std::path::PathBuf;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// The recorder, as the server sees it.
pub trait Rig: Send + Sync + 'static {
    /// Everything worth knowing now.
    fn status(&self) -> PageStatus;

    /// Does what the operator asks for; the text of an error is shown on the phone.
    ///
    /// # Errors
    /// The recorder refuses, or could not do it.
    fn act(&self, action: Action) -> Result<(), String>;

    /// The newest small image of the camera with this position in [`PageStatus::cameras`]; none if
    /// there is no such camera or no image yet. It is called only while somebody looks, so images
    /// need not be made at other times.
    fn preview(&self, camera: usize) -> Option<Preview>;

    /// The folder with one folder per session.
    fn sessions_root(&self) -> PathBuf;

    /// Whether the session in the folder with this name is being recorded. True from before the folder
    /// exists until its last byte is on disk: while this is true, nothing of it is served.
    fn is_recording(&self, session: &str) -> bool;
}

/// What an operator can ask for.
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
        /// What to write beside it; may be empty.
        #[serde(default)]
        text: String,
    },
    /// Delete the recording: stop and throw away, or throw the last one away.
    Discard,
}

/// A small image.
#[derive(Clone, Debug)]
pub struct Preview {
    /// A whole JPEG file.
    pub jpeg: Arc<[u8]>,
    /// Differs from image to image; a phone that has this one is not sent it again.
    pub sequence: u64,
}

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

/// One stream.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StreamStatus {
    /// Stream, as gap records name it.
    pub name: String,
    /// Samples per second received in the last second.
    pub rate_hz: f64,
    /// Samples per second that it should deliver, where known.
    pub nominal_hz: Option<f64>,
    /// Samples received since the daemon started.
    pub received: u64,
    /// Samples stored in this session, or the last one.
    pub stored: u64,
    /// Samples missing in this session, or the last one.
    pub missing: u64,
    /// No sample for too long.
    pub silent: bool,
    /// The same image for too long.
    pub frozen: bool,
}

/// The battery.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Battery {
    /// Charge, percent.
    pub percent: f64,
    /// Whether it is being charged.
    pub charging: bool,
    /// Minutes left at the present load, where known.
    pub minutes_left: Option<f64>,
}

/// The machine's civil clock. Recorded time does not depend on it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockStatus {
    /// Whether something keeps it right.
    pub synchronised: bool,
    /// How far it is off by what the source says, ns.
    pub offset_ns: Option<i64>,
    /// What keeps it right, as in `chrony` or `ptp`; empty if nothing does.
    pub source: String,
}

/// Everything worth knowing now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PageStatus {
    /// State.
    pub state: State,
    /// Name of the session's folder while recording; afterwards that of the last session.
    pub session: Option<String>,
    /// Seconds recorded so far, or length of the last session.
    pub seconds: f64,
    /// The cameras of which there are previews, in this order.
    pub cameras: Vec<String>,
    /// The streams.
    pub streams: Vec<StreamStatus>,
    /// Free space where sessions go, bytes.
    pub free_bytes: Option<u64>,
    /// Seconds that can still be recorded at the present rate.
    pub seconds_left: Option<f64>,
    /// Hottest part of the machine, °C.
    pub temperature_c: Option<f64>,
    /// Battery, where readable.
    pub battery: Option<Battery>,
    /// Clock, where known.
    pub clock: Option<ClockStatus>,
    /// What is wrong now, the worst first.
    pub alarms: Vec<String>,
    /// The encoder of each camera.
    pub encoders: Vec<String>,
}

impl PageStatus {
    /// The status of a recorder of which nothing is known but its state.
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
