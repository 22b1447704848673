//! Charts of `sim_learn`, drawn from its report.

use charts::{Axis, Chart, Series};
use serde_json::{Map, Value};

use super::summary::{SPEED, SUCCESS};
use crate::stamp;

const WIDTH: u32 = 760;
const HEIGHT: u32 = 420;

/// The chart of a part, of its rows.
type Draw = fn(&[Value]) -> Chart;

/// Names and texts of all charts that there are results for.
pub(super) fn draw(report: &Map<String, Value>) -> Vec<(String, String)> {
    let all: [(&str, Draw); 4] = [
        ("speed", speed),
        ("state", state),
        ("images", images),
        ("trainers", trainers),
    ];
    let drawn = all.iter().filter_map(|(part, draw)| {
        let entry = report.get(*part)?;
        let rows = entry["rows"].as_array()?;
        let chart = draw(rows).footnote(&stamp::source(&entry["stamp"]));
        Some((format!("sim_learn-{part}.svg"), chart.to_svg(WIDTH, HEIGHT)))
    });
    drawn.collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn scene(row: &Value) -> &str {
    row["scene"].as_str().unwrap_or("?")
}

/// Success over steps of a training.
fn curve(name: &str, points: &Value) -> Series {
    let points = points.as_array().map_or(&[][..], Vec::as_slice);
    Series::line(
        name,
        points
            .iter()
            .map(|point| (number(&point[0]), number(&point[1]))),
    )
}

fn of_success(title: &str, subtitle: &str) -> Chart {
    Chart::new(title)
        .subtitle(subtitle)
        .x_axis(Axis::linear("steps of all environments", ""))
        .y_axis(Axis::linear("success", "").include(0.0).include(1.0))
}

fn speed(rows: &[Value]) -> Chart {
    let values = |key: &'static str| rows.iter().map(move |row| number(&row[key]));
    Chart::new("Steps per second through VectorEnv.step, 1024 environments")
        .subtitle("motion, height, collision, deviation, reward and autoreset included")
        .x_axis(Axis::categories("scene", rows.iter().map(scene)))
        .y_axis(Axis::linear("steps", "1/s").include(0.0))
        .series(Series::bars("by the clock", values("steps_per_s")))
        .series(Series::bars("of processor time", values("steps_per_cpu_s")))
        .hline(SPEED[0], "goal")
}

fn state(rows: &[Value]) -> Chart {
    let chart = of_success(
        "Success among the episodes of each rollout, from the state alone",
        "PPO of Stable-Baselines3, 16 environments, goals of 1 to 5 m, detour at least 1.1",
    );
    rows.iter()
        .fold(chart, |chart, row| {
            chart.series(curve(scene(row), &row["curve"]))
        })
        .hline(SUCCESS[1], "goal on unseen goals")
}

fn images(rows: &[Value]) -> Chart {
    let chart = of_success(
        "Success among the episodes of each rollout, from images",
        "48x36 px of color and depth, and the same network with black images",
    );
    rows.iter().fold(chart, |chart, row| {
        ["seeing", "blind"].iter().fold(chart, |chart, name| {
            let title = format!("{}, {name}", scene(row));
            chart.series(curve(&title, &row[*name]["curve"]))
        })
    })
}

fn trainers(rows: &[Value]) -> Chart {
    let chart = of_success(
        "Success among the episodes of each rollout, by trainer",
        "from the state alone, through the adapters of the package",
    );
    rows.iter().fold(chart, |chart, row| {
        [
            ("Stable-Baselines3", "stable_baselines3"),
            ("RSL-RL", "rsl_rl"),
        ]
        .iter()
        .fold(chart, |chart, (title, name)| {
            let title = format!("{}, {title}", scene(row));
            chart.series(curve(&title, &row[*name]["curve"]))
        })
    })
}
