//! `paws report`: the HTML report of a session, in its folder or in a file of one's choice.

use std::path::Path;

use anyhow::{Context, Result};

use crate::console::Console;
use crate::outcome::Outcome;
use crate::page;
use crate::target::Target;
use crate::validate::{Options, outcome_of, validate};
use crate::validation::{REPORT, Validation};

/// Examines a session and writes its report. The verdict goes into the library as after
/// `paws validate`, unless a fresh one is there that looked deeper.
///
/// # Errors
/// The session cannot be read, or the report cannot be written.
pub fn run(
    target: &Target,
    options: &Options,
    out: Option<&Path>,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let mut validated = validate(&target.folder, options, console)?;
    match Validation::read(&target.folder) {
        Ok(deeper) if deeper.deep && !options.deep && deeper.is_fresh(&validated.reader) => {
            validated.validation = deeper;
        }
        _ if target.is_listed() => {
            validated.validation.write(&target.folder)?;
            target.refresh()?;
        }
        _ => {}
    }
    let path = out.map_or_else(|| target.folder.join(REPORT), Path::to_owned);
    std::fs::write(&path, page::html(&validated, &options.limits))
        .with_context(|| format!("writing the report: {}", path.display()))?;
    console.line(path.display())?;
    Ok(outcome_of(&validated.validation))
}
