//! Charts of `sim_physics`, drawn from its report.

use charts::{Axis, Chart, Series};
use serde_json::{Map, Value};

use super::values::{CONTACT_GOAL_MM, FALSE_SUPPORT_GOAL, REST_GOAL_MM, entries};
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
            "bodies" => vec![
                ("bodies", bodies(rows)),
                ("bodies-difference", difference(rows)),
                ("bodies-slip", slip(rows)),
                ("bodies-sink", sink(rows)),
            ],
            "shape" => {
                let mut all = vec![("shape", shape(rows))];
                // Results of before there was a report have none.
                if rows.iter().any(|row| row["report"].is_object()) {
                    all.push(("shape-support", false_support(rows)));
                    all.push(("shape-time", step_time(rows)));
                }
                let has = |key: &str| {
                    let of_walks = rows.iter().flat_map(|row| entries(&row["report"]["rows"]));
                    of_walks.into_iter().any(|own| own[key].is_object())
                };
                if has("step_edges") {
                    all.push(("shape-edges", step_edges(rows)));
                }
                if has("normals") {
                    all.push(("shape-slopes", slopes(rows)));
                }
                all
            }
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
    let chart = Chart::new("Contacts of feet within 1 cm of the true surface")
        .subtitle("points at which feet touch the collision shape; the goal is all of them")
        .y_axis(Axis::linear("contacts", "%").include(90.0));
    by_course(rows, chart, |row| {
        100.0 * number(row, "contacts.share_within_goal")
    })
    .hline(100.0, "goal")
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

/// A line per engine: the largest of all bodies over the time step.
fn by_step(rows: &[Value], chart: Chart, value: impl Fn(&Value) -> Option<f64>) -> Chart {
    let chart = chart.x_axis(Axis::log("time step", "ms"));
    let engines = [("rapier3d", "rapier"), ("MuJoCo", "mujoco")];
    engines.into_iter().fold(chart, |chart, (name, engine)| {
        let own: Vec<&Value> = rows.iter().filter(|row| row["engine"] == engine).collect();
        let mut steps: Vec<f64> = own.iter().map(|row| number(row, "step_ms")).collect();
        steps.sort_by(f64::total_cmp);
        steps.dedup();
        let points = steps.into_iter().filter_map(|step| {
            let at = own.iter().filter(|row| number(row, "step_ms") == step);
            Some((step, at.filter_map(|row| value(row)).reduce(f64::max)?))
        });
        chart.series(Series::line(name, points))
    })
}

fn bodies(rows: &[Value]) -> Chart {
    let chart = Chart::new("Bodies at rest on level ground: error of their height")
        .subtitle("the largest of a box, a ball, a capsule and a stand, dropped and thrown")
        .y_axis(Axis::linear("error of the height", "mm").include(0.0));
    by_step(rows, chart, |row| {
        Some(row["rest"]["height_error_mm"].as_f64()?.abs())
    })
    .hline(REST_GOAL_MM, "goal")
}

fn difference(rows: &[Value]) -> Chart {
    let chart = Chart::new("Bodies at rest: height from that of MuJoCo at 0.5 ms")
        .subtitle("the largest on a plane, a tread, a ramp and waves")
        .y_axis(Axis::linear("difference of the height", "mm").include(0.0));
    by_step(rows, chart, |row| row["from_mujoco"]["height_mm"].as_f64())
}

fn slip(rows: &[Value]) -> Chart {
    let chart = Chart::new("Bodies dropped from 10 cm: slip")
        .subtitle("the largest on level ground, where none is expected")
        .y_axis(Axis::linear("slip", "mm").include(0.0));
    by_step(rows, chart, |row| {
        let is_level = !row["rest"]["height_error_mm"].is_null();
        let slip_mm = row["rest"]["slip_mm"].as_f64()?;
        (is_level && row["fall"] == "dropped").then_some(slip_mm)
    })
}

