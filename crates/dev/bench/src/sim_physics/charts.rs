//! Charts of `sim_physics`, drawn from its report.

use charts::{Axis, Chart, Series};
use serde_json::{Map, Value};

use super::values::{CONTACT_GOAL_MM, entries};
use crate::stamp;

const WIDTH: u32 = 760;
const HEIGHT: u32 = 420;

/// Names and texts of all charts that there are results for.
pub(super) fn draw(report: &Map<String, Value>) -> Vec<(String, String)> {
    let mut files = Vec::new();
    for (part, found) in report {
        let rows = entries(&found["rows"]);
        let drawn = match part.as_str() {
            "walks" => vec![
                ("success", success(rows)),
                ("progress", progress(rows)),
                ("contacts", contacts(rows)),
            ],
            "steps" => vec![("steps", steps(rows))],
            "shape" => vec![("shape", shape(rows))],
            _ => Vec::new(),
        };
        let foot = stamp::source(&found["stamp"]);
        for (name, chart) in drawn {
            let svg = chart.footnote(&foot).to_svg(WIDTH, HEIGHT);
            files.push((format!("sim_physics-{name}.svg"), svg));
        }
    }
    files
}

fn number(of: &Value, path: &str) -> f64 {
    let found = path.split('.').fold(of, |of, key| &of[key]);
    found.as_f64().unwrap_or(f64::NAN)
}

fn text<'a>(of: &'a Value, key: &str) -> &'a str {
    of[key].as_str().unwrap_or("?")
}

/// A category per course, and a series per shape.
fn by_course(rows: &[Value], chart: Chart, value: impl Fn(&Value) -> f64) -> Chart {
    let name = |row: &Value| format!("{} {}", text(row, "ground"), text(row, "course"));
    let mut names: Vec<String> = rows.iter().map(name).collect();
    names.dedup();
    let chart = chart.x_axis(Axis::categories("", names.clone()));
    ["true", "reconstructed"]
        .into_iter()
        .fold(chart, |chart, shape| {
            let own = rows.iter().filter(|row| row["shape"] == shape);
            let points = own.filter_map(|row| {
                let place = names.iter().position(|own| *own == name(row))?;
                Some((place as f64, value(row)))
            });
            chart.series(Series::scatter(shape, points))
        })
}

fn success(rows: &[Value]) -> Chart {
    let chart = Chart::new("Go2 over 5 m of kerb and stairs: share of runs that arrive")
        .subtitle("20 seeds each; the gait sees neither ground")
        .y_axis(
            Axis::linear("runs that arrive", "%")
                .include(0.0)
                .include(100.0),
        );
    by_course(rows, chart, |row| 100.0 * number(row, "outcome.success"))
}

fn progress(rows: &[Value]) -> Chart {
    let chart = Chart::new("Go2 over 5 m of kerb and stairs: progress")
        .subtitle("mean of 20 seeds; the first edge is at 1.5 m")
        .y_axis(Axis::linear("progress", "m").include(0.0).include(5.0));
    by_course(rows, chart, |row| number(row, "outcome.mean_progress_m"))
}

fn contacts(rows: &[Value]) -> Chart {
    let chart = Chart::new("Contacts of feet: distance from the true surface")
        .subtitle("95th percentile of the points at which feet touch the collision shape")
        .y_axis(Axis::linear("distance", "mm").include(0.0));
    by_course(rows, chart, |row| number(row, "contacts.distance.p95_mm"))
        .hline(CONTACT_GOAL_MM, "goal")
}

fn steps(rows: &[Value]) -> Chart {
    let chart = Chart::new("Go2 up steps: share of runs that arrive")
        .subtitle("20 seeds each; exact steps, boxes on a plane; goings of 29 cm")
        .x_axis(Axis::linear("height of a step", "cm").include(0.0))
        .y_axis(
            Axis::linear("runs that arrive", "%")
                .include(0.0)
                .include(100.0),
        );
    let series = [("one step", true), ("flight of 11 steps", false)];
    series.into_iter().fold(chart, |chart, (name, is_single)| {
        let own = rows.iter().filter(|row| (row["steps"] == 1) == is_single);
        let points = own.map(|row| {
            let share = number(row, "outcome.success");
            (number(row, "step_cm"), 100.0 * share)
        });
        chart.series(Series::line(name, points))
    })
}

fn shape(rows: &[Value]) -> Chart {
    let chart = Chart::new("Collision shape: height error under soles against its parts")
        .subtitle("95th percentile against the true ground; the default is marked")
        .x_axis(Axis::log("parts per 100 m²", ""))
        .y_axis(Axis::linear("height error", "mm").include(0.0));
    let lines = rows.iter().map(|row| {
        let points = entries(&row["curve"]);
        let at = |own: &Value| {
            (
                number(own, "parts_per_100_m2"),
                number(own, "sole_height.p95_mm"),
            )
        };
        let label = |own: &Value| match (number(own, "uncovered_share") - 0.25).abs() < 1e-9 {
            true => "default",
            false => "",
        };
        let labels: Vec<&str> = points.iter().map(label).collect();
        Series::line(text(row, "ground"), points.iter().map(at)).labels(labels)
    });
    lines
        .fold(chart, Chart::series)
        .hline(CONTACT_GOAL_MM, "goal")
        .vline(500.0, "goal")
}
