//! Charts of `splats`, drawn from its report.

use charts::{Axis, Chart, Series};
use serde_json::{Map, Value};

use crate::stamp;

const WIDTH: u32 = 760;
const HEIGHT: u32 = 420;
/// PSNR of views in gaps, dB.
const GOAL_DB: f64 = 25.0;

/// Names and texts of all charts that there are results for.
pub(super) fn draw(report: &Map<String, Value>) -> Vec<(String, String)> {
    let mut files = Vec::new();
    for (part, found) in report {
        let drawn = match part.as_str() {
            "walks" => vec![
                ("walks", walks(found)),
                ("time", time(found)),
                ("off-path", off_path(found)),
            ],
            "counts" => vec![("counts", counts(found))],
            "failures" => vec![("failures", failures(found))],
            "settings" => vec![("settings", settings(found))],
            _ => Vec::new(),
        };
        let foot = stamp::source(&found["stamp"]);
        for (name, chart) in drawn {
            let svg = chart.footnote(&foot).to_svg(WIDTH, HEIGHT);
            files.push((format!("splats-{name}.svg"), svg));
        }
    }
    files
}

/// A number by its path.
fn number(of: &Value, path: &str) -> f64 {
    let found = path.split('.').fold(of, |of, key| &of[key]);
    found.as_f64().unwrap_or(f64::NAN)
}

fn rows(found: &Value) -> &[Value] {
    found.as_array().map_or(&[], Vec::as_slice)
}

fn text<'a>(row: &'a Value, key: &str) -> &'a str {
    row[key].as_str().unwrap_or("?")
}

/// What was run: steps and images.
fn run_of(found: &Value) -> String {
    let row = &found["rows"][0];
    format!(
        "{} steps, images of {}x{}, true poses, noise-free truth",
        row["steps"], row["size"][0], row["size"][1]
    )
}

fn psnr_axis() -> Axis {
    Axis::linear("PSNR", "dB")
}

/// Walk and preset, where there are several.
fn name(row: &Value) -> String {
    match text(row, "preset") {
        "balanced" => text(row, "walk").to_owned(),
        preset => format!("{} {preset}", text(row, "walk")),
    }
}

fn walks(found: &Value) -> Chart {
    let all = rows(&found["rows"]);
    let chart = Chart::new("Held-out views of simulated walks")
        .subtitle(&run_of(found))
        .x_axis(Axis::categories("", all.iter().map(name)))
        .y_axis(psnr_axis().include(15.0))
        .hline(GOAL_DB, "goal in gaps");
    let measures = [
        ("every eighth instant", "instants.psnr_db"),
        ("gaps of 2 m", "gaps.psnr_db"),
        ("gaps, worst view", "gaps.worst_db"),
    ];
    measures.iter().fold(chart, |chart, (name, path)| {
        let points = all.iter().enumerate();
        let points = points.map(|(k, row)| (k as f64, number(row, path)));
        chart.series(Series::scatter(name, points))
    })
}

fn time(found: &Value) -> Chart {
    let chart = Chart::new("PSNR in gaps over the time of the training")
        .subtitle(&run_of(found))
        .x_axis(Axis::linear("processor time", "s").include(0.0))
        .y_axis(psnr_axis())
        .hline(GOAL_DB, "goal");
    rows(&found["rows"]).iter().fold(chart, |chart, row| {
        let points = rows(&row["curve"]).iter();
        let points = points.map(|p| (number(p, "cpu_s"), number(p, "psnr_db")));
        chart.series(Series::line(&name(row), points))
    })
}

fn off_path(found: &Value) -> Chart {
    let chart = Chart::new("Views away from the path, not rotated")
        .subtitle(&run_of(found))
        .x_axis(Axis::log("distance from the pose of a training image", "m"))
        .y_axis(psnr_axis());
    rows(&found["rows"]).iter().fold(chart, |chart, row| {
        let points = rows(&row["off_path"]).iter();
        let points = points.filter(|p| number(p, "angle_deg") == 0.0);
        let points = points.map(|p| (number(p, "offset_m"), number(p, "psnr_db")));
        chart.series(Series::line(&name(row), points))
    })
}

