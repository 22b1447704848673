//! JSON documents that `--json` prints, with stable fields.
//!
//! Fields are added, never renamed and never given another meaning; [`VERSION`] rises if that has
//! to happen after all. `docs/reference/command-line.md` lists them. Lengths of time are in ns,
//! sizes in bytes, rates in Hz; times of day are RFC 3339 in UTC, with ns since 1970 beside them.
//! Unknown values are `null`.

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
pub(crate) const VERSION: u32 = 1;

/// Prints a document, in one line or, for reading, in several.
///
/// # Errors
/// The reader of the output has closed it.
pub(crate) fn print(
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
pub(crate) struct Time {
    /// RFC 3339, UTC, to the millisecond.
    pub(crate) text: String,
    /// ns since 1970, UTC.
    pub(crate) ns: i64,
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
pub(crate) struct List {
    /// `paws-list`.
    pub(crate) format: &'static str,
    /// [`VERSION`].
    pub(crate) version: u32,
    /// Folder of the library.
    pub(crate) library: String,
    /// The sessions, the oldest first.
    pub(crate) sessions: Vec<Session>,
}

/// Summary of a session.
#[derive(Debug, Serialize)]
pub(crate) struct Session {
    /// Key in the library: the identifier, followed by `.recovered` for a recovered copy and by
    /// `.damaged` for one that was replaced by a better copy.
    pub(crate) key: String,
    /// Its identifier.
    pub(crate) session_id: String,
    /// Name given by the user; may be empty.
    pub(crate) name: String,
    /// Its folder.
    pub(crate) folder: String,
    /// Start of the recording, by the recorder's civil clock.
    pub(crate) started: Time,
    /// From the first sample to the last, ns.
    pub(crate) duration_ns: Option<i64>,
    /// Bytes of the segments.
    pub(crate) bytes: u64,
    /// Names of its cameras.
    pub(crate) cameras: Vec<String>,
    /// Names of its IMUs.
    pub(crate) imus: Vec<String>,
    /// `ok`, `unclosed`, `damaged`, `recovered` or `unverified`.
    pub(crate) condition: Condition,
    /// Samples present.
    pub(crate) samples: u64,
    /// Samples missing.
    pub(crate) missing: u64,
    /// Missing samples of each camera and IMU, by name; empty if the session was not verified.
    pub(crate) streams: Vec<StreamLoss>,
    /// `PASS`, `WARN` or `FAIL` of the last validation.
    pub(crate) verdict: Option<Verdict>,
    /// Where it was imported from.
    pub(crate) source: Option<String>,
    /// When it was imported.
    pub(crate) imported: Option<Time>,
}

impl Session {
    /// From a row of the catalogue, whose session is in `folder`.
    pub(crate) fn of(row: &Row, folder: &Path) -> Self {
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
pub(crate) struct Show {
    /// `paws-show`.
    pub(crate) format: &'static str,
    /// [`VERSION`].
    pub(crate) version: u32,
    /// Fields as in `list`.
    pub(crate) session: Session,
    /// Reason for the end of the recording; `null` if the recorder was cut off.
    pub(crate) stopped_by: Option<String>,
    /// Its cameras.
    pub(crate) cameras: Vec<Camera>,
    /// Its IMUs.
    pub(crate) imus: Vec<Imu>,
    /// Number of segment files.
    pub(crate) segments: u64,
    /// Faults of the files, as text.
    pub(crate) faults: Vec<String>,
    /// The last validation.
    pub(crate) validation: Option<ValidationSummary>,
    /// Whether there is an index that matches the segments.
    pub(crate) indexed: bool,
    /// State of the hand-off.
    pub(crate) handoff: HandOffState,
}

/// A camera.
#[derive(Debug, Serialize)]
pub(crate) struct Camera {
    /// Name.
    pub(crate) name: String,
    /// Width of the stereo frame, both eyes, pixels.
    pub(crate) width: u32,
    /// Height, pixels.
    pub(crate) height: u32,
    /// `grey` or `yuv420`.
    pub(crate) colour: String,
    /// `h264` or `h265`.
    pub(crate) codec: String,
    /// Nominal rate, Hz.
    pub(crate) rate_hz: f64,
    /// Rate by the last validation, Hz.
    pub(crate) measured_hz: Option<f64>,
    /// Bytes of its compressed frames by the last validation.
    pub(crate) bytes: Option<u64>,
    /// Cameras with the same trigger expose together.
    pub(crate) trigger: Option<String>,
    /// What delivered the frames.
    pub(crate) source: String,
    /// What encoded them.
    pub(crate) encoder: String,
}

impl Camera {
    /// From a manifest's camera, without measured values.
    pub(crate) fn of(camera: &manifest::Camera) -> Self {
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
pub(crate) struct Imu {
    /// Name.
    pub(crate) name: String,
    /// Nominal rate, Hz.
    pub(crate) rate_hz: f64,
    /// What delivered the samples.
    pub(crate) source: String,
}

/// Summary of a validation; `validation.json` in the session's folder has all of it.
#[derive(Debug, Serialize)]
pub(crate) struct ValidationSummary {
    /// `PASS`, `WARN` or `FAIL`.
    pub(crate) verdict: Verdict,
    /// Whether the session is unchanged since then.
    pub(crate) fresh: bool,
    /// Whether every frame was decoded.
    pub(crate) deep: bool,
    /// Reasons for the verdict, the worst first.
    pub(crate) reasons: Vec<String>,
    /// Samples missing by stream and cause.
    pub(crate) losses: Vec<Loss>,
    /// Frame sets.
    pub(crate) frame_sets: u64,
    /// Frame sets with a frame of every camera.
    pub(crate) complete_sets: u64,
    /// Events, at most 200.
    pub(crate) events: Vec<EventLine>,
    /// Events left out.
    pub(crate) more_events: u64,
}

/// State of the hand-off.
#[derive(Debug, Serialize)]
pub(crate) struct HandOffState {
    /// `none`, `sealed`, or `invalid` where the session has changed since.
    pub(crate) state: &'static str,
    /// When it was sealed.
    pub(crate) sealed: Option<Time>,
    /// Why it is invalid.
    pub(crate) problem: Option<String>,
}

/// One line of `paws import --json`: the result for one session or source.
#[derive(Debug, Default, Serialize)]
pub(crate) struct ImportLine {
    /// `paws-import-line`.
    pub(crate) format: &'static str,
    /// [`VERSION`].
    pub(crate) version: u32,
    /// The folder.
    pub(crate) source: String,
    /// `imported`, `resumed` (imported, continuing a stopped import), `already` (in the library
    /// before) or `failed`.
    pub(crate) result: &'static str,
    /// Key in the library; `null` if it is not there.
    pub(crate) key: Option<String>,
    /// As for `list`.
    pub(crate) condition: Option<Condition>,
    /// From the first sample to the last, ns.
    pub(crate) duration_ns: Option<i64>,
    /// Bytes of the segments.
    pub(crate) bytes: Option<u64>,
    /// Missing samples of each camera and IMU, by name.
    pub(crate) streams: Vec<StreamLoss>,
    /// Bytes copied this time.
    pub(crate) copied_bytes: u64,
    /// Bytes that a stopped import had copied.
    pub(crate) resumed_bytes: u64,
    /// Faults of the files, as text.
    pub(crate) faults: Vec<String>,
    /// Entries of the source that were not copied because they are not files.
    pub(crate) skipped: Vec<String>,
    /// Why it failed.
    pub(crate) error: Option<String>,
}
