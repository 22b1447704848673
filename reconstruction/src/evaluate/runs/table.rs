//! Text table of runs.

use super::super::{Delta, Statistics};
use super::{Run, Runs};

/// Cell without a number.
const ABSENT: &str = "-";

pub(super) fn text(runs: &Runs) -> String {
    let deltas: Vec<Delta> = (runs.runs.iter().take(1))
        .flat_map(|run| run.evaluation.relative.iter().map(|r| r.delta))
        .collect();
    let mut rows = vec![heads(&deltas)];
    rows.extend(runs.runs.iter().map(|run| cells(runs, run, &deltas)));
    let widths: Vec<usize> = (0..rows[0].len())
        .map(|k| rows.iter().map(|r| r[k].chars().count()).max().unwrap_or(0))
        .collect();
    let mut text = String::new();
    for row in &rows {
        let line: Vec<String> = (row.iter().zip(&widths).enumerate())
            // Names to the left, numbers to the right.
            .map(|(k, (cell, width))| match k {
                0 => format!("{cell:<width$}"),
                _ => format!("{cell:>width$}"),
            })
            .collect();
        text += line.join("  ").trim_end();
        text.push('\n');
    }
    text + &drift_note(runs) + &summary(runs)
}

/// How the segments of drift are chosen: not as evo does by default.
fn drift_note(runs: &Runs) -> String {
    let mut all = runs.runs.iter().flat_map(|run| &run.evaluation.relative);
    match all.next() {
        Some(first) if first.overlapping => {
            "drift: root mean square over segments from every pose; evo_rpe's default is --over 1f \
             --consecutive\n"
                .to_owned()
        }
        Some(_) => "drift: root mean square over consecutive segments\n".to_owned(),
        None => String::new(),
    }
}

fn heads(deltas: &[Delta]) -> Vec<String> {
    let mut heads: Vec<String> = ["run", "ATE m", "max m", "rotation deg"]
        .map(str::to_owned)
        .into();
    for delta in deltas {
        let unit = if is_distance(*delta) { "%" } else { "m" };
        heads.push(format!("{delta}: {unit}"));
        heads.push(format!("{delta}: deg"));
    }
    let rest = [
        "complete",
        "longest gap s",
        "poses",
        "NEES/6",
        "> 3 sigma",
        "time s",
        "memory MB",
    ];
    heads.extend(rest.map(str::to_owned));
    heads
}

fn is_distance(delta: Delta) -> bool {
    matches!(delta, Delta::Meters(_))
}

fn cells(runs: &Runs, run: &Run, deltas: &[Delta]) -> Vec<String> {
    let evaluation = &run.evaluation;
    let absolute = evaluation.absolute.as_ref();
    let rotation = absolute.and_then(|a| a.rotation_rad);
    let lost = if run.is_lost(runs.least_completion) {
        " (lost)"
    } else {
        ""
    };
    let mut cells = vec![
        format!("{}{lost}", run.name),
        formatted(absolute.map(|a| a.translation_m.rmse), 4),
        formatted(absolute.map(|a| a.translation_m.max), 4),
        formatted(rotation.map(|r| r.rmse.to_degrees()), 3),
    ];
    for delta in deltas {
        let relative = run.relative(*delta);
        let rmse = |of: Option<Statistics>, factor: f64| of.map(|s| factor * s.rmse);
        let translation = match is_distance(*delta) {
            true => relative.and_then(|r| rmse(r.share, 100.0)),
            false => relative.and_then(|r| rmse(r.translation_m, 1.0)),
        };
        cells.push(formatted(translation, 3));
        let rotation = relative.and_then(|r| rmse(r.rotation_rad, 1f64.to_degrees()));
        cells.push(formatted(rotation, 3));
    }
    let consistency = evaluation.consistency.as_ref();
    let wrong = consistency.map(|c| format!("{} of {}", c.silently_wrong, c.count));
    cells.extend([
        format!("{:.1} %", 100.0 * evaluation.completion.share),
        formatted(Some(evaluation.completion.longest_gap_s()), 2),
        evaluation.matched.to_string(),
        formatted(consistency.map(|c| c.nees / 6.0), 2),
        wrong.unwrap_or_else(|| ABSENT.to_owned()),
        formatted(run.cost.seconds, 1),
        formatted(run.cost.peak_bytes.map(|b| b as f64 * 1e-6), 0),
    ]);
    cells
}

fn formatted(number: Option<f64>, digits: usize) -> String {
    number.map_or_else(|| ABSENT.to_owned(), |n| format!("{n:.digits$}"))
}

fn summary(runs: &Runs) -> String {
    let count = runs.runs.len();
    let worst = runs.worst.as_deref().unwrap_or(ABSENT);
    let mean = match &runs.mean {
        Some(mean) => {
            let turn = mean.rotation_rmse_rad.map(f64::to_degrees);
            format!(
                "mean of {count}: ATE {:.4} m, rotation {} deg, complete {:.1} %",
                mean.translation_rmse_m,
                formatted(turn, 3),
                100.0 * mean.completion
            )
        }
        None if runs.lost > 0 => format!("mean: none, lost {} of {count}", runs.lost),
        None => "no runs".to_owned(),
    };
    match count {
        1 if runs.lost == 0 => runs.summary() + "\n",
        _ => format!("worst: {worst}; {mean}\n"),
    }
}