/// The walks of some rows, each once.
fn walks_of(all: &[Value]) -> Vec<&str> {
    let mut walks: Vec<&str> = Vec::new();
    for row in all {
        if !walks.contains(&text(row, "walk")) {
            walks.push(text(row, "walk"));
        }
    }
    walks
}

fn counts(found: &Value) -> Chart {
    let all = rows(&found["rows"]);
    let chart = Chart::new("PSNR over the number of Gaussians, from the same start")
        .subtitle(&run_of(found))
        .x_axis(Axis::log("Gaussians at the end", ""))
        .y_axis(psnr_axis());
    walks_of(all).into_iter().fold(chart, |chart, walk| {
        let own = || all.iter().filter(|row| row["walk"] == walk);
        let line = |path: &'static str| {
            own().map(move |row| (number(row, "gaussians"), number(row, path)))
        };
        chart
            .series(Series::line(&format!("{walk}, gaps"), line("gaps.psnr_db")))
            .series(Series::line(
                &format!("{walk}, instants"),
                line("instants.psnr_db"),
            ))
    })
}

fn settings(found: &Value) -> Chart {
    let all = rows(&found["rows"]);
    let mut cases: Vec<&str> = Vec::new();
    for row in all {
        if !cases.contains(&text(row, "case")) {
            cases.push(text(row, "case"));
        }
    }
    let chart = Chart::new("Settings at equal steps: PSNR in gaps")
        .subtitle(&run_of(found))
        .x_axis(Axis::categories("", cases.clone()))
        .y_axis(psnr_axis());
    walks_of(all).into_iter().fold(chart, |chart, walk| {
        let value = |case: &&str| {
            let row = all
                .iter()
                .find(|r| r["walk"] == walk && r["case"] == **case);
            row.map_or(f64::NAN, |row| number(row, "gaps.psnr_db"))
        };
        let points = cases.iter().enumerate();
        let points = points.map(|(k, case)| (k as f64, value(case)));
        chart.series(Series::scatter(walk, points))
    })
}

/// Loss against the undamaged training, over the step of the strength.
/// Differences from the undamaged views of the same walk, mean over the walks.
fn failures(found: &Value) -> Chart {
    let all = rows(&found["rows"]);
    let psnr_db = |row: &Value| number(row, "gaps.psnr_db");
    let change_db = |row: &Value| {
        let same = |other: &&Value| other["kind"] == "none" && other["walk"] == row["walk"];
        let undamaged = all.iter().find(same);
        psnr_db(row) - undamaged.map_or(f64::NAN, psnr_db)
    };
    let mut kinds: Vec<&str> = Vec::new();
    for row in all {
        let kind = text(row, "kind");
        if kind != "none" && !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    let chart = Chart::new("Damaged views: PSNR in gaps against undamaged ones")
        .subtitle(&run_of(found))
        .x_axis(Axis::linear("step of the strength", "").include(0.0))
        .y_axis(Axis::linear("change of PSNR, mean over walks", "dB"));
    kinds.into_iter().fold(chart, |chart, kind| {
        let of_kind = || all.iter().filter(|row| row["kind"] == kind);
        let mut strengths: Vec<&Value> = Vec::new();
        for row in of_kind() {
            if !strengths.contains(&&row["strength"]) {
                strengths.push(&row["strength"]);
            }
        }
        let mean_db = |strength: &&Value| {
            let own = of_kind().filter(|row| row["strength"] == **strength);
            let changes: Vec<f64> = own.map(change_db).collect();
            changes.iter().sum::<f64>() / changes.len() as f64
        };
        let points = strengths.iter().enumerate();
        let points = points.map(|(k, strength)| ((k + 1) as f64, mean_db(strength)));
        let unit = of_kind().next().map_or("", |row| text(row, "unit"));
        let labels = strengths
            .iter()
            .map(|strength| format!("{strength} {unit}"));
        let labels = std::iter::once(String::new()).chain(labels);
        let series = Series::line(kind, std::iter::once((0.0, 0.0)).chain(points));
        chart.series(series.labels(labels.collect::<Vec<String>>()))
    })
}
