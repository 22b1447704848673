//! `validation.json`: the verdict on a session, its basis, and a summary.
//!
//! It contains no current time, so validating the same session with the same limits gives the same
//! bytes. It is derived: it can be deleted and written again at any time. A hand-off does not seal
//! it; it contains the verdict itself.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use session_archive::handoff::Verdict;
use session_archive::layout;
use session_archive::manifest::Manifest;
use session_archive::reader::SessionReader;
use session_archive::record::paws;
use session_archive::storage::{self, DiskStorage};
use session_archive::text::enum_words;
use session_archive::time::HostTime;
use session_archive::verify::Report;
use session_health::{Finding, Limits, number_or_nan, overall, reasons};

use crate::cadence::Cadence;
use crate::scan_session::SessionScan;
use crate::session_stats::{Sample, SessionStats};

const FORMAT: &str = "paws-validation";
const VERSION: u32 = 1;
/// Maximum number of events in a summary; a chattering button must not fill it.
const MAX_EVENTS: usize = 200;

/// State of the session at a validation. If it is unchanged, the segments have not been written
/// since; [`crate::commands::handoff`] detects disk errors in their bytes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Basis {
    /// BLAKE3 of the manifest, hex; empty without a manifest.
    pub manifest_blake3: String,
    /// Number and length of every segment file.
    pub segments: Vec<(u32, u64)>,
}

/// Summary of one numbered stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StreamSummary {
    /// The camera or IMU.
    pub name: String,
    /// Samples present.
    pub samples: u64,
    /// Samples missing, with or without a gap record.
    pub missing: u64,
    /// Measured rate, Hz; `null` in JSON if it is not finite.
    #[serde(deserialize_with = "number_or_nan")]
    pub rate_hz: f64,
    /// Bytes of compressed images; 0 for an IMU.
    pub bytes: u64,
}

/// Samples missing in one stream for one cause.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Loss {
    /// The stream.
    pub stream: String,
    /// Cause, as in `encoder overload`; `no record` without a gap record.
    pub cause: String,
    /// Samples.
    pub samples: u64,
    /// Number of gaps.
    pub gaps: u64,
}

/// An event.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EventLine {
    /// Time, ns after the first sample.
    pub after_ns: i64,
    /// Kind, as in `mark`.
    pub kind: String,
    /// Source of the event.
    pub source: String,
    /// Text.
    pub text: String,
}

/// Summary of a session, to show it without reading it again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Time of the first sample.
    pub start: HostTime,
    /// Time of the last sample.
    pub end: HostTime,
    /// Cameras, then IMUs.
    pub streams: Vec<StreamSummary>,
    /// Frame sets recorded.
    pub frame_sets: u64,
    /// Frame sets with a frame of every camera.
    pub complete_sets: u64,
    /// Losses by stream and cause.
    pub losses: Vec<Loss>,
    /// Events, at most 200.
    pub events: Vec<EventLine>,
    /// Events left out.
    pub more_events: u64,
}

/// The whole document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    format: String,
    version: u32,
    /// Software that validated.
    pub software: String,
    /// The session.
    pub session_id: String,
    /// The verdict.
    pub verdict: Verdict,
    /// Reasons for the verdict, the worst first.
    pub reasons: Vec<String>,
    /// Whether every image was decoded.
    pub deep: bool,
    /// Limits that differ from [`session_health::TABLE`], as `METRIC=WARN,FAIL`.
    #[serde(default)]
    pub limits: Vec<String>,
    /// State of the session that was validated.
    pub basis: Basis,
    /// Summary of the session.
    pub summary: Summary,
    /// Findings of every metric.
    pub findings: Vec<Finding>,
    /// Verification of every byte.
    pub report: Report,
}

impl Basis {
    /// The current state of a session.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn of(reader: &SessionReader) -> io::Result<Self> {
        let storage = reader.storage();
        let manifest = match storage::read_all(&**storage, layout::MANIFEST) {
            Ok(bytes) => blake3::hash(&bytes).to_hex().to_string(),
            Err(e) if e.kind() == io::ErrorKind::NotFound => String::new(),
            Err(e) => return Err(e),
        };
        let mut segments = Vec::new();
        for number in reader.segment_numbers() {
            match storage.open(&layout::segment(number)) {
                Ok(file) => segments.push((number, file.len()?)),
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => return Err(e),
            }
        }
        Ok(Self {
            manifest_blake3: manifest,
            segments,
        })
    }
}

