//! `paws rig check`.

use std::path::Path;

use anyhow::Result;
use cad_transforms::rig::check::{Facts, Severity, check};

use super::text_of;
use crate::console::Console;
use crate::outcome::Outcome;
use crate::text::count;

/// Prints everything that was found.
pub(super) fn run(file: &Path, facts: &Facts, console: &mut Console<'_>) -> Result<Outcome> {
    let findings = check(&text_of(file)?, facts);
    for finding in &findings {
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
        (0, _) => ("look at the warnings", Outcome::Loss),
        _ => ("not to be used", Outcome::Failed),
    };
    console.line(format!(
        "{}: {verdict}: {}, {}, {}",
        file.display(),
        count(errors, "error"),
        count(warnings, "warning"),
        count(notes, "note")
    ))?;
    Ok(outcome)
}
