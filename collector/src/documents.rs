//! JSON documents that `--json` prints, with stable fields.
//!
//! Fields are added, never renamed and never given another meaning; [`VERSION`] rises if that has
//! to happen after all. `docs/reference/command-line.md` lists them. Lengths of time are in ns, sizes in
//! bytes, rates in Hz; times of day are RFC 3339 in UTC, with ns since 1970 beside them. Unknown
//! values are `null`.

use std::io;
use std::path::Path;

use console_output::Console;
use serde::Serialize;
use session_archive::handoff::Verdict;
use session_archive::manifest;
use session_archive::time::CivilTime;

use crate::catalogue::Row;
use crate::condition::Condition;
use crate::loss::StreamLoss;
use crate::validation::{EventLine, Loss};

/// Version of all documents.
pub const VERSION: u32 = 1;

/// Prints a document, in one line or, for reading, in several.
///
/// # Errors
/// The reader of the output has closed it.
pub fn print(
    document: &impl Serialize,
    in_one_line: bool,
    console: &mut Console<'_>,
) -> io::Result<()> {
    let text = match in_one_line {
        true => serde_json::to_string(document)?,
        false => serde_json::to_string_pretty(document)?,
    };
    console.line(text)
}

/// A time of day.
#[derive(Clone, Debug, Serialize)]
pub struct Time {
    /// RFC 3339, UTC, to the millisecond.
    pub text: String,
    /// ns since 1970, UTC.
    pub ns: i64,
}

impl From<CivilTime> for Time {
    fn from(time: CivilTime) -> Self {
        Self {
            text: time.to_string(),
            ns: time.0,
        }
    }
}

/// `paws list --json`.
#[derive(Debug, Serialize)]
pub struct List {
    /// `paws-list`.
    pub format: &'static str,
    /// [`VERSION`].
    pub version: u32,
    /// Folder of the library.
    pub library: String,
    /// The sessions, the oldest first.
    pub sessions: Vec<Session>,
}

/// Summary of a session.
#[derive(Debug, Serialize)]
pub struct Session {
    /// Key in the library: the identifier, followed by `.recovered` for a recovered copy and by
    /// `.damaged` for one that was replaced by a better copy.
    pub key: String,
    /// Its identifier.
    pub session_id: String,
    /// Name given by the user; may be empty.
    pub name: String,
    /// Its folder.
    pub folder: String,
    /// Start of the recording, by the recorder's civil clock.
    pub started: Time,
    /// From the first sample to the last, ns.
    pub duration_ns: Option<i64>,
    /// Bytes of the segments.
    pub bytes: u64,
    /// Names of its cameras.
    pub cameras: Vec<String>,
    /// Names of its IMUs.
    pub imus: Vec<String>,
    /// `ok`, `unclosed`, `damaged`, `recovered` or `unverified`.
    pub condition: Condition,
    /// Samples present.
    pub samples: u64,
    /// Samples missing.
    pub missing: u64,
    /// Missing samples of each camera and IMU, by name; empty if the session was not verified.
    pub streams: Vec<StreamLoss>,
    /// `PASS`, `WARN` or `FAIL` of the last validation.
    pub verdict: Option<Verdict>,
    /// Where it was imported from.
    pub source: Option<String>,
    /// When it was imported.
    pub imported: Option<Time>,
}

impl Session {
    /// From a row of the catalogue, whose session is in `folder`.
    pub fn of(row: &Row, folder: &Path) -> Self {
        let names = |text: &str| {
            let names = text.split(',').filter(|name| !name.is_empty());
            names.map(str::to_owned).collect()
        };
        Self {
            key: row.key.clone(),
            session_id: row.session_id.clone(),
            name: row.name.clone(),
            folder: folder.display().to_string(),
            started: row.started_civil.into(),
            duration_ns: (row.duration_ns > 0).then_some(row.duration_ns),
            bytes: row.bytes,
            cameras: names(&row.cameras),
            imus: names(&row.imus),
            condition: row.condition,
            samples: row.samples,
            missing: row.missing,
            streams: StreamLoss::of_folder(folder),
            verdict: row.verdict,
            source: (!row.source.is_empty()).then(|| row.source.clone()),
            imported: row.imported.map(Into::into),
        }
    }
}

