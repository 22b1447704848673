//! Report of a stage: a file of its first output.

use scene_bundle::{BundleError, Draft, Scene};
use serde::{Deserialize, Serialize};

/// The file.
const FILE: &str = "report.json";

/// Notes and losses of a stage.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// Assumptions and other facts, a sentence each.
    pub notes: Vec<String>,
    /// Unusable parts of the input, a sentence each.
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
        path: output.file_path(FILE),
        place: format!("line {}", e.line()),
        found: format!("JSON where {e}"),
        expected: "notes and losses of a stage".to_owned(),
    })
}
