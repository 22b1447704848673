//! The report of a benchmark: `NAME.json` with an entry for each part, and its charts.
//!
//! Contract: parts of earlier runs are kept, so that parts can be run separately. A file that is no
//! report is an error and is not replaced.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use charts::Chart;
use serde_json::{Map, Value};

use crate::stamp;

/// Size of a chart, px.
const WIDTH: u32 = 760;
const HEIGHT: u32 = 420;

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

/// Names and texts of charts, each of a part of a report, from which its footnote is.
pub(crate) fn to_svg(drawn: Vec<(&str, Chart, &Value)>) -> Vec<(String, String)> {
    let svg = |(name, chart, part): (&str, Chart, &Value)| {
        let chart = chart.footnote(&stamp::source(&part["stamp"]));
        (name.to_owned(), chart.to_svg(WIDTH, HEIGHT))
    };
    drawn.into_iter().map(svg).collect()
}

/// Entries of an array; none of anything else.
pub(crate) fn rows(found: &Value) -> &[Value] {
    found.as_array().map_or(&[], Vec::as_slice)
}

/// A number; not-a-number for anything else.
pub(crate) fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
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
