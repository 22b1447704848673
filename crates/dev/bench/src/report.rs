//! The report of a benchmark: `NAME.json` with an entry for each part, and its charts.
//!
//! Contract: parts of earlier runs are kept, so that parts can be run separately. A file that is no
//! report is an error and is not replaced.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde_json::{Map, Value};

/// The report of earlier runs; empty if there is none.
///
/// # Errors
/// The file cannot be read, or is no JSON object.
pub(crate) fn read(path: &Path) -> Result<Map<String, Value>> {
    if !path.exists() {
        return Ok(Map::new());
    }
    let text = fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("reading {}", path.display()))
}

/// Writes a report.
///
/// # Errors
/// The file cannot be written.
pub(crate) fn write(path: &Path, report: &Map<String, Value>) -> Result<()> {
    let text = format!("{:#}\n", Value::Object(report.clone()));
    fs::write(path, text).with_context(|| format!("writing {}", path.display()))
}

/// Writes charts by their names.
///
/// # Errors
/// A file cannot be written.
pub(crate) fn write_charts(folder: &Path, charts: Vec<(String, String)>) -> Result<()> {
    for (name, svg) in charts {
        let path = folder.join(name);
        fs::write(&path, svg).with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(())
}
