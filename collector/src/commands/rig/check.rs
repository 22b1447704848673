//! `paws rig check`.

use std::path::Path;

use anyhow::Result;
use cad_transforms::rig::check::{Facts, Finding, Severity, check};
use console_output::text::count;
use console_output::{Console, Outcome};
use serde::Serialize;

use super::text_file::text_of;
use crate::documents;

/// `paws rig check --json`.
#[derive(Serialize)]
struct Document<'a> {
    format: &'static str,
    version: u32,
    file: String,
    errors: u64,
    warnings: u64,
    notes: u64,
    findings: Vec<FindingDocument<'a>>,
}

#[derive(Serialize)]
struct FindingDocument<'a> {
    level: &'static str,
    line: Option<usize>,
    message: &'a str,
}

impl<'a> From<&'a Finding> for FindingDocument<'a> {
    fn from(finding: &'a Finding) -> Self {
        Self {
            level: match finding.severity {
                Severity::Note => "note",
                Severity::Warning => "warning",
                Severity::Error => "error",
            },
            line: (finding.line > 0).then_some(finding.line),
            message: &finding.message,
        }
    }
}

/// Prints all findings, as lines or as one JSON document.
pub(super) fn run(
    file: &Path,
    facts: &Facts,
    json: bool,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let findings = check(&text_of(file)?, facts);
    for finding in findings.iter().filter(|_| !json) {
        console.line(finding)?;
    }
    let of = |severity| findings.iter().filter(|f| f.severity == severity).count() as u64;
    let (errors, warnings, notes) = (
        of(Severity::Error),
        of(Severity::Warning),
        of(Severity::Note),
    );
    let (verdict, outcome) = match (errors, warnings) {
        (0, 0) => ("good", Outcome::Fine),
        (0, _) => ("see the warnings", Outcome::Loss),
        _ => ("not to be used", Outcome::Failed),
    };
    if json {
        let document = Document {
            format: "paws-rig-check",
            version: documents::VERSION,
            file: file.display().to_string(),
            errors,
            warnings,
            notes,
            findings: findings.iter().map(FindingDocument::from).collect(),
        };
        documents::print(&document, false, console)?;
        return Ok(outcome);
    }
    console.line(format!(
        "{}: {verdict}: {}, {}, {}",
        file.display(),
        count(errors, "error"),
        count(warnings, "warning"),
        count(notes, "note")
    ))?;
    Ok(outcome)
}
