//! `paws list`: the sessions of the library, one line each, the oldest first.

use std::path::Path;

use anyhow::Result;
use console_output::{Console, Outcome, text};
use session_archive::text::shown;

use crate::catalogue::Row;
use crate::documents::{self, List, Session};
use crate::library::Library;
use crate::loss::StreamLoss;

/// Lists the sessions of the library in the folder `root`.
///
/// # Errors
/// There is no library, or it cannot be read.
pub fn run(root: &Path, console: &mut Console<'_>) -> Result<Outcome> {
    let library = Library::open(root)?;
    let rows = library.rows()?;
    if rows.is_empty() {
        console.line(format!("no sessions in {}", library.root().display()))?;
        return Ok(Outcome::Fine);
    }
    let mut lines = vec![
        [
            "SESSION",
            "RECORDED",
            "LENGTH",
            "SIZE",
            "CONDITION",
            "VERDICT",
            "MISSING",
            "CAMERAS",
            "NAME",
        ]
        .map(str::to_owned),
    ];
    for row in &rows {
        let time = row.started_civil.to_string();
        lines.push([
            row.key.clone(),
            time.get(..16).unwrap_or(&time).replace('T', " "),
            text::duration(row.duration_ns),
            text::bytes(row.bytes),
            row.condition.to_string(),
            row.verdict.map_or("-".to_owned(), |v| v.to_string()),
            missing(row, &library.folder(&row.key)),
            shown(&row.cameras).into_owned(),
            shown(&row.name).into_owned(),
        ]);
    }
    for line in table(&lines) {
        console.line(line)?;
    }
    Ok(Outcome::Fine)
}

/// Lists the sessions as one JSON document.
///
/// # Errors
/// There is no library, or it cannot be read.
pub fn json(root: &Path, console: &mut Console<'_>) -> Result<Outcome> {
    let library = Library::open(root)?;
    let rows = library.rows()?;
    let sessions = rows.iter();
    let document = List {
        format: "paws-list",
        version: documents::VERSION,
        library: library.root().display().to_string(),
        sessions: sessions
            .map(|row| Session::of(row, &library.folder(&row.key)))
            .collect(),
    };
    documents::print(&document, false, console)?;
    Ok(Outcome::Fine)
}

/// Losses: the camera with the largest fraction of missing frames; if no camera has any, the number
/// of missing samples of all streams.
fn missing(row: &Row, folder: &Path) -> String {
    if row.missing == 0 {
        return "-".to_owned();
    }
    let streams = StreamLoss::of_folder(folder).into_iter();
    let cameras = streams.filter(StreamLoss::is_camera);
    let worst = cameras.max_by(|a, b| a.share.total_cmp(&b.share));
    match worst.filter(|worst| worst.missing > 0) {
        Some(worst) => {
            let part = text::percent(worst.missing, worst.expected);
            format!("{part} of {}", shown(&worst.name))
        }
        None => text::count(row.missing, "sample"),
    }
}

/// Rows with aligned columns; the last column is not padded.
fn table<const N: usize>(rows: &[[String; N]]) -> Vec<String> {
    let width = |i: usize| rows.iter().map(|r| r[i].chars().count()).max();
    let widths: Vec<usize> = (0..N).map(|i| width(i).unwrap_or(0)).collect();
    let line = |row: &[String; N]| {
        let cells = row.iter().zip(&widths).map(|(c, w)| format!("{c:w$}"));
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned() {
        let rows = [["a", "bbb", "c"], ["aaa", "b", ""]].map(|r| r.map(str::to_owned));
        assert_eq!(table(&rows), ["a    bbb  c", "aaa  b"]);
    }
}
