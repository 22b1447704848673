//! `paws validate`: decides whether a session is fit for use, and states the reasons.
//!
//! The verdict comes first, then its reasons. PASS ends with exit code 0 and FAIL with 1. WARN ends
//! with 3 if any sample is missing, and with 0 if not: a session without calibration deserves
//! attention, but nothing is lost. Losses within the limits are a PASS.

use std::path::Path;

use anyhow::{Context, Result};
use console_output::{Console, Outcome, text};
use session_archive::handoff::{HandOff, Verdict};
use session_archive::manifest::Manifest;
use session_archive::storage::DiskStorage;
use session_health::reasons;

use crate::report_page;
use crate::target::Target;
use crate::validation::Validation;
use crate::verdict_change;

pub use crate::session_validation::{Options, ValidatedSession, validate};

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
    for finding in reasons(&validation.findings) {
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
