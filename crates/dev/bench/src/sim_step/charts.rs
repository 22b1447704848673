//! Chart of `sim_step`, drawn from its report.

use charts::{Axis, Chart, Series};
use serde_json::Value;

use crate::stamp;

const WIDTH: u32 = 760;
const HEIGHT: u32 = 420;
/// Goals of the Rust core and from Python, steps per second on two cores.
const CORE_GOAL: f64 = 1e6;
const PYTHON_GOAL: f64 = 2e5;
const THREADS: f64 = 2.0;

/// Steps per second over the number of environments, where they were measured.
pub(super) fn throughput(part: &Value) -> Option<String> {
    let scenes = part["rows"].as_array()?;
    let chart = Chart::new("Steps per second without images")
        .subtitle(
            "Motion, collisions, observation, reward, resets; two threads by \
             processor time",
        )
        .x_axis(Axis::log("environments", ""))
        .y_axis(Axis::log("steps", "1/s"))
        .footnote(&stamp::source(&part["stamp"]));
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let chart = scenes.iter().fold(chart, |chart, scene| {
        let rows = scene["found"].as_array().map_or(&[][..], Vec::as_slice);
        let of_two = rows.iter().filter(|row| row["threads"] == 2);
        let points = of_two.map(|row| {
            let us = number(&row["speed"]["cpu_us_per_step"]);
            (number(&row["environments"]), 1e6 * THREADS / us)
        });
        let name = scene["scene"].as_str().unwrap_or("?");
        chart.series(Series::line(name, points))
    });
    let chart = chart
        .hline(CORE_GOAL, "aim of the core")
        .hline(PYTHON_GOAL, "goal from Python");
    Some(chart.to_svg(WIDTH, HEIGHT))
}
