//! `paws validate --metrics`: the metrics, their units, and the default limits.
//!
//! Names and numbers are those that `--limit METRIC=WARN,FAIL` takes.

use anyhow::Result;
use console_output::{Console, Outcome};
use serde_json::json;
use session_health::{Limit, TABLE, limit_text};

/// Lists the metrics, as a table or as a JSON array.
///
/// # Errors
/// The output cannot be written.
pub(crate) fn run(as_json: bool, console: &mut Console<'_>) -> Result<Outcome> {
    if as_json {
        let rows: Vec<_> = TABLE.iter().map(row).collect();
        console.line(serde_json::to_string_pretty(&rows)?)?;
        return Ok(Outcome::Fine);
    }
    let head = ["METRIC", "UNIT", "WARN", "FAIL"].map(str::to_owned);
    let columns = |limit: &Limit| {
        [
            limit.metric.to_owned(),
            limit.unit.as_str().to_owned(),
            limit_text(limit.warn),
            limit_text(limit.fail),
        ]
    };
    let rows: Vec<[String; 4]> = TABLE.iter().map(columns).collect();
    let width = |i: usize| {
        let cells = rows.iter().chain([&head]).map(|row| row[i].len());
        cells.max().unwrap_or_default()
    };
    let widths: [usize; 4] = std::array::from_fn(width);
    let line = |row: &[String; 4], meaning: &str| {
        let cells = row
            .iter()
            .zip(widths)
            .map(|(cell, width)| format!("{cell:width$}"));
        format!("{}  {meaning}", cells.collect::<Vec<_>>().join("  "))
    };
    console.line(line(&head, "MEANING"))?;
    for (row, limit) in rows.iter().zip(TABLE) {
        console.line(line(row, &meaning(limit)))?;
    }
    console.line("a value above WARN is a warning, above FAIL a failure; `never`: no limit")?;
    Ok(Outcome::Fine)
}

fn meaning(limit: &Limit) -> String {
    let mut text = limit.title.to_owned();
    if let Some((warn, fail)) = limit.periods {
        let (warn, fail) = (limit_text(warn), limit_text(fail));
        text.push_str(&format!(
            "; at least {warn} and {fail} nominal periods of the stream"
        ));
    }
    if limit.is_deep() {
        text.push_str("; with --deep");
    }
    text
}

fn row(limit: &Limit) -> serde_json::Value {
    let known = |limit: f64| limit.is_finite().then_some(limit);
    json!({
        "metric": limit.metric,
        "meaning": limit.title,
        "unit": limit.unit.as_str(),
        "warn": known(limit.warn),
        "fail": known(limit.fail),
        "warn_periods": limit.periods.and_then(|(warn, _)| known(warn)),
        "fail_periods": limit.periods.and_then(|(_, fail)| known(fail)),
        "deep": limit.is_deep(),
        "source": limit.source,
    })
}
