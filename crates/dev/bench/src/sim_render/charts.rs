//! Charts of `sim_render`, drawn from its report.

use charts::{Axis, Chart, Series};
use serde_json::{Map, Value};

use super::support_charts;
use crate::render_speed::PAWS_SIM;
use crate::report::{number, rows, to_svg};

const GOAL_DB: f64 = 40.0;

/// Names and texts of all charts that there are results for.
pub(super) fn draw(report: &Map<String, Value>) -> Vec<(String, String)> {
    let mut drawn = Vec::new();
    if let Some(part) = report.get("sizes") {
        drawn.push(("sim_render-sizes.svg", speed_chart(part), part));
        drawn.push(("sim_render-psnr.svg", psnr_chart(part), part));
    }
    if let Some(part) = report.get("support") {
        drawn.push(("sim_render-support.svg", support_charts::map(part), part));
        let held_out = support_charts::held_out(part);
        drawn.push(("sim_render-support-held-out.svg", held_out, part));
    }
    if let Some(part) = report.get("changes") {
        drawn.push(("sim_render-changes.svg", changes_chart(part), part));
    }
    to_svg(drawn)
}

/// Images per second of idle cores at best, from the processor time of an image.
fn idle_fps(part: &Value, speed: &Value) -> f64 {
    1e3 * number(&part["threads"]) / number(&speed["cpu_ms"])
}

fn speed_chart(part: &Value) -> Chart {
    let squares = || {
        let sizes = rows(&part["sizes"]).iter();
        sizes.filter(|size| size["width"] == size["height"])
    };
    let curve = |speed: fn(&Value) -> Option<&Value>| {
        let points = squares().filter_map(move |size| {
            let fps = idle_fps(part, speed(size)?);
            Some((number(&size["width"]), fps))
        });
        points.collect::<Vec<_>>()
    };
    let of_8 = |size: &Value| -> Option<usize> {
        rows(&size["speeds"])
            .iter()
            .position(|speed| speed["batch"] == 8)
    };
    let detail = squares().filter_map(|size| {
        let speed = &rows(&size["speeds"])[of_8(size)?];
        Some((number(&size["width"]), idle_fps(part, speed)))
    });
    Chart::new("Images per second of the simulator over their size")
        .subtitle("RGB and depth, batches of 8; two threads by processor time")
        .x_axis(Axis::log("edge", "px"))
        .y_axis(Axis::log("images", "1/s"))
        .series(Series::line("levels of detail", detail))
        .series(Series::line("exact", curve(|size| size.get("exact"))))
        .series(Series::line("PAWS-Sim, GPU (published)", PAWS_SIM))
}

fn psnr_chart(part: &Value) -> Chart {
    let sizes = rows(&part["sizes"]);
    let point = |size: &Value, key: &str| (number(&size["width"]), number(&size["quality"][key]));
    let squares = || sizes.iter().filter(|size| size["width"] == size["height"]);
    let series = |title: &str, key: &str| {
        let points: Vec<(f64, f64)> = squares().map(|size| point(size, key)).collect();
        Series::line(title, points)
    };
    Chart::new("PSNR of images with levels of detail to exact ones")
        .subtitle("views up to 3 m and 30 degrees from recorded poses")
        .x_axis(Axis::log("edge", "px"))
        .y_axis(Axis::linear("PSNR", "dB"))
        .series(series("median", "psnr_median_db"))
        .series(series("5th percentile", "psnr_p5_db"))
        .series(series("worst", "psnr_worst_db"))
        .hline(GOAL_DB, "goal of the median")
}

fn changes_chart(part: &Value) -> Chart {
    let modes = rows(&part["rows"]);
    let names = modes.iter().map(|row| row["mode"].as_str().unwrap_or("?"));
    let of = |key: &str, share: &str| -> Vec<(f64, f64)> {
        let at = |(place, row): (usize, &Value)| {
            let median = number(&row["cpu_ms"]["usual"]["p50"]);
            (place as f64, number(&row["cpu_ms"][key][share]) / median)
        };
        modes.iter().enumerate().map(at).collect()
    };
    let goals = modes.iter().enumerate();
    let goals = goals.filter_map(|(place, row)| Some((place as f64, row["goal"].as_f64()?)));
    Chart::new("Frames at changes of sectors over the median of the others")
        .subtitle("processor time on one thread; a synthetic loop of four sectors")
        .x_axis(Axis::categories("", names))
        .y_axis(Axis::log("time over the median", ""))
        .series(Series::scatter("others, 99.9 %", of("usual", "p999")))
        .series(Series::scatter("at changes, median", of("changes", "p50")))
        .series(Series::scatter("at changes, worst", of("changes", "worst")))
        .series(Series::scatter("goal", goals))
}
