//! `paws import`: brings sessions from folders and disks into the library, one after the other.
//!
//! If one session cannot be imported, the others still are. Each session gives one line; damaged
//! ones are imported and change the exit code.

use std::path::{Path, PathBuf};

use anyhow::Result;
use command_line::complain;
use console_output::{Console, Outcome, text};
use session_access::mcap_note;
use session_archive::verify::Report;

use crate::condition::Condition;
use crate::documents::{self, ImportLine};
use crate::import::{ImportResult, import, no_hook, size};
use crate::library::Library;
use crate::loss::StreamLoss;
use crate::quality::faults;
use crate::session_search::{self, SearchResult};

/// `format` of a line of JSON.
const LINE: &str = "paws-import-line";

/// Imports all sessions found in `sources` into the library in the folder `root`.
///
/// # Errors
/// The library cannot be used at all.
pub fn run(sources: &[PathBuf], root: &Path, console: &mut Console<'_>) -> Result<Outcome> {
    run_as(sources, root, false, console)
}

/// As [`run`]; with `json` each session gives one line of JSON.
///
/// # Errors
/// The library cannot be used at all.
pub fn run_as(
    sources: &[PathBuf],
    root: &Path,
    json: bool,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let mut library = Library::create(root)?;
    let _lock = library.lock_waiting(report_waiting)?;
    let mut outcome = Outcome::Fine;
    let mut sessions = Vec::new();
    for source in sources {
        let note = source.is_file().then(|| mcap_note(source)).flatten();
        let found = match &note {
            Some(_) => SearchResult::default(),
            None => session_search::sessions(source, Some(library.root())),
        };
        for (folder, error) in &found.unreadable {
            let why = format!("looking for sessions: {error}: {}", folder.display());
            complain!("paws: {why}");
            if json {
                documents::print(&not_imported(folder, why), true, console)?;
            }
            outcome = Outcome::Failed;
        }
        if found.sessions.is_empty() && found.unreadable.is_empty() {
            let what = note.or_else(|| mcap_note(source));
            let what = what.unwrap_or_else(|| source.display().to_string());
            let why = format!("no session here: {what}");
            complain!("paws: {why}");
            if json {
                documents::print(&not_imported(source, why), true, console)?;
            }
            outcome = Outcome::Failed;
        }
        sessions.extend(found.sessions);
    }
    sessions.sort();
    sessions.dedup();
    for (i, session) in sessions.iter().enumerate() {
        let result = size(session).and_then(|bytes| {
            let label = match sessions.len() {
                1 => "importing".to_owned(),
                n => format!("importing {} of {n}", i + 1),
            };
            let progress = console.progress(&label, bytes);
            import(&mut library, session, console.clock, &progress, &no_hook)
        });
        match result {
            Ok(imported) => {
                if !imported.skipped.is_empty() {
                    complain!(
                        "paws: not copied, being no files of a session: {}",
                        imported.skipped.join(", ")
                    );
                }
                match json {
                    true => documents::print(&document(session, &imported), true, console)?,
                    false => console.line(summary(&imported))?,
                }
                if imported.condition.needs_recovery() {
                    outcome = outcome.max(Outcome::Loss);
                }
            }
            Err(e) => {
                let why = format!("{:#}", anyhow::Error::from(e));
                complain!("paws: {why}");
                match json {
                    true => documents::print(&not_imported(session, why), true, console)?,
                    false => console.line(format!("not imported: {}", session.display()))?,
                }
                outcome = Outcome::Failed;
            }
        }
    }
    Ok(outcome)
}

/// Reports that the command waits for another program.
pub(crate) fn report_waiting(root: &Path) {
    complain!(
        "paws: another paws is changing this library; waiting for it to end: {}",
        root.display()
    );
}

/// Duration from the first sample to the last, ns; `None` without samples.
fn length(report: &Report) -> Option<i64> {
    let start = report.streams.values().filter(|s| s.samples > 0);
    let end = start.clone().map(|s| s.end).max();
    let length = start.map(|s| s.start).min().zip(end);
    length.map(|(start, end)| end.since(start))
}

/// The JSON line of an imported session.
fn document(source: &Path, imported: &ImportResult) -> ImportLine {
    ImportLine {
        format: LINE,
        version: documents::VERSION,
        source: source.display().to_string(),
        result: match imported {
            i if i.already_imported => "already",
            i if i.resumed > 0 => "resumed",
            _ => "imported",
        },
        key: Some(imported.key.clone()),
        condition: Some(imported.condition),
        duration_ns: length(&imported.report),
        bytes: Some(imported.report.bytes),
        streams: StreamLoss::of(&imported.report),
        copied_bytes: imported.copied,
        resumed_bytes: imported.resumed,
        faults: faults(&imported.report),
        skipped: imported.skipped.clone(),
        error: None,
    }
}

fn not_imported(source: &Path, why: String) -> ImportLine {
    ImportLine {
        format: LINE,
        version: documents::VERSION,
        source: source.display().to_string(),
        result: "failed",
        error: Some(why),
        ..ImportLine::default()
    }
}

/// Fraction of missing frames of each camera with losses, as `; feet: 5 % of the frames missing`.
fn losses(report: &Report) -> String {
    let streams = StreamLoss::of(report).into_iter();
    let lost = streams.filter(|s| s.is_camera() && s.missing > 0);
    lost.map(|s| {
        let share = text::percent(s.missing, s.expected);
        format!("; {}: {share} of the frames missing", s.name)
    })
    .collect()
}

/// One line of text about an imported session.
pub(crate) fn summary(imported: &ImportResult) -> String {
    let ImportResult { key, report, .. } = imported;
    let length = length(report).unwrap_or(0);
    let done = match imported {
        i if i.already_imported => "imported already",
        i if i.resumed > 0 => "imported (resumed)",
        _ => "imported",
    };
    let mut line = format!(
        "{key}: {done}, {}, {}, {}",
        text::duration(length),
        text::bytes(report.bytes),
        imported.condition
    );
    line.push_str(&losses(report));
    if imported.condition == Condition::Damaged {
        line.push_str(&format!(" ({})", faults(report).join(", ")));
    }
    if let Some(old) = &imported.replaced {
        line.push_str(&format!(
            "; the worse copy in the library was renamed to {old} (`paws prune --session {old} --yes` removes it)"
        ));
    }
    if imported.condition.needs_recovery() {
        line.push_str(&format!("; `paws recover {key}` makes an undamaged copy"));
    }
    line
}