impl Validation {
    /// Assembles a document.
    pub fn new(
        manifest: &Manifest,
        basis: Basis,
        found: &SessionScan,
        findings: Vec<Finding>,
        deep: bool,
        limits: &Limits,
    ) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            software: crate::SOFTWARE.to_owned(),
            session_id: manifest.session_id.clone(),
            verdict: overall(&findings),
            reasons: reasons(&findings).iter().map(|f| f.text.clone()).collect(),
            deep,
            limits: limits.moved(),
            basis,
            summary: Summary::of(manifest, found),
            findings,
            report: found.report.clone(),
        }
    }

    /// The document in a session's folder.
    ///
    /// # Errors
    /// It is missing, or of another version.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(layout::VALIDATION);
        let reading = || format!("reading the validation: {}", path.display());
        let file = Path::new(layout::VALIDATION);
        let text = plain_file::read_below(folder, file, plain_file::DOCUMENT_LIMIT)
            .with_context(reading)?;
        let validation: Self = serde_json::from_slice(&text).with_context(reading)?;
        ensure!(
            validation.format == FORMAT && validation.version == VERSION,
            "{}: found {} version {}, expected {FORMAT} version {VERSION}",
            reading(),
            validation.format,
            validation.version
        );
        Ok(validation)
    }

    /// The document as the bytes of `validation.json`.
    ///
    /// # Errors
    /// Memory is exhausted.
    pub fn to_bytes(&self) -> io::Result<Vec<u8>> {
        let mut text = serde_json::to_vec_pretty(self).map_err(io::Error::other)?;
        text.push(b'\n');
        Ok(text)
    }

    /// Writes the document into a session's folder.
    ///
    /// # Errors
    /// An I/O error occurs.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let storage = DiskStorage::new(folder);
        self.to_bytes()
            .and_then(|text| storage::replace(&storage, layout::VALIDATION, &text))
            .with_context(|| format!("writing the validation: {}", folder.display()))
    }

    /// Whether the session is unchanged since this validation.
    pub fn is_fresh(&self, reader: &SessionReader) -> bool {
        self.session_id == reader.manifest().session_id
            && Basis::of(reader).is_ok_and(|basis| basis == self.basis)
    }

    /// Whether any expected sample is missing.
    pub fn has_loss(&self) -> bool {
        !self.report.is_sound() || self.summary.streams.iter().any(|s| s.missing > 0)
    }
}

impl Summary {
    fn of(manifest: &Manifest, found: &SessionScan) -> Self {
        let (stats, report) = (&found.stats, &found.report);
        let (start, end) = stats.span().unwrap_or_default();
        let stream = |name: &str, cadence: Cadence, bytes: u64| {
            let counted = report.streams.get(name).cloned().unwrap_or_default();
            StreamSummary {
                name: name.to_owned(),
                samples: counted.samples,
                missing: counted.gaps.saturating_add(counted.lost),
                rate_hz: cadence.rate_hz(),
                bytes,
            }
        };
        let cameras = manifest.cameras.iter().zip(&stats.cameras);
        let cameras = cameras.map(|(camera, frames)| {
            let samples: Vec<Sample> = frames.iter().map(|f| f.sample).collect();
            let bytes = frames.iter().map(|f| u64::from(f.bytes)).sum();
            stream(&camera.name, Cadence::of(samples.into_iter()), bytes)
        });
        let imus = manifest.imus.iter().zip(&stats.imus).map(|(imu, stats)| {
            let samples = stats.samples.iter().copied();
            stream(&imu.name, Cadence::of(samples), 0)
        });
        let complete = stats
            .sets
            .iter()
            .filter(|s| s.members.len() == manifest.cameras.len());
        let events = stats.events.iter().take(MAX_EVENTS).map(|(time, event)| {
            let kind = paws::event::Kind::try_from(event.kind).unwrap_or_default();
            EventLine {
                after_ns: time.0.saturating_sub(start),
                kind: enum_words(kind.as_str_name(), "KIND_"),
                source: event.source.clone(),
                text: event.text.clone(),
            }
        });
        Self {
            start: HostTime(start),
            end: HostTime(end),
            streams: cameras.chain(imus).collect(),
            frame_sets: stats.sets.len() as u64,
            complete_sets: complete.count() as u64,
            losses: losses(stats, report),
            events: events.collect(),
            more_events: stats.events.len().saturating_sub(MAX_EVENTS) as u64,
        }
    }
}

fn losses(stats: &SessionStats, report: &Report) -> Vec<Loss> {
    let mut by_cause: BTreeMap<(&str, String), (u64, u64)> = BTreeMap::new();
    let noted = stats.gaps.iter().map(|gap| {
        let cause = paws::gap::Cause::try_from(gap.cause).unwrap_or_default();
        let cause = enum_words(cause.as_str_name(), "CAUSE_");
        (gap.stream.as_str(), cause, gap.count())
    });
    let lost = report.lost.iter().map(|lost| {
        let samples = lost.last.saturating_sub(lost.first).saturating_add(1);
        (lost.stream.as_str(), "no record".to_owned(), samples)
    });
    for (stream, cause, samples) in noted.chain(lost) {
        let sum = by_cause.entry((stream, cause)).or_default();
        *sum = (sum.0.saturating_add(samples), sum.1 + 1);
    }
    let losses = by_cause.into_iter();
    let losses = losses.map(|((stream, cause), (samples, gaps))| Loss {
        stream: stream.to_owned(),
        cause,
        samples,
        gaps,
    });
    losses.collect()
}