fn sink(rows: &[Value]) -> Chart {
    let chart = Chart::new("Bodies thrown down at 5 m/s: largest penetration")
        .subtitle("the largest of a box, a ball, a capsule and a stand, below their height at rest")
        .y_axis(Axis::linear("depth", "mm").include(0.0));
    by_step(rows, chart, |row| {
        let sink_mm = row["rest"]["sink_mm"].as_f64()?;
        (row["fall"] == "thrown").then_some(sink_mm)
    })
}

fn false_support(rows: &[Value]) -> Chart {
    let chart = Chart::new("Collision shape: false support, against its parts")
        .subtitle(
            "share of places near footsteps that hold a foot of 4 cm where the truth has none",
        )
        .x_axis(Axis::log("parts per 100 m²", ""))
        .y_axis(Axis::linear("places", "%").include(0.0));
    let lines = rows.iter().map(|row| {
        let points = entries(&row["report"]["rows"]).iter().map(|own| {
            let share = number(own, "feet.false_support_share");
            (number(own, "parts_per_100_m2"), 100.0 * share)
        });
        Series::line(text(row, "ground"), points)
    });
    lines
        .fold(chart, Chart::series)
        .hline(100.0 * FALSE_SUPPORT_GOAL, "goal")
}

/// Position and height of step edges, each a line for a ground that has some.
fn step_edges(rows: &[Value]) -> Chart {
    let chart = Chart::new("Collision shape: errors of step edges, against its parts")
        .subtitle("95th percentile of profiles across true edges near footsteps")
        .x_axis(Axis::log("parts per 100 m²", ""))
        .y_axis(Axis::linear("error", "mm").include(0.0));
    let lines = rows.iter().flat_map(|row| {
        ["position", "height"].map(|key| {
            let points = entries(&row["report"]["rows"]).iter().map(|own| {
                let path = format!("step_edges.{key}.p95_mm");
                (number(own, "parts_per_100_m2"), number(own, &path))
            });
            Series::line(&format!("{}, {key}", text(row, "ground")), points)
        })
    });
    lines.fold(chart, Chart::series)
}

fn slopes(rows: &[Value]) -> Chart {
    let chart = Chart::new("Collision shape: error of its slope under a foot, against its parts")
        .subtitle("95th percentile of the angle between planes through nine points of 4 cm")
        .x_axis(Axis::log("parts per 100 m²", ""))
        .y_axis(Axis::linear("angle", "°").include(0.0));
    let lines = rows.iter().map(|row| {
        let points = entries(&row["report"]["rows"]).iter().map(|own| {
            (
                number(own, "parts_per_100_m2"),
                number(own, "normals.p95_deg"),
            )
        });
        Series::line(text(row, "ground"), points)
    });
    lines.fold(chart, Chart::series)
}

/// Time of a step relative to that with the default number of parts.
fn step_time(rows: &[Value]) -> Chart {
    let chart = Chart::new("Collision shape: time of a step of a stand on it, against its parts")
        .subtitle("processor time over that with the default's parts")
        .x_axis(Axis::log("parts and layers", ""))
        .y_axis(Axis::linear("ratio", "").include(0.0));
    let lines = rows.iter().flat_map(|row| {
        [("rapier3d", "step_us.rapier"), ("MuJoCo", "step_us.mujoco")].map(|(engine, path)| {
            let points = entries(&row["report"]["rows"]);
            let is_default = |own: &&Value| (number(own, "uncovered_share") - 0.25).abs() < 1e-9;
            let usual = points.iter().find(is_default);
            let usual = usual.map_or(f64::NAN, |own| number(own, path));
            let at = |own: &Value| (number(own, "geoms"), number(own, path) / usual);
            let name = format!("{}, {engine}", text(row, "ground"));
            Series::line(&name, points.iter().map(at))
        })
    });
    lines.fold(chart, Chart::series)
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
