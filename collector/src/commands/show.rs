//! `paws show`: a summary of one session.
//!
//! It reads the files that import and validation have written, never the recording itself, so it is
//! fast. Values that only a validation determines (losses by cause, events) are shown after one.

use std::io;

use anyhow::Result;
use console_output::{Console, Outcome, text};
use session_access::open;
use session_archive::handoff::{Check, HandOff, HandOffError};
use session_archive::index::Index;
use session_archive::reader::SessionReader;
use session_archive::storage::DiskStorage;
use session_archive::text::shown;
use session_archive::verify::Report;

use crate::catalogue::{Row, newest_report};
use crate::condition::Condition;
use crate::documents::{self, Camera, HandOffState, Imu, Session, ValidationSummary};
use crate::import::ImportRecord;
use crate::quality::faults;
use crate::target::Target;
use crate::validation::{Summary, Validation};
use crate::verdict_change;

/// Maximum number of events shown; `paws report` shows more.
const MAX_EVENTS: usize = 12;

/// Shows a session.
///
/// # Errors
/// The session cannot be read.
pub fn run(target: &Target, console: &mut Console<'_>) -> Result<Outcome> {
    let reader = open(&target.folder)?;
    let row = Row::of(&target.name(), &target.folder)?;
    let validation = Validation::read(&target.folder).ok();
    let record = ImportRecord::read(&target.folder);
    let report = newest_report(validation.as_ref(), record.as_ref());
    let mut lines = Lines(console);
    lines.recording(&row, &reader, validation.as_ref())?;
    lines.state(&row, report, validation.as_ref(), &reader)?;
    if let Some(validation) = &validation {
        lines.events(&validation.summary)?;
    }
    if let Some(record) = &record {
        lines.add(
            "imported",
            format!("{} from {}", record.imported, record.source),
        )?;
    }
    let indexed = if Index::read(&reader).is_ok() {
        "yes"
    } else {
        "no"
    };
    lines.add("indexed", indexed)?;
    lines.hand_off(target, validation.as_ref())?;
    lines.add("folder", target.folder.display().to_string())?;
    Ok(Outcome::Fine)
}

/// The lines of the summary: a name and a value.
struct Lines<'a, 'c>(&'a mut Console<'c>);

impl Lines<'_, '_> {
    /// Each value is one line, whatever it contains.
    fn add(&mut self, name: &str, value: impl AsRef<str>) -> io::Result<()> {
        let value = shown(value.as_ref());
        self.0.line(format!("{name:10} {value}"))
    }

    /// What was recorded.
    fn recording(
        &mut self,
        row: &Row,
        reader: &SessionReader,
        validation: Option<&Validation>,
    ) -> io::Result<()> {
        let manifest = reader.manifest();
        self.add("session", &row.key)?;
        if !row.name.is_empty() {
            self.add("name", &row.name)?;
        }
        let length = match row.duration_ns {
            0 => String::new(),
            ns => format!(", {}", text::duration(ns)),
        };
        self.add("recorded", format!("{}{length}", row.started_civil))?;
        if let Some(stop) = &manifest.stopped {
            self.add("stopped by", &stop.reason)?;
        }
        for camera in &manifest.cameras {
            let summary =
                validation.and_then(|v| v.summary.streams.iter().find(|s| s.name == camera.name));
            let measured = summary.map_or(String::new(), |s| {
                format!(", measured {:.2} Hz, {}", s.rate_hz, text::bytes(s.bytes))
            });
            self.add(
                "camera",
                format!(
                    "{}: {}x{} {} {}, {} Hz{measured}; {}",
                    camera.name,
                    camera.width,
                    camera.height,
                    camera.colour,
                    camera.codec,
                    charts::significant(camera.rate_hz),
                    camera.source
                ),
            )?;
        }
        for imu in &manifest.imus {
            let rate = charts::significant(imu.rate_hz);
            self.add("IMU", format!("{}: {rate} Hz; {}", imu.name, imu.source))?;
        }
        let segments = text::count(reader.segment_numbers().count() as u64, "segment");
        self.add("size", format!("{} in {segments}", text::bytes(row.bytes)))
    }

    /// Condition, verdict and losses.
    fn state(
        &mut self,
        row: &Row,
        report: Option<&Report>,
        validation: Option<&Validation>,
        reader: &SessionReader,
    ) -> io::Result<()> {
        self.add("condition", row.condition.to_string())?;
        if let (Condition::Damaged, Some(report)) = (row.condition, report) {
            for fault in faults(report) {
                self.add("", fault)?;
            }
        }
        match validation {
            None => self.add("verdict", "none yet; `paws validate` gives one")?,
            Some(v) => {
                let stale = if v.is_fresh(reader) {
                    ""
                } else {
                    ", of an earlier state"
                };
                let deep = if v.deep { ", every image decoded" } else { "" };
                self.add("verdict", format!("{}{deep}{stale}", v.verdict))?;
                for reason in &v.reasons {
                    self.add("", reason)?;
                }
            }
        }
        let missing = match (report, row.missing) {
            (None, _) => "not known yet".to_owned(),
            (Some(_), 0) => "nothing".to_owned(),
            (Some(_), n) => format!(
                "{} of {}",
                text::count(n, "sample"),
                row.samples.saturating_add(n)
            ),
        };
        self.add("missing", missing)?;
        for loss in validation.iter().flat_map(|v| &v.summary.losses) {
            self.add(
                "",
                format!(
                    "{}: {} in {}, {}",
                    loss.stream,
                    text::count(loss.samples, "sample"),
                    text::count(loss.gaps, "gap"),
                    loss.cause
                ),
            )?;
        }
        Ok(())
    }

