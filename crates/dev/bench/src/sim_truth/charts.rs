//! Charts of `sim_truth`, drawn from its report.

use std::collections::BTreeSet;

use charts::{Axis, Chart, Series};
use serde_json::{Map, Value};

use super::heights::GOAL_MM;
use crate::report::{number, rows, to_svg};

/// Names and texts of all charts that there are results for.
pub(super) fn draw(report: &Map<String, Value>) -> Vec<(String, String)> {
    let mut drawn = Vec::new();
    if let Some(part) = report.get("heights") {
        drawn.push(("sim_truth-heights.svg", heights(rows(&part["rows"])), part));
    }
    if let Some(part) = report.get("depth") {
        let own = rows(&part["rows"]);
        drawn.push(("sim_truth-depth.svg", depth(own), part));
        drawn.push(("sim_truth-offsets.svg", offsets(own), part));
    }
    if let Some(part) = report.get("exact") {
        drawn.push(("sim_truth-exact.svg", exact(rows(&part["rows"])), part));
    }
    if let Some(part) = report.get("support") {
        drawn.push(("sim_truth-support.svg", support(rows(&part["rows"])), part));
    }
    to_svg(drawn)
}

/// Depth of synthetic scenes over the offset, the worst of all scenes for each lens.
fn exact(all: &[Value]) -> Chart {
    let mut chart = Chart::new("Depth of synthetic scenes beside the walk, four lenses")
        .subtitle("largest of three scenes, up to 5 m of depth; rotations up to 30 degrees")
        .x_axis(Axis::linear("offset from the walk", "m").include(0.0))
        .y_axis(Axis::log("error of the depth", "mm"));
    let worst = |lens: &str, key: &str| -> Vec<(f64, f64)> {
        let mut points: Vec<(f64, f64)> = Vec::new();
        for row in all.iter().filter(|row| row["lens"] == lens) {
            let (offset_m, value) = (number(&row["offset_m"]), number(&row[key]));
            match points.iter_mut().find(|own| own.0 == offset_m) {
                Some(own) => own.1 = own.1.max(value),
                None => points.push((offset_m, value)),
            }
        }
        points
    };
    let lenses: BTreeSet<&str> = all.iter().filter_map(|row| row["lens"].as_str()).collect();
    for lens in lenses {
        for (key, name) in [("median_mm", "median"), ("p95_mm", "95th percentile")] {
            chart = chart.series(Series::line(&format!("{lens}, {name}"), worst(lens, key)));
        }
    }
    let [median_mm, p95_mm] = super::exact::GOALS_M.map(|goal| 1e3 * goal);
    chart
        .hline(median_mm, "goal of the median")
        .hline(p95_mm, "goal of the 95th percentile")
}

/// Predicted against true PSNR of what agents see.
fn support(walks: &[Value]) -> Chart {
    let chart = Chart::new("Predicted PSNR of what agents see against the true one")
        .subtitle("starts of episodes on simulated walks; on the line the prediction is right")
        .x_axis(Axis::linear("PSNR to the truth", "dB"))
        .y_axis(Axis::linear("predicted by the grid", "dB"))
        .series(Series::line("right", [(8.0, 8.0), (26.0, 26.0)]));
    walks.iter().fold(chart, |chart, walk| {
        let samples = rows(&walk["samples"]).iter();
        let points = samples.map(|own| (number(&own["psnr_db"]), number(&own["grid_db"])));
        chart.series(Series::scatter(name(walk), points))
    })
}

fn name(walk: &Value) -> &str {
    walk["walk"].as_str().unwrap_or("?")
}

fn heights(walks: &[Value]) -> Chart {
    let of = |key: &str| {
        // Walks without steps have no heights at their edges.
        let all = walks.iter().enumerate();
        let found = all.filter(|(_, walk)| number(&walk[key]["error"]["count"]) > 0.0);
        let at =
            |(place, walk): (usize, &Value)| (place as f64, number(&walk[key]["error"]["p95_mm"]));
        found.map(at).collect::<Vec<_>>()
    };
    Chart::new("Heights of the simulator's ground against the truth")
        .subtitle("95th percentile; stereo depth, true poses")
        .x_axis(Axis::categories("", walks.iter().map(name)))
        .y_axis(Axis::log("error of the height", "mm"))
        .series(Series::scatter("within 0.6 m of a footstep", of("near")))
        .series(Series::scatter("at step edges", of("at_step_edges")))
        .series(Series::scatter("elsewhere, to 2.5 m", of("elsewhere")))
        .hline(GOAL_MM, "goal near footsteps")
}

/// Points of ranges with pixels: middle of the range, and a value.
fn curve<'a>(row: &'a Value, key: &'a str) -> impl Iterator<Item = (f64, f64)> + 'a {
    rows(&row["ranges"]).iter().filter_map(move |range| {
        let middle_m = 0.5 * (number(&range["from_m"]) + number(&range["to_m"]));
        Some((middle_m, range[key].as_f64()?))
    })
}

fn on_path(walk: &Value) -> Option<&Value> {
    let is_it = |row: &&Value| row["quality"] == "exact" && row["offset_m"] == 0.0;
    rows(&walk["rows"]).iter().find(is_it)
}

fn depth(walks: &[Value]) -> Chart {
    let chart = Chart::new("Depth of the simulator's cameras against the truth")
        .subtitle("median at held-out poses on the path, exact renderer, 672x376")
        .x_axis(Axis::linear("true depth", "m").include(0.0))
        .y_axis(Axis::log("error of the depth", "mm"));
    let chart = walks.iter().fold(chart, |chart, walk| match on_path(walk) {
        Some(row) => chart.series(Series::line(name(walk), curve(row, "median_mm"))),
        None => chart,
    });
    match walks.first().and_then(on_path) {
        Some(row) => chart.series(Series::line("goal", curve(row, "goal_mm"))),
        None => chart,
    }
}

fn offsets(walks: &[Value]) -> Chart {
    let chart = Chart::new("Depth of the simulator's cameras off the path")
        .subtitle("median from 2 to 3 m of true depth, exact renderer, 672x376")
        .x_axis(Axis::linear("offset from the path", "m").include(0.0))
        .y_axis(Axis::log("error of the depth", "mm"));
    walks.iter().fold(chart, |chart, walk| {
        let exact = rows(&walk["rows"])
            .iter()
            .filter(|row| row["quality"] == "exact");
        let points = exact.filter_map(|row| {
            let range = rows(&row["ranges"])
                .iter()
                .find(|own| own["from_m"] == 2.0)?;
            Some((number(&row["offset_m"]), range["median_mm"].as_f64()?))
        });
        chart.series(Series::line(name(walk), points))
    })
}
