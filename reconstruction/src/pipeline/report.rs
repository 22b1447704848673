//! What a stage has to say: a file of its first output.

use scene_bundle::{BundleError, Draft, Scene};
use serde::{Deserialize, Serialize};

/// The file.
const FILE: &str = "report.json";

/// What a stage has to say.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// What was assumed, or is worth knowing; a sentence each.
    pub notes: Vec<String>,
    /// What of the input could not be used; a sentence each.
    pub losses: Vec<String>,
}

pub(super) fn write(draft: &Draft, report: &Report) -> Result<(), BundleError> {
    let mut text = serde_json::to_vec_pretty(report).unwrap_or_default();
    text.push(b'\n');
    draft.write(FILE, &text)
}

/// The report of an output; an empty one where it has none.
pub(super) fn read(scene: &Scene, output: &str) -> Result<Report, BundleError> {
    let output = scene.output(output)?;
    if !output.paths().any(|path| path == FILE) {
        return Ok(Report::default());
    }
    serde_json::from_slice(&output.read(FILE)?).map_err(|e| BundleError::Malformed {
        path: output.place(FILE),
        place: format!("line {}", e.line()),
        found: format!("JSON where {e}"),
        expected: "notes and losses of a stage".to_owned(),
    })
}
