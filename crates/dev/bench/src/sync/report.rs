//! Results as a table, as JSON and as charts.

use std::path::Path;

use anyhow::Context;
use charts::{Axis, Chart, Series};
use serde_json::{Value, json};

use super::scoring::{Class, SCORED_FROM, SIGMAS, UNCLAIMED_NS, USELESS_NS};
use super::world::{TICK_NS, US};
use super::{Point, RATES, Results};
use crate::stamp;

/// The target of the project: p99 of a sample's time with 1 ms of exponential jitter after 10 s,
/// ns.
const TARGET_NS: f64 = 1e5;
/// The method under test comes first.
const OURS: usize = 0;

/// Prints the main results.
pub(crate) fn print(results: &Results) {
    println!(
        "errors of a sample's time after {SCORED_FROM:.0} s, us; a tick is {:.0} us\n",
        TICK_NS / US
    );
    println!(
        "{:18} {:>16} {:>7}  {:22} {:>9} {:>9} {:>9} {:>8} {:>7}  class",
        "fault", "strength", "Hz", "method", "median", "p99", "sigma", "flagged", "silent"
    );
    for p in &results.points {
        let s = &p.score;
        println!(
            "{:18} {:>16} {:>7}  {:22} {:>9.1} {:>9.1} {:>9.1} {:>7.1}% {:>7}  {}",
            p.fault,
            format!("{} {}", p.label, p.unit),
            p.rate_hz,
            p.method,
            s.quantile(0.5) / US,
            s.quantile(0.99) / US,
            s.mean_sigma() / US,
            100.0 * s.flagged as f64 / s.samples.max(1) as f64,
            s.silent,
            s.class().name(),
        );
    }
    println!();
    for cost in &results.costs {
        println!(
            "{:22} {:>5} Hz  {:8.1} ns/sample",
            cost.method, cost.rate_hz, cost.cost_ns
        );
    }
    println!();
    for method in methods(results) {
        let [ok, flagged, wrong] = [Class::Ok, Class::Flagged, Class::SilentlyWrong]
            .map(|class| results.count(method, class));
        println!("{method:22} ok {ok:3}  flagged {flagged:3}  silently wrong {wrong:3}");
    }
    for p in results.points.iter().filter(|p| target(p)) {
        let p99 = p.score.quantile(0.99);
        let met = if p99 < TARGET_NS { "met" } else { "MISSED" };
        println!(
            "target p99 < {} us at {} Hz: {:.1} us, {met}",
            TARGET_NS / US,
            p.rate_hz,
            p99 / US
        );
    }
}

/// Writes `sync.json` and the charts into a folder.
pub(crate) fn write(
    results: &Results,
    seeds: u64,
    args: &[String],
    out: &Path,
) -> anyhow::Result<()> {
    std::fs::create_dir_all(out)
        .with_context(|| format!("making the folder for results {}", out.display()))?;
    let origin = stamp::stamp("sync", args)?;
    let put = |name: &str, text: String| {
        let path = out.join(name);
        std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))
    };
    let json = serde_json::to_string_pretty(&to_json(results, seeds, &origin))?;
    put("sync.json", json + "\n")?;
    let foot = stamp::line(&origin);
    for rate_hz in RATES {
        let name = |what: &str| format!("sync-{what}-{rate_hz}hz.svg");
        put(&name("samples"), samples_chart(results, rate_hz, &foot))?;
        for (file, fault, caption) in STRENGTHS {
            put(
                &name(file),
                strength_chart(results, rate_hz, fault, caption, &foot),
            )?;
        }
    }
    put("sync.svg", cost_chart(results, &foot))
}

/// Charts over the strength of a fault: file, fault, caption of the axis.
const STRENGTHS: [(&str, &str, &str); 4] = [
    ("jitter", "jitter", "mean jitter"),
    ("steps", "clock falls back", "step"),
    ("bursts", "bursts", "delay in a burst"),
    ("swings", "rate swings", "swing of the rate"),
];

fn methods(results: &Results) -> Vec<&'static str> {
    let mut names = Vec::new();
    for cost in &results.costs {
        if !names.contains(&cost.method) {
            names.push(cost.method);
        }
    }
    names
}

fn target(p: &Point) -> bool {
    p.fault == "jitter" && p.strength == 1.0 && p.method.ends_with("(ours)")
}

/// The point of the target's world: 1 ms of exponential jitter.
fn at_target<'a>(results: &'a Results, method: &str, rate_hz: f64) -> Option<&'a Point> {
    let here = |p: &&Point| {
        p.fault == "jitter" && p.strength == 1.0 && p.method == method && p.rate_hz == rate_hz
    };
    results.points.iter().find(here)
}

