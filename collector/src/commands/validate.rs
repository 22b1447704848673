//! `paws validate`: decides whether a session is fit for use, and states the reasons.
//!
//! The verdict comes first, then its reasons. PASS ends with exit code 0 and FAIL with 1. WARN ends
//! with 3 if any sample is missing, and with 0 if not: a session without calibration deserves
//! attention, but nothing is lost. Losses within the limits are a PASS.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;

use anyhow::{Context, Result};
use session_archive::handoff::{HandOff, Verdict};
use session_archive::manifest::Manifest;
use session_archive::reader::SessionReader;
use session_archive::storage::DiskStorage;

use crate::commands::calibrate::verify;
use crate::commands::index;
use crate::console::Console;
use crate::decode_check::decode_all;
use crate::limits::Limits;
use crate::outcome::Outcome;
use crate::quality::evaluate;
use crate::report_page;
use crate::scan_session::{SessionScan, scan_session};
use crate::target::Target;
use crate::text;
use crate::validation::{Basis, Validation};
use crate::verdict_change;

/// Options of a validation.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Decode every image, and verify the calibration.
    pub deep: bool,
    /// The limits.
    pub limits: Limits,
    /// Also write the JSON document here.
    pub json: Option<PathBuf>,
    /// Also write the HTML report here.
    pub html: Option<PathBuf>,
}

/// A validated session, with everything that its report needs.
pub struct ValidatedSession {
    /// The session.
    pub reader: SessionReader,
    /// Result of the scan.
    pub found: SessionScan,
    /// The verdict.
    pub validation: Validation,
}

/// Opens the session in a folder.
///
/// # Errors
/// The folder holds no session, or cannot be read.
pub fn open(folder: &Path) -> Result<SessionReader> {
    SessionReader::open(Arc::new(DiskStorage::new(folder)))
        .with_context(|| format!("opening the session: {}", folder.display()))
}

/// Scans and validates the session in a folder. Nothing is written.
///
/// # Errors
/// The session cannot be read, or no decoder is available.
pub fn validate(
    folder: &Path,
    options: &Options,
    console: &Console<'_>,
) -> Result<ValidatedSession> {
    let reader = open(folder)?;
    let context = || format!("validating the session: {}", folder.display());
    let bytes = reader.bytes().with_context(context)?;
    let found = {
        let progress = console.progress("validating", bytes);
        scan_session(&reader, &progress).with_context(context)?
    };
    let decoded = if options.deep {
        let index = index::read_or_build(&reader, console).with_context(context)?;
        let progress = console.progress("decoding", bytes);
        let threads = thread::available_parallelism().map_or(1, usize::from);
        Some(decode_all(&reader, &index, threads, &progress).with_context(context)?)
    } else {
        None
    };
    let manifest = reader.manifest();
    let mut findings = evaluate(manifest, &found, decoded.as_deref(), &options.limits);
    if options.deep {
        // Takes half a minute for an hour's session, in addition to decoding.
        let settings = verify::Options::default();
        let checked = verify::check(&reader, &settings, console).with_context(context)?;
        findings.extend(checked.findings(&options.limits));
    }
    let basis = Basis::of(&reader).with_context(context)?;
    let validation = Validation::new(manifest, basis, &found, findings, options);
    Ok(ValidatedSession {
        reader,
        found,
        validation,
    })
}

/// Validates sessions and prints the results.
///
/// # Errors
/// A session cannot be read, or a report cannot be written.
pub fn run(targets: &[Target], options: &Options, console: &mut Console<'_>) -> Result<Outcome> {
    let mut outcome = Outcome::Fine;
    for target in targets {
        let validated = validate(&target.folder, options, console)?;
        let validation = &validated.validation;
        let before = Validation::read(&target.folder).ok();
        print(validated.reader.manifest(), validation, console)?;
        if target.is_listed() {
            target.keep(validation)?;
            report_changes(before.as_ref(), validation, target, console)?;
        }
        let write = |path: &Path, bytes: &[u8]| {
            std::fs::write(path, bytes)
                .with_context(|| format!("writing the report: {}", path.display()))
        };
        if let Some(path) = &options.json {
            write(path, &validation.to_bytes()?)?;
        }
        if let Some(path) = &options.html {
            write(
                path,
                report_page::html(&validated, &options.limits).as_bytes(),
            )?;
        }
        let checks = text::count(validation.findings.len() as u64, "metric");
        let rest = match validation.reasons.len() {
            0 => format!("all of {checks} within their limits"),
            n => format!("{n} of {checks} beyond their limits"),
        };
        console.line(format!("{}  {}: {rest}", validation.verdict, target.name()))?;
        outcome = outcome.max(outcome_of(validation));
    }
    Ok(outcome)
}

/// Reports changes of the verdict since the last validation and since the hand-off.
///
/// # Errors
/// The output cannot be written.
pub(crate) fn report_changes(
    before: Option<&Validation>,
    now: &Validation,
    target: &Target,
    console: &mut Console<'_>,
) -> Result<()> {
    let change = before.and_then(|before| verdict_change::describe(before, now));
    let handoff = HandOff::read(&DiskStorage::new(&target.folder)).ok();
    let handed =
        handoff.and_then(|h| verdict_change::hand_off_note(&h, now.verdict, &target.name()));
    for line in change.into_iter().chain(handed) {
        console.line(line)?;
    }
    Ok(())
}

/// Outcome of a verdict.
pub fn outcome_of(validation: &Validation) -> Outcome {
    match validation.verdict {
        Verdict::Fail => Outcome::Failed,
        Verdict::Warn if validation.has_loss() => Outcome::Loss,
        _ => Outcome::Fine,
    }
}

/// Prints the verdict and its reasons, then the streams.
fn print(manifest: &Manifest, validation: &Validation, console: &mut Console<'_>) -> Result<()> {
    let summary = &validation.summary;
    let id = &validation.session_id;
    let length = text::duration(summary.end.since(summary.start));
    console.line(format!("{}  session {id}, {length}", validation.verdict))?;
    for finding in crate::quality::reasons(&validation.findings) {
        console.line(format!("  {}  {}", finding.verdict, finding.text))?;
    }
    let width = summary.streams.iter().map(|s| s.name.len()).max();
    let width = width.unwrap_or_default();
    for stream in &summary.streams {
        let camera = manifest.camera(&stream.name);
        let seconds = summary.end.since(summary.start).max(1) as f64 / 1e9;
        let size = camera.map_or(String::new(), |c| {
            let bitrate = charts::si(stream.bytes as f64 * 8.0 / seconds, "bit/s");
            format!("  {}x{} {} {bitrate}", c.width, c.height, c.codec)
        });
        let word = if camera.is_some() { "frame" } else { "sample" };
        console.line(format!(
            "  {:width$}  {:>7} {word}s at {:>7.2} Hz, {} missing{size}",
            stream.name, stream.samples, stream.rate_hz, stream.missing,
        ))?;
    }
    Ok(())
}