    /// Frame sets and events.
    fn events(&mut self, summary: &Summary) -> io::Result<()> {
        let sets = text::count(summary.frame_sets, "frame set");
        self.add(
            "sets",
            format!("{sets}, {} complete", summary.complete_sets),
        )?;
        for (i, event) in summary.events.iter().take(MAX_EVENTS).enumerate() {
            let name = if i == 0 { "events" } else { "" };
            let at = event.after_ns as f64 / 1e9;
            let text = format!(
                "{at:8.2} s  {} by {}  {}",
                event.kind, event.source, event.text
            );
            self.add(name, text.trim_end())?;
        }
        let more = summary.events.len().saturating_sub(MAX_EVENTS) as u64;
        let more = more + summary.more_events;
        if more > 0 {
            self.add("", format!("and {} more", text::count(more, "event")))?;
        }
        Ok(())
    }

    fn hand_off(&mut self, target: &Target, validation: Option<&Validation>) -> io::Result<()> {
        let storage = DiskStorage::new(&target.folder);
        let handed = match HandOff::open(&storage, Check::Lengths, |_| {}) {
            Ok(handoff) => format!("sealed {}, as {}", handoff.sealed, handoff.verdict),
            Err(HandOffError::Missing | HandOffError::Io { .. }) => "no".to_owned(),
            Err(e) => format!("no longer valid: {e}"),
        };
        self.add("handed off", handed)?;
        if let Ok(handoff) = HandOff::read(&storage) {
            let now = validation.map(|v| v.verdict);
            let change =
                now.and_then(|now| verdict_change::hand_off_note(&handoff, now, &target.name()));
            for note in handoff.notes().into_iter().chain(change) {
                self.add("", note)?;
            }
        }
        Ok(())
    }
}

/// Shows a session as one JSON document.
///
/// # Errors
/// The session cannot be read.
pub fn json(target: &Target, console: &mut Console<'_>) -> Result<Outcome> {
    let reader = open(&target.folder)?;
    let manifest = reader.manifest();
    let row = Row::of(&target.name(), &target.folder)?;
    let validation = Validation::read(&target.folder).ok();
    let record = ImportRecord::read(&target.folder);
    let report = newest_report(validation.as_ref(), record.as_ref());
    let cameras = manifest.cameras.iter().map(|camera| {
        let mut streams = validation.iter().flat_map(|v| &v.summary.streams);
        let measured = streams.find(|s| s.name == camera.name);
        Camera {
            measured_hz: measured.map(|s| s.rate_hz),
            bytes: measured.map(|s| s.bytes),
            ..Camera::of(camera)
        }
    });
    let imus = manifest.imus.iter().map(|imu| Imu {
        name: imu.name.clone(),
        rate_hz: imu.rate_hz,
        source: imu.source.clone(),
    });
    let document = documents::Show {
        format: "paws-show",
        version: documents::VERSION,
        session: Session::of(&row, &target.folder),
        stopped_by: manifest.stopped.as_ref().map(|stop| stop.reason.clone()),
        cameras: cameras.collect(),
        imus: imus.collect(),
        segments: reader.segment_numbers().count() as u64,
        faults: report.map(faults).unwrap_or_default(),
        validation: validation.as_ref().map(|v| ValidationSummary {
            verdict: v.verdict,
            fresh: v.is_fresh(&reader),
            deep: v.deep,
            reasons: v.reasons.clone(),
            losses: v.summary.losses.clone(),
            frame_sets: v.summary.frame_sets,
            complete_sets: v.summary.complete_sets,
            events: v.summary.events.clone(),
            more_events: v.summary.more_events,
        }),
        indexed: Index::read(&reader).is_ok(),
        handoff: handed_off(target),
    };
    documents::print(&document, false, console)?;
    Ok(Outcome::Fine)
}

fn handed_off(target: &Target) -> HandOffState {
    let storage = DiskStorage::new(&target.folder);
    let (state, sealed, problem) = match HandOff::open(&storage, Check::Lengths, |_| {}) {
        Ok(handoff) => ("sealed", Some(handoff.sealed.into()), None),
        Err(HandOffError::Missing | HandOffError::Io { .. }) => ("none", None, None),
        Err(e) => ("invalid", None, Some(e.to_string())),
    };
    HandOffState {
        state,
        sealed,
        problem,
    }
}