fn samples_chart(results: &Results, rate_hz: f64, foot: &str) -> String {
    let mut chart = Chart::new(&format!("Error of a mapped time, samples at {rate_hz} Hz"))
        .subtitle("99th percentile; 1 ms of exponential jitter, rate error 100 ppm")
        .x_axis(Axis::log("samples so far", ""))
        .y_axis(Axis::log("error", "us"))
        .hline(TARGET_NS / US, "target for p99 after 10 s")
        .hline(TICK_NS / US, "a tick")
        .vline(SCORED_FROM * rate_hz, "10 s")
        .footnote(foot);
    for (slot, method) in methods(results).into_iter().enumerate() {
        let points = results
            .by_samples
            .iter()
            .filter(|r| r.method == method && r.rate_hz == rate_hz)
            .map(|r| (r.samples as f64, r.p99_ns / US));
        chart = chart.series(Series::line(method, points).slot(slot));
    }
    chart.to_svg(760, 420)
}

fn strength_chart(
    results: &Results,
    rate_hz: f64,
    fault: &str,
    caption: &str,
    foot: &str,
) -> String {
    let here = |p: &&Point| p.fault == fault && p.rate_hz == rate_hz;
    let unit = results.points.iter().find(here).map_or("", |p| p.unit);
    let mut chart = Chart::new(&format!(
        "99th percentile of the error, samples at {rate_hz} Hz"
    ))
    .subtitle("of the times that were not flagged, after 10 s; a tick is 39 us")
    .x_axis(Axis::log(caption, unit))
    .y_axis(Axis::log("error", "us"))
    .footnote(foot);
    for (slot, method) in methods(results).into_iter().enumerate() {
        let mine: Vec<&Point> = results
            .points
            .iter()
            .filter(here)
            .filter(|p| p.method == method)
            .collect();
        let points = mine
            .iter()
            .map(|p| (p.strength, p.score.quantile(0.99) / US));
        let series = Series::line(method, points).slot(slot);
        chart = chart.series(if slot == OURS {
            series.labels(mine.iter().map(|p| p.score.class().name()))
        } else {
            series
        });
    }
    chart.to_svg(760, 420)
}

fn cost_chart(results: &Results, foot: &str) -> String {
    let mut chart = Chart::new("Accuracy and speed")
        .subtitle(
            "99th percentile of the error of a sample's time after 10 s, \
             with 1 ms of exponential jitter; a tick is 39 us",
        )
        .x_axis(Axis::log("time per sample, one core", "ns"))
        .y_axis(Axis::log("error", "us"))
        .hline(TARGET_NS / US, "target")
        .footnote(foot);
    for (slot, method) in methods(results).into_iter().enumerate() {
        let mine: Vec<_> = results
            .costs
            .iter()
            .filter(|c| c.method == method)
            .collect();
        let points = mine.iter().map(|c| {
            let p99 = at_target(results, method, c.rate_hz).map(|p| p.score.quantile(0.99));
            (c.cost_ns, p99.unwrap_or(f64::NAN) / US)
        });
        let labels = mine.iter().map(|c| format!("{} Hz", c.rate_hz));
        chart = chart.series(Series::scatter(method, points).labels(labels).slot(slot));
    }
    chart.to_svg(760, 420)
}

fn to_json(results: &Results, seeds: u64, origin: &Value) -> Value {
    let round = |v: f64| (v * 1000.0).round() / 1000.0;
    let by_samples: Vec<Value> = results
        .by_samples
        .iter()
        .map(|r| {
            json!({
                "method": r.method,
                "rate_hz": r.rate_hz,
                "samples": r.samples,
                "median_us": round(r.median_ns / US),
                "p99_us": round(r.p99_ns / US),
            })
        })
        .collect();
    let costs: Vec<Value> = results
        .costs
        .iter()
        .map(|c| json!({"method": c.method, "rate_hz": c.rate_hz, "ns_per_sample": round(c.cost_ns)}))
        .collect();
    let targets: Vec<Value> = results
        .points
        .iter()
        .filter(|p| target(p))
        .map(|p| {
            let p99 = p.score.quantile(0.99);
            json!({
                "rate_hz": p.rate_hz,
                "p99_us": round(p99 / US),
                "target_us": TARGET_NS / US,
                "met": p99 < TARGET_NS,
            })
        })
        .collect();
    let classes: Vec<Value> = methods(results)
        .into_iter()
        .map(|method| {
            json!({
                "method": method,
                "ok": results.count(method, Class::Ok),
                "flagged": results.count(method, Class::Flagged),
                "silently_wrong": results.count(method, Class::SilentlyWrong),
            })
        })
        .collect();
    json!({
        "benchmark": "sync",
        "stamp": origin,
        "terms": {
            "seeds": seeds,
            "errors": "against the instant at which the sample was taken, at any point of its tick",
            "tick_us": TICK_NS / US,
            "errors_scored_from_s": SCORED_FROM,
            "silently_wrong_beyond_sigmas": SIGMAS,
            "silently_wrong_without_sigma_beyond_us": UNCLAIMED_NS / US,
            "sigma_that_counts_as_a_flag_us": USELESS_NS / US,
        },
        "targets": targets,
        "classes": classes,
        "cost": costs,
        "by_samples": by_samples,
        "points": results.points.iter().map(Point::to_json).collect::<Vec<_>>(),
    })
}
