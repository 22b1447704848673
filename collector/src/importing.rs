//! `paws import`: brings sessions from folders and disks into the library, one after the other.
//!
//! A session that cannot be imported does not keep the others from it. Each session ends with one line;
//! damaged ones are in the library and make the exit code say so.

use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::condition::Condition;
use crate::console::Console;
use crate::find;
use crate::import::{Imported, import, no_hook, size};
use crate::library::Library;
use crate::outcome::Outcome;
use crate::quality::faults;
use crate::text;

/// Imports everything found in `sources` into the library in the folder `root`.
///
/// # Errors
/// The library cannot be used at all.
pub fn run(sources: &[PathBuf], root: &Path, console: &mut Console<'_>) -> Result<Outcome> {
    let mut library = Library::create(root)?;
    let _lock = library.lock_waiting(tell_waiting)?;
    let mut outcome = Outcome::Fine;
    let mut sessions = Vec::new();
    for source in sources {
        let found = find::sessions(source, Some(library.root()));
        for (folder, error) in &found.unreadable {
            eprintln!("paws: looking for sessions: {error}: {}", folder.display());
            outcome = Outcome::Failed;
        }
        if found.sessions.is_empty() && found.unreadable.is_empty() {
            eprintln!("paws: no session here: {}", source.display());
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
                    eprintln!(
                        "paws: not copied, being no files of a session: {}",
                        imported.skipped.join(", ")
                    );
                }
                console.line(summary(&imported))?;
                if imported.condition.needs_recovery() {
                    outcome = outcome.max(Outcome::Loss);
                }
            }
            Err(e) => {
                eprintln!("paws: {:#}", anyhow::Error::from(e));
                console.line(format!("not imported: {}", session.display()))?;
                outcome = Outcome::Failed;
            }
        }
    }
    Ok(outcome)
}

/// Says that another program has to end first.
pub(crate) fn tell_waiting(root: &Path) {
    eprintln!(
        "paws: another paws is changing this library; waiting for it to end: {}",
        root.display()
    );
}

/// One line about a session that is in the library now.
pub(crate) fn summary(imported: &Imported) -> String {
    let Imported { key, report, .. } = imported;
    let start = report.streams.values().filter(|s| s.samples > 0);
    let end = start.clone().map(|s| s.end).max();
    let length = start.map(|s| s.start).min().zip(end);
    let length = length.map_or(0, |(start, end)| end.since(start));
    let done = match imported {
        i if i.already => "imported already",
        i if i.resumed > 0 => "imported (resumed)",
        _ => "imported",
    };
    let mut line = format!(
        "{key}: {done}, {}, {}, {}",
        text::duration(length),
        text::bytes(report.bytes),
        imported.condition
    );
    if imported.condition == Condition::Damaged {
        line.push_str(&format!(" ({})", faults(report).join(", ")));
    }
    if let Some(old) = &imported.replaced {
        line.push_str(&format!(
            "; the one that was there is worse and is kept as {old} (`paws prune --session {old} --yes` removes it)"
        ));
    }
    if imported.condition.needs_recovery() {
        line.push_str(&format!("; `paws recover {key}` makes a sound copy"));
    }
    line
}
