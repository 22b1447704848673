//! `cargo xtask tidy`: words, names of types, layers, circles, sizes and widths of comments, as
//! counts that may only fall.
//!
//! It reads the text of the files that git lists and builds nothing, so it is the first step of
//! `cargo xtask test`. Each count has a module, [`mod@survey`] collects them, [`ratchet`] compares
//! them with `docs/tidy.txt`. A count that fell is no failure; one that rose is, with the places
//! that it consists of.

mod charts;
mod circles;
mod comments;
mod dependencies;
mod facts;
mod files;
mod layers;
mod manifest;
mod measures;
mod modules;
mod outline;
mod patterns;
mod place;
mod prose;
mod ratchet;
mod report;
mod size;
mod source;
mod strings;
mod survey;
mod test_code;
mod type_names;
mod uses;
mod width;

use std::io::{ErrorKind, Write};
use std::path::Path;

use anyhow::{Context, Result, bail};

use crate::process::root;
use patterns::Patterns;
use ratchet::{Comparison, Measure, Ratchet};
use survey::Survey;

/// What to do with the counts.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Mode {
    /// Compare them with those permitted.
    Check,
    /// Lower those permitted to them.
    Write,
    /// Print the places behind them, of all or of one crate.
    List(Option<String>),
}

/// The words and phrases to drop.
const PATTERNS: &str = "docs/dropped-words.txt";

/// The counts that are permitted.
const COUNTS: &str = "docs/tidy.txt";

/// Does what the mode says. An error where a count is worse than permitted.
pub(crate) fn run(mode: Mode) -> Result<()> {
    let root = root()?;
    let survey = survey(&root)?;
    let measures = measures::measures(&survey);
    match mode {
        Mode::Check | Mode::Write => {
            if mode == Mode::Check {
                print(&report::overview(&survey))?;
            }
            let outcome = compare(&root, &measures, mode == Mode::Write)?;
            print(&outcome.details)?;
            print(&format!("\n{}\n", outcome.conclusion?))
        }
        Mode::List(of) => list(&measures, of.as_deref()),
    }
}

/// The check as a step of `cargo xtask test`; returns the text for its table.
pub(crate) fn check() -> Result<String> {
    let root = root()?;
    let survey = survey(&root)?;
    print(&report::overview(&survey))?;
    let outcome = compare(&root, &measures::measures(&survey), false)?;
    print(&outcome.details)?;
    outcome.conclusion
}

/// How the counts compare with the file.
struct Outcome {
    /// What differs, line by line.
    details: String,
    /// One line that sums up; an error where a count is worse, or is missing and was not just
    /// added.
    conclusion: Result<String>,
}

fn survey(root: &Path) -> Result<Survey> {
    let path = root.join(PATTERNS);
    let reading = || format!("reading the words to drop {}", path.display());
    let text = std::fs::read_to_string(&path).with_context(reading)?;
    let patterns = Patterns::parse(&text).with_context(reading)?;
    survey::survey(&files::read(root)?, &patterns)
}

/// Compares with the file and, with `write`, tightens the file.
fn compare(root: &Path, measures: &[Measure], write: bool) -> Result<Outcome> {
    let path = root.join(COUNTS);
    let reading = || format!("reading the counts permitted {}", path.display());
    let before = match std::fs::read_to_string(&path) {
        Err(error) if error.kind() == ErrorKind::NotFound => String::new(),
        text => text.with_context(reading)?,
    };
    let ratchet = Ratchet::parse(&before).with_context(reading)?;
    let comparison = ratchet.compare(measures);
    if write {
        let after = ratchet.tightened(measures).to_text();
        std::fs::write(&path, after)
            .with_context(|| format!("writing the counts permitted {}", path.display()))?;
    }
    Ok(Outcome {
        details: report::comparison(&comparison),
        conclusion: conclude(&comparison, write),
    })
}

fn conclude(comparison: &Comparison<'_>, written: bool) -> Result<String> {
    let Comparison {
        worse,
        better,
        new,
        unused,
    } = comparison;
    if !worse.is_empty() {
        let keys: Vec<&str> = worse
            .iter()
            .map(|(measure, _)| measure.key.as_str())
            .collect();
        bail!(
            "{} worse than {COUNTS} permits: {}. docs/glossary.md has the words of the field, \
             ARCHITECTURE.md the layers",
            counts(keys.len()),
            keys.join(", ")
        );
    }
    if written {
        return Ok(format!(
            "{COUNTS}: {} lowered, {} new, {} removed.",
            better.len(),
            new.len(),
            unused.len()
        ));
    }
    if !new.is_empty() {
        bail!(
            "{} not in {COUNTS}; `cargo xtask tidy --write` adds what is new",
            counts(new.len())
        );
    }
    Ok(match better.len() + unused.len() {
        0 => "No count rose.".to_owned(),
        number => format!(
            "No count rose; {number} fell, and `cargo xtask tidy --write` lowers them in {COUNTS}."
        ),
    })
}

fn counts(number: usize) -> String {
    match number {
        1 => "1 count is".to_owned(),
        number => format!("{number} counts are"),
    }
}

fn list(measures: &[Measure], of: Option<&str>) -> Result<()> {
    let mut known: Vec<&str> = measures.iter().filter_map(|m| m.of.as_deref()).collect();
    known.sort_unstable();
    known.dedup();
    if let Some(of) = of.filter(|of| !known.contains(of)) {
        bail!("unknown crate {of:?}; known: {}", known.join(", "));
    }
    let places = report::list(measures, of).into_iter();
    print(&places.map(|place| format!("{place}\n")).collect::<String>())
}

/// Prints; a reader that wants no more, as `head` does, is no failure.
fn print(text: &str) -> Result<()> {
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        result => result.context("printing"),
    }
}

#[cfg(test)]
mod tests;
