//! Charts of `render`, drawn from its report.

use charts::{Axis, Chart, Series};
use serde_json::{Map, Value};

use crate::stamp;

const WIDTH: u32 = 760;
const HEIGHT: u32 = 420;

/// PAWS-Sim with RGB and depth on a GPU, as published: pixels along an edge, images per second.
pub(crate) const PAWS_SIM: [(f64, f64); 5] = [
    (64.0, 1487.0),
    (96.0, 1023.0),
    (256.0, 756.0),
    (512.0, 431.0),
    (1024.0, 185.0),
];
/// Goal at 64 px, images per second.
const GOAL_FPS: f64 = 1500.0;
const PASS_FPS: f64 = 800.0;
const GOAL_DB: f64 = 40.0;
const THREADS: f64 = 2.0;

/// Names and texts of all charts that there are results for.
pub(super) fn draw(report: &Map<String, Value>) -> Vec<(String, String)> {
    let mut drawn = Vec::new();
    if let Some(levels) = report.get("levels") {
        drawn.push(("render-psnr.svg", psnr(levels), levels));
    }
    if let Some(batches) = report.get("batches") {
        let chart = sizes(batches, report.get("sizes"));
        drawn.push(("render-sizes.svg", chart, batches));
    }
    let svg = |(name, chart, part): (&str, Chart, &Value)| {
        let chart = chart.footnote(&stamp::source(&part["stamp"]));
        (name.to_owned(), chart.to_svg(WIDTH, HEIGHT))
    };
    drawn.into_iter().map(svg).collect()
}

fn rows(found: &Value) -> &[Value] {
    found.as_array().map_or(&[], Vec::as_slice)
}

fn name(row: &Value) -> &str {
    row["walk"].as_str().unwrap_or("?")
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// Images per second of two idle cores at best, from the processor time of an image.
fn idle_fps(speed: &Value) -> f64 {
    1e3 * THREADS / number(&speed["cpu_ms"])
}

fn psnr(found: &Value) -> Chart {
    let chart = Chart::new("Speed against PSNR to the exact renderer, 64 px")
        .subtitle(
            "RGB and depth, batches of 64; two threads by processor time; median of 512 views",
        )
        .x_axis(Axis::linear("median PSNR", "dB"))
        .y_axis(Axis::linear("images", "1/s").include(0.0));
    let chart = rows(&found["rows"]).iter().fold(chart, |chart, row| {
        let curve = rows(&row["curve"]).iter();
        let at = |own: &Value| {
            let db = number(&own["quality"]["psnr_median_db"]);
            (db, idle_fps(&own["speed"]))
        };
        let label = |own: &Value| match own["max_sigma_px"] == row["chosen"] {
            true => "default",
            false => "",
        };
        let labels: Vec<&str> = curve.clone().map(label).collect();
        let suffix = if row["is_tuning"] == true {
            " (tuning)"
        } else {
            ""
        };
        let title = format!("{}{suffix}", name(row));
        chart.series(Series::line(&title, curve.map(at)).labels(labels))
    });
    chart
        .vline(GOAL_DB, "goal")
        .hline(GOAL_FPS, "goal")
        .hline(PASS_FPS, "pass")
}

fn sizes(batches: &Value, sizes: Option<&Value>) -> Chart {
    let chart = Chart::new("Images per second over their size")
        .subtitle("RGB and depth; two threads by processor time; PAWS-Sim on a GPU, as published")
        .x_axis(Axis::log("edge", "px"))
        .y_axis(Axis::log("images", "1/s"));
    let chart = rows(&batches["rows"]).iter().fold(chart, |chart, row| {
        let small = rows(&row["sizes"]).iter().filter_map(|size| {
            let speeds = rows(&size["speeds"]).iter();
            let of_64 = speeds.clone().find(|speed| speed["batch"] == 64)?;
            Some((number(&size["edge"]), idle_fps(of_64)))
        });
        let larger = sizes.map_or(&[][..], |sizes| rows(&sizes["rows"]));
        let larger = larger.iter().filter(|other| name(other) == name(row));
        let larger = larger.flat_map(|row| rows(&row["sizes"]));
        let squares = larger.filter(|size| size["width"] == size["height"]);
        let large = squares.map(|size| (number(&size["width"]), idle_fps(&size["speed"])));
        chart.series(Series::line(name(row), small.chain(large)))
    });
    chart.series(Series::line("PAWS-Sim, GPU (published)", PAWS_SIM))
}