/// `paws show --json`.
#[derive(Debug, Serialize)]
pub struct Show {
    /// `paws-show`.
    pub format: &'static str,
    /// [`VERSION`].
    pub version: u32,
    /// Fields as in `list`.
    pub session: Session,
    /// Reason for the end of the recording; `null` if the recorder was cut off.
    pub stopped_by: Option<String>,
    /// Its cameras.
    pub cameras: Vec<Camera>,
    /// Its IMUs.
    pub imus: Vec<Imu>,
    /// Number of segment files.
    pub segments: u64,
    /// Faults of the files, as text.
    pub faults: Vec<String>,
    /// The last validation.
    pub validation: Option<ValidationSummary>,
    /// Whether there is an index that matches the segments.
    pub indexed: bool,
    /// State of the hand-off.
    pub handoff: HandOffState,
}

/// A camera.
#[derive(Debug, Serialize)]
pub struct Camera {
    /// Name.
    pub name: String,
    /// Width of the stereo frame, both eyes, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// `grey` or `yuv420`.
    pub colour: String,
    /// `h264` or `h265`.
    pub codec: String,
    /// Nominal rate, Hz.
    pub rate_hz: f64,
    /// Rate by the last validation, Hz.
    pub measured_hz: Option<f64>,
    /// Bytes of its compressed frames by the last validation.
    pub bytes: Option<u64>,
    /// Cameras with the same trigger expose together.
    pub trigger: Option<String>,
    /// What delivered the frames.
    pub source: String,
    /// What encoded them.
    pub encoder: String,
}

impl Camera {
    /// From a manifest's camera, without measured values.
    pub fn of(camera: &manifest::Camera) -> Self {
        Self {
            name: camera.name.clone(),
            width: camera.width,
            height: camera.height,
            colour: camera.colour.clone(),
            codec: camera.codec.clone(),
            rate_hz: camera.rate_hz,
            measured_hz: None,
            bytes: None,
            trigger: camera.trigger.clone(),
            source: camera.source.clone(),
            encoder: camera.encoder.clone(),
        }
    }
}

/// An IMU.
#[derive(Debug, Serialize)]
pub struct Imu {
    /// Name.
    pub name: String,
    /// Nominal rate, Hz.
    pub rate_hz: f64,
    /// What delivered the samples.
    pub source: String,
}

/// Summary of a validation; `validation.json` in the session's folder has all of it.
#[derive(Debug, Serialize)]
pub struct ValidationSummary {
    /// `PASS`, `WARN` or `FAIL`.
    pub verdict: Verdict,
    /// Whether the session is unchanged since then.
    pub fresh: bool,
    /// Whether every frame was decoded.
    pub deep: bool,
    /// Reasons for the verdict, the worst first.
    pub reasons: Vec<String>,
    /// Samples missing by stream and cause.
    pub losses: Vec<Loss>,
    /// Frame sets.
    pub frame_sets: u64,
    /// Frame sets with a frame of every camera.
    pub complete_sets: u64,
    /// Events, at most 200.
    pub events: Vec<EventLine>,
    /// Events left out.
    pub more_events: u64,
}

/// State of the hand-off.
#[derive(Debug, Serialize)]
pub struct HandOffState {
    /// `none`, `sealed`, or `invalid` where the session has changed since.
    pub state: &'static str,
    /// When it was sealed.
    pub sealed: Option<Time>,
    /// Why it is invalid.
    pub problem: Option<String>,
}

/// One line of `paws import --json`: the result for one session or source.
#[derive(Debug, Default, Serialize)]
pub struct ImportLine {
    /// `paws-import-line`.
    pub format: &'static str,
    /// [`VERSION`].
    pub version: u32,
    /// The folder.
    pub source: String,
    /// `imported`, `resumed` (imported, continuing a stopped import), `already` (in the library
    /// before) or `failed`.
    pub result: &'static str,
    /// Key in the library; `null` if it is not there.
    pub key: Option<String>,
    /// As for `list`.
    pub condition: Option<Condition>,
    /// From the first sample to the last, ns.
    pub duration_ns: Option<i64>,
    /// Bytes of the segments.
    pub bytes: Option<u64>,
    /// Missing samples of each camera and IMU, by name.
    pub streams: Vec<StreamLoss>,
    /// Bytes copied this time.
    pub copied_bytes: u64,
    /// Bytes that a stopped import had copied.
    pub resumed_bytes: u64,
    /// Faults of the files, as text.
    pub faults: Vec<String>,
    /// Entries of the source that were not copied because they are not files.
    pub skipped: Vec<String>,
    /// Why it failed.
    pub error: Option<String>,
}
