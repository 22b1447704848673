//! Charts of `sim_render`, drawn from its report.

use charts::{Axis, Chart, Series};
use serde_json::{Map, Value};

use super::support_charts;
use crate::render_speed::PAWS_SIM;
use crate::report::{number, rows, to_svg};

const GOAL_DB: f64 = 40.0;
/// Where exact images are drawn: the largest PSNR that is stated.
const EXACT_DB: f64 = 100.0;

/// Names and texts of all charts that there are results for.
pub(super) fn draw(report: &Map<String, Value>) -> Vec<(String, String)> {
    let mut drawn = Vec::new();
    if let Some(part) = report.get("sizes") {
        drawn.push(("sim_render-sizes.svg", speed_chart(part), part));
        drawn.push(("sim_render-psnr.svg", psnr_chart(part), part));
        drawn.push(("sim_render-curve.svg", curve_chart(part), part));
    }
    if let Some(part) = report.get("support") {
        drawn.push(("sim_render-support.svg", support_charts::map(part), part));
        let held_out = support_charts::held_out(part);
        drawn.push(("sim_render-support-held-out.svg", held_out, part));
    }
    if let Some(part) = report.get("memory") {
        drawn.push(("sim_render-memory.svg", memory_chart(part), part));
    }
    if let Some(part) = report.get("changes") {
        drawn.push(("sim_render-changes.svg", changes_chart(part), part));
    }
    to_svg(drawn)
}

fn speed_chart(part: &Value) -> Chart {
    let squares = || {
        let sizes = rows(&part["sizes"]).iter();
        sizes.filter(|size| size["width"] == size["height"])
    };
    let of_batch = |batch: u64| {
        let points = squares().filter_map(move |size| {
            let mut speeds = rows(&size["speeds"]).iter();
            let speed = speeds.find(|speed| speed["batch"] == batch)?;
            Some((number(&size["width"]), number(&speed["fps"])))
        });
        points.collect::<Vec<_>>()
    };
    let exact = squares().map(|size| (number(&size["width"]), number(&size["exact"]["fps"])));
    let chart = Chart::new("Images per second of the simulator over their size")
        .subtitle("RGB and depth in memory of the caller, two threads, elapsed time")
        .x_axis(Axis::log("edge", "px"))
        .y_axis(Axis::log("images", "1/s"));
    let chart = [1, 8, 64, 512].into_iter().fold(chart, |chart, batch| {
        let title = format!("levels of detail, batches of {batch}");
        chart.series(Series::line(&title, of_batch(batch)))
    });
    chart
        .series(Series::line("exact, batches of 8", exact))
        .series(Series::line("PAWS-Sim, GPU (published)", PAWS_SIM))
}

fn curve_chart(part: &Value) -> Chart {
    let chart = Chart::new("Images per second against PSNR to the exact renderer")
        .subtitle(
            "largest merged Gaussians 0.2 to 6.4 px, default 0.4 px; at 100 dB the exact renderer",
        )
        .x_axis(Axis::linear("median PSNR", "dB"))
        .y_axis(Axis::log("images", "1/s"))
        .vline(GOAL_DB, "goal");
    rows(&part["sizes"]).iter().fold(chart, |chart, size| {
        let curve = &size["curve"];
        let at = |own: &Value| {
            let db = number(&own["quality"]["psnr_median_db"]);
            (db, number(&own["speed"]["fps"]))
        };
        let label = |own: &Value| match own["max_sigma_px"] == part["default_max_sigma_px"] {
            true => "default",
            false => "",
        };
        let exact = (EXACT_DB, number(&curve["exact"]["fps"]));
        let settings = rows(&curve["rows"]).iter();
        let points = [exact].into_iter().chain(settings.clone().map(at));
        let labels: Vec<&str> = [""].into_iter().chain(settings.map(label)).collect();
        let title = format!("{}x{}", size["width"], size["height"]);
        chart.series(Series::line(&title, points).labels(labels))
    })
}

fn memory_chart(part: &Value) -> Chart {
    let chart = Chart::new("Resident memory while Gaussians are loaded and leave")
        .x_axis(Axis::linear("frames", ""))
        .y_axis(Axis::linear("memory", "MB").include(0.0));
    rows(&part["rows"]).iter().fold(chart, |chart, row| {
        let samples = rows(&row["samples_mb"]).iter();
        let per_sample = number(&row["frames"]) / samples.len().max(1) as f64;
        let points = samples
            .enumerate()
            .map(|(at, mb)| ((at + 1) as f64 * per_sample, number(mb)));
        let title = row["scene"].as_str().unwrap_or("?");
        chart.series(Series::line(title, points))
    })
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
    let name = |row: &Value| {
        let [scene, mode] = ["scene", "mode"].map(|key| row[key].as_str().unwrap_or("?"));
        format!("{scene}, {mode}")
    };
    let names: Vec<String> = modes.iter().map(name).collect();
    let of = |key: &str, share: &str| -> Vec<(f64, f64)> {
        let at = |(place, row): (usize, &Value)| {
            let median = number(&row["cpu_ms"]["usual"]["p50"]);
            let time = row["cpu_ms"][key][share].as_f64()?;
            Some((place as f64, time / median))
        };
        modes.iter().enumerate().filter_map(at).collect()
    };
    let goals = modes.iter().enumerate();
    let goals = goals.filter_map(|(place, row)| Some((place as f64, row["goal"].as_f64()?)));
    Chart::new("Frames at changes of sectors over the median of usual ones")
        .subtitle("processor time on one thread")
        .x_axis(Axis::categories("", names))
        .y_axis(Axis::log("time over the median", ""))
        .series(Series::scatter("usual, 99.9 %", of("usual", "p999")))
        .series(Series::scatter("near borders, 99.9 %", of("near", "p999")))
        .series(Series::scatter("at changes, median", of("changes", "p50")))
        .series(Series::scatter("at changes, 99.9 %", of("changes", "p999")))
        .series(Series::scatter("goal", goals))
}
