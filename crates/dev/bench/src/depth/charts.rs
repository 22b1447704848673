//! Charts of `depth`, drawn from its report.

use anyhow::{Context, Result};
use charts::{Axis, Chart, Series};
use serde_json::{Map, Value};

use super::peers::MODES;
use crate::stamp;

pub(crate) const WIDTH: u32 = 760;
pub(crate) const HEIGHT: u32 = 420;

/// Names and texts of all charts that there are results for.
///
/// # Errors
/// The report is not as this version writes it.
pub(super) fn draw(report: &Map<String, Value>) -> Result<Vec<(String, String)>> {
    let mut files = Vec::new();
    for (part, entry) in report {
        let found = &entry["found"];
        let drawn = match part.as_str() {
            "motorcycle" => race(found, "Motorcycle Q, a real pair"),
            "halved" => race(found, "Motorcycle Q at half its size, a real pair"),
            "simulated" => race(found, "simulated walks, by day and at night"),
            "imperfect" => race(found, "simulated walks with imperfect pairs"),
            "bands" => Ok(vec![("bands".to_owned(), bands(found))]),
            "sigma" => Ok(vec![("sigma".to_owned(), sigma(found))]),
            _ => continue,
        };
        let foot = stamp::source(&entry["stamp"]);
        for (name, chart) in drawn.with_context(|| format!("drawing {part}"))? {
            let name = match name.as_str() {
                "time" | "density" => format!("depth-{part}-{name}.svg"),
                _ => format!("depth-{name}.svg"),
            };
            files.push((name, chart.footnote(&foot).to_svg(WIDTH, HEIGHT)));
        }
    }
    Ok(files)
}

fn number(of: &Value, key: &str) -> f64 {
    of[key].as_f64().unwrap_or(f64::NAN)
}

/// Errors over time, and over density.
pub(crate) fn race(found: &Value, what: &str) -> Result<Vec<(String, Chart)>> {
    let points = found["points"].as_array().context("no points")?;
    let of = |kind: &str| {
        let own = points.iter().filter(|p| p["kind"] == kind);
        own.cloned().collect::<Vec<Value>>()
    };
    let bad = |p: &Value| 100.0 * number(p, "bad_2_or_absent");
    let mut time = Chart::new("Pixels with an error of more than 2 px or absent, against time")
        .subtitle(&format!(
            "{what}; pixels visible in both images; two threads; the line joins our best"
        ))
        .x_axis(Axis::log("time of a pair", "ms"))
        .y_axis(Axis::linear("bad-2 or absent", "%").include(0.0));
    let mut density = Chart::new("Answers with an error of more than 2 px, against density")
        .subtitle(&format!(
            "{what}; ours: only answers with a sigma below a limit"
        ))
        .x_axis(Axis::linear("pixels with an answer", "%"))
        .y_axis(Axis::linear("bad-2", "%").include(0.0));
    let mut front: Vec<(f64, f64)> = of("ours")
        .iter()
        .map(|p| (number(p, "ms"), bad(p)))
        .collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut least = f64::INFINITY;
    front.retain(|(_, y)| {
        let better = *y < least;
        least = least.min(*y);
        better
    });
    time = time.series(Series::line("ours", front.clone()));
    for point in of("ours") {
        if !["fast", "accurate"].contains(&point["name"].as_str().unwrap_or_default()) {
            continue;
        }
        let curve = point["curve"].as_array().context("no curve")?;
        let at = |p: &Value| {
            let of = |k: usize| p[k].as_f64().unwrap_or(f64::NAN);
            (100.0 * of(0), 100.0 * of(1))
        };
        let shown = curve.iter().map(at).filter(|(x, _)| *x >= 50.0);
        let name = format!("ours, {}", point["name"].as_str().unwrap_or_default());
        density = density.series(Series::line(&name, shown));
    }
    for kind in ["BM"].iter().chain(&MODES) {
        let own = of(kind);
        time = time.series(Series::scatter(
            kind,
            own.iter().map(|p| (number(p, "ms"), bad(p))),
        ));
        let place = |p: &Value| (100.0 * number(p, "density"), 100.0 * number(p, "bad_2"));
        density = density.series(Series::scatter(kind, own.iter().map(place)));
    }
    Ok(vec![
        ("time".to_owned(), time),
        ("density".to_owned(), density),
    ])
}

/// Time with bands relative to that without, and the loss.
fn bands(found: &Value) -> Chart {
    let rows = found.as_array().map_or(&[][..], Vec::as_slice);
    let series = ["fast", "balanced", "accurate"].map(|preset| {
        let own = rows.iter().filter(|r| r["preset"] == preset);
        let points = own.map(|r| {
            let faster = number(r, "full_ms") / number(r, "band_ms");
            (100.0 * number(r, "lost"), faster)
        });
        Series::scatter(preset, points)
    });
    let chart = Chart::new("Speedup and loss by a band of disparities")
        .subtitle("each camera of three simulated walks, 20 frames in a row")
        .x_axis(Axis::linear("right answers lost", "% of pixels").include(0.0))
        .y_axis(Axis::linear("times as fast as all disparities", "").include(1.0));
    series.into_iter().fold(chart, Chart::series)
}

/// Ratio of errors within two sigmas.
fn sigma(found: &Value) -> Chart {
    let rows = found.as_array().map_or(&[][..], Vec::as_slice);
    let mut names: Vec<&str> = Vec::new();
    for row in rows {
        let name = row["frames"].as_str().unwrap_or("?");
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let chart = Chart::new("Errors within two of their sigmas")
        .subtitle("held-out walks and a real pair (Motorcycle)")
        .x_axis(Axis::categories("", names.clone()))
        .y_axis(Axis::linear("within two sigmas", "%").include(80.0))
        .hline(95.0, "as stated");
    let series = ["fast", "balanced", "accurate"].map(|preset| {
        let value = |name: &&str| {
            let row = rows
                .iter()
                .find(|r| r["preset"] == preset && r["frames"] == *name);
            row.map_or(f64::NAN, |r| 100.0 * number(r, "within_two_sigma"))
        };
        Series::scatter(
            preset,
            names
                .iter()
                .enumerate()
                .map(|(k, name)| (k as f64, value(name))),
        )
    });
    series.into_iter().fold(chart, Chart::series)
}
