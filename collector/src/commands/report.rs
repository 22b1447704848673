//! `paws report`: the HTML report of a session, in its folder or in a given file.

use std::path::Path;

use anyhow::{Context, Result};
use console_output::{Console, Outcome};
use session_access::open;

use crate::commands::validate::{Options, outcome_of, report_changes, validate};
use crate::derived_files::REPORT;
use crate::report_page;
use crate::target::Target;
use crate::validation::Validation;

/// Validates a session and writes its report. A stored validation that is still valid and as deep
/// is reported, whatever its limits; else the new one is stored in the library as by `paws
/// validate`.
///
/// # Errors
/// The session cannot be read, or the report cannot be written.
pub fn run(
    target: &Target,
    options: &Options,
    out: Option<&Path>,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let path = match out {
        Some(out) => out.to_owned(),
        None => target.derived(REPORT, "--out names another path")?,
    };
    let before = Validation::read(&target.folder).ok();
    let known = before.clone().filter(|known| {
        known.deep >= options.deep
            && open(&target.folder).is_ok_and(|reader| known.is_fresh(&reader))
    });
    let mut options = options.clone();
    for limit in known.iter().flat_map(|known| &known.limits) {
        options.limits.set(limit)?;
    }
    let mut validated = validate(&target.folder, &options, console)?;
    match known {
        // Verification of every byte may find damage that lengths do not show.
        Some(known) if known.report == validated.validation.report => {
            validated.validation = known;
        }
        _ if target.is_listed() => {
            target.keep(&validated.validation)?;
            report_changes(before.as_ref(), &validated.validation, target, console)?;
        }
        _ => {}
    }
    std::fs::write(&path, report_page::html(&validated, &options.limits))
        .with_context(|| format!("writing the report: {}", path.display()))?;
    console.line(path.display())?;
    Ok(outcome_of(&validated.validation))
}
