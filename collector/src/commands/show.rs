//! `paws show`: a summary of one session.
//!
//! It reads the files that import and validation have written, never the recording itself, so it is
//! fast. Values that only a validation determines (losses by cause, events) are shown after one.

use anyhow::Result;
use console_output::{Console, Outcome, text};
use session_access::open;
use session_archive::handoff::{Check, HandOff, HandOffError};
use session_archive::index::Index;
use session_archive::storage::DiskStorage;
use session_archive::text::shown;

use crate::catalogue::{Row, newest_report};
use crate::condition::Condition;
use crate::documents::{self, Camera, HandOffState, Imu, Session, ValidationSummary};
use crate::import::ImportRecord;
use crate::quality::faults;
use crate::target::Target;
use crate::validation::Validation;
use crate::verdict_change;

/// Maximum number of events shown; `paws report` shows more.
const MAX_EVENTS: usize = 12;

/// Shows a session.
///
/// # Errors
/// The session cannot be read.
pub fn run(target: &Target, console: &mut Console<'_>) -> Result<Outcome> {
    let reader = open(&target.folder)?;
    let manifest = reader.manifest();
    let row = Row::of(&target.name(), &target.folder)?;
    let validation = Validation::read(&target.folder).ok();
    let record = ImportRecord::read(&target.folder);
    // Each value is one line, whatever it contains.
    let mut line = |name: &str, value: String| console.line(format!("{name:10} {}", shown(&value)));

    line("session", row.key.clone())?;
    if !row.name.is_empty() {
        line("name", row.name.clone())?;
    }
    let length = match row.duration_ns {
        0 => String::new(),
        ns => format!(", {}", text::duration(ns)),
    };
    line("recorded", format!("{}{length}", row.started_civil))?;
    if let Some(stop) = &manifest.stopped {
        line("stopped by", stop.reason.clone())?;
    }
    for camera in &manifest.cameras {
        let summary = validation.as_ref();
        let summary =
            summary.and_then(|v| v.summary.streams.iter().find(|s| s.name == camera.name));
        let measured = summary.map_or(String::new(), |s| {
            format!(", measured {:.2} Hz, {}", s.rate_hz, text::bytes(s.bytes))
        });
        line(
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
        line("IMU", format!("{}: {rate} Hz; {}", imu.name, imu.source))?;
    }
    let segments = text::count(reader.segment_numbers().count() as u64, "segment");
    line("size", format!("{} in {segments}", text::bytes(row.bytes)))?;
    line("condition", row.condition.to_string())?;
    let report = newest_report(validation.as_ref(), record.as_ref());
    if let (Condition::Damaged, Some(report)) = (row.condition, report) {
        for fault in faults(report) {
            line("", fault)?;
        }
    }
    match &validation {
        None => line("verdict", "none yet; `paws validate` gives one".to_owned())?,
        Some(v) => {
            let stale = if v.is_fresh(&reader) {
                ""
            } else {
                ", of an earlier state"
            };
            let deep = if v.deep { ", every image decoded" } else { "" };
            line("verdict", format!("{}{deep}{stale}", v.verdict))?;
            for reason in &v.reasons {
                line("", reason.clone())?;
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
    line("missing", missing)?;
    if let Some(v) = &validation {
        for loss in &v.summary.losses {
            line(
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
        let sets = text::count(v.summary.frame_sets, "frame set");
        line(
            "sets",
            format!("{sets}, {} complete", v.summary.complete_sets),
        )?;
        for (i, event) in v.summary.events.iter().take(MAX_EVENTS).enumerate() {
            let name = if i == 0 { "events" } else { "" };
            let at = event.after_ns as f64 / 1e9;
            let text = format!(
                "{at:8.2} s  {} by {}  {}",
                event.kind, event.source, event.text
            );
            line(name, text.trim_end().to_owned())?;
        }
        let more = v.summary.events.len().saturating_sub(MAX_EVENTS) as u64;
        let more = more + v.summary.more_events;
        if more > 0 {
            line("", format!("and {} more", text::count(more, "event")))?;
        }
    }
    if let Some(record) = &record {
        line(
            "imported",
            format!("{} from {}", record.imported, record.source),
        )?;
    }
    let indexed = if Index::read(&reader).is_ok() {
        "yes"
    } else {
        "no"
    };
    line("indexed", indexed.to_owned())?;
    let storage = DiskStorage::new(&target.folder);
    let handed = match HandOff::open(&storage, Check::Lengths, |_| {}) {
        Ok(handoff) => format!("sealed {}, as {}", handoff.sealed, handoff.verdict),
        Err(HandOffError::Missing | HandOffError::Io { .. }) => "no".to_owned(),
        Err(e) => format!("no longer valid: {e}"),
    };
    line("handed off", handed)?;
    if let Ok(handoff) = HandOff::read(&storage) {
        let now = validation.as_ref().map(|v| v.verdict);
        let change =
            now.and_then(|now| verdict_change::hand_off_note(&handoff, now, &target.name()));
        for note in handoff.notes().into_iter().chain(change) {
            line("", note)?;
        }
    }
    line("folder", target.folder.display().to_string())?;
    Ok(Outcome::Fine)
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
