//! Time and memory of the stages of a bundle, stored beside its outputs.
//!
//! Contract: `stage_timings.jsonl` in the bundle's folder has a line for each stage, from the last
//! time that it ran. It describes the machine and not the bundle: nothing depends on it, no hash
//! covers it, and a bundle is valid without it.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Outcome, State};

/// The file.
pub const FILE: &str = scene_bundle::layout::STAGE_TIMINGS;

/// Time and memory of a stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageTiming {
    /// Its name.
    pub stage: String,
    /// s.
    pub seconds: f64,
    /// Peak memory, bytes, if known.
    pub peak_bytes: Option<u64>,
}

/// Adds the stages that ran to the file of the bundle in `folder`.
///
/// # Errors
/// The file cannot be read or written.
pub fn write(folder: &Path, outcomes: &[Outcome]) -> io::Result<()> {
    let mut lines: BTreeMap<String, String> = lines(folder)?
        .into_iter()
        .map(|(made, line)| (made.stage, line))
        .collect();
    let made = outcomes.iter().filter(|o| o.state == State::Ran);
    for outcome in made {
        let line = serde_json::to_string(outcome)?;
        lines.insert(outcome.stage.to_owned(), line);
    }
    let text: String = lines.values().map(|line| format!("{line}\n")).collect();
    std::fs::write(folder.join(FILE), text)
}

/// Time and memory of the stages, as far as they are known.
///
/// # Errors
/// The file cannot be read.
pub fn read(folder: &Path) -> io::Result<Vec<StageTiming>> {
    Ok(lines(folder)?.into_iter().map(|(made, _)| made).collect())
}

/// Malformed lines are skipped: a run may have been killed while it wrote.
fn lines(folder: &Path) -> io::Result<Vec<(StageTiming, String)>> {
    let text = match plain_file::read_to_string(&folder.join(FILE), plain_file::DOCUMENT_LIMIT) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
        Err(error) => return Err(error),
    };
    let of = |line: &str| {
        let value: Value = serde_json::from_str(line).ok()?;
        Some((serde_json::from_value(value).ok()?, line.to_owned()))
    };
    Ok(text.lines().filter_map(of).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::Report;

    fn outcome(stage: &'static str, state: State, seconds: f64) -> Outcome {
        Outcome {
            stage,
            state,
            outputs: BTreeMap::new(),
            report: Report::default(),
            seconds,
            peak_bytes: Some(7),
        }
    }

    #[test]
    fn the_last_run_counts_and_stages_that_did_not_run_keep_their_line() {
        let folder = tempfile::tempdir().expect("folder");
        assert_eq!(read(folder.path()).expect("no file"), []);
        let both = [
            outcome("rig", State::Ran, 1.0),
            outcome("depth", State::Ran, 2.0),
        ];
        write(folder.path(), &both).expect("written");
        let path = folder.path().join(FILE);
        let torn = std::fs::read_to_string(&path).expect("a file") + "{\"stage\":";
        std::fs::write(&path, torn).expect("a file");
        let later = [
            outcome("rig", State::UpToDate, 0.0),
            outcome("depth", State::Ran, 3.0),
        ];
        write(folder.path(), &later).expect("written");
        let mut made: Vec<(String, f64)> = read(folder.path())
            .expect("a file")
            .into_iter()
            .map(|m| (m.stage, m.seconds))
            .collect();
        made.sort_by(|a, b| a.0.cmp(&b.0));
        assert_eq!(made, [("depth".to_owned(), 3.0), ("rig".to_owned(), 1.0)]);
    }
}
