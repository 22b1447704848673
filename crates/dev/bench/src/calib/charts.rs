//! The charts of `calib`.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use charts::{Axis, Chart, Series};
use serde_json::Value;

use super::{KINDS, Point, Verdict};

const SIZE: (u32, u32) = (760, 380);

fn save(out: &Path, name: &str, chart: &Chart) -> Result<()> {
    let path = out.join(format!("{name}.svg"));
    fs::write(&path, chart.to_svg(SIZE.0, SIZE.1))
        .with_context(|| format!("writing {}", path.display()))
}

/// Draws everything.
pub(super) fn draw(out: &Path, views: &Value, models: &Value, points: &[Point]) -> Result<()> {
    let rows = views.as_array().map_or(&[][..], Vec::as_slice);
    let of = |row: &Value, who: &str, what: &str| row[who][what].as_f64().unwrap_or(f64::NAN);
    let count = |row: &Value| row["views"].as_f64().unwrap_or(f64::NAN);
    for (name, what, title, unit) in [
        (
            "calib-views-shift",
            "shift_mm",
            "Error of the right camera's position",
            "mm",
        ),
        (
            "calib-views-turn",
            "turn_deg",
            "Error of the right camera's rotation",
            "degrees",
        ),
        ("calib-views-time", "seconds", "Processor time", "s"),
    ] {
        let mut chart = Chart::new(title)
            .subtitle("one stereo camera, the same corners for both, 0.1 px noise; each point a recording")
            .x_axis(Axis::log("views", ""))
            .y_axis(Axis::log(title, unit));
        for (who, label) in [("ours", "ours"), ("opencv", "OpenCV")] {
            let points: Vec<(f64, f64)> =
                rows.iter().map(|r| (count(r), of(r, who, what))).collect();
            chart = chart.series(Series::scatter(label, points));
        }
        save(out, name, &chart)?;
    }
    let mut chart = Chart::new("Accuracy against time")
        .subtitle("one stereo camera, the same corners for both; labels are numbers of views")
        .x_axis(Axis::log("processor time", "s"))
        .y_axis(Axis::log("error of the right camera's position", "mm"));
    for (who, label) in [("ours", "ours"), ("opencv", "OpenCV")] {
        let points: Vec<(f64, f64)> = rows
            .iter()
            .map(|r| (of(r, who, "seconds"), of(r, who, "shift_mm")))
            .collect();
        let labels: Vec<String> = rows.iter().map(|r| format!("{}", count(r))).collect();
        chart = chart.series(Series::scatter(label, points).labels(labels));
    }
    save(out, "calib-time", &chart)?;

    let rows = models.as_array().map_or(&[][..], Vec::as_slice);
    let mut chart = Chart::new("Lens model chosen")
        .subtitle("1 is the usual distortion of the simulated cameras; corners have 0.1 px noise")
        .x_axis(Axis::linear("distortion, times the usual", ""))
        .y_axis(Axis::linear("coefficients of the model", "").include(0.0));
    let mut counts: Vec<u64> = rows.iter().filter_map(|r| r["views"].as_u64()).collect();
    counts.sort_unstable();
    counts.dedup();
    for count in counts {
        let own = rows.iter().filter(|r| r["views"].as_u64() == Some(count));
        let points: Vec<(f64, f64)> = own
            .clone()
            .map(|r| {
                let at = r["distortion"].as_f64().unwrap_or(f64::NAN);
                (at, r["coefficients"].as_f64().unwrap_or(f64::NAN))
            })
            .collect();
        let names: Vec<String> = own
            .map(|r| r["chosen"].as_str().unwrap_or("none fits").to_owned())
            .collect();
        chart = chart.series(Series::scatter(&format!("{count} views"), points).labels(names));
    }
    save(out, "calib-models", &chart)?;

    let mut kinds: Vec<(&str, &str)> = KINDS.iter().map(|k| (k.0, k.1)).collect();
    kinds.push(("exposure, rendered", "ms"));
    kinds.push(("image noise, rendered", "times the usual"));
    for (number, (kind, unit)) in kinds.into_iter().enumerate() {
        let own: Vec<&Point> = points.iter().filter(|p| p.kind == kind).collect();
        let mut chart = Chart::new(&format!("Error against {kind}"))
            .subtitle("worst rotation between cameras; results that were refused have no error and are not drawn")
            .x_axis(Axis::log(kind, unit))
            .y_axis(Axis::log("error", "degrees"))
            .hline(super::MAX_ERROR.1, "required");
        for (slot, verdict) in [Verdict::Ok, Verdict::Flagged, Verdict::SilentlyWrong]
            .into_iter()
            .enumerate()
        {
            let drawn = own.iter().filter(|p| p.verdict == verdict);
            let drawn = drawn.filter_map(|p| Some((p.strength, p.error?.1)));
            let drawn: Vec<(f64, f64)> = drawn.collect();
            chart = chart.series(Series::scatter(verdict.word(), drawn).slot(slot));
        }
        save(out, &format!("calib-trouble-{number}"), &chart)?;
    }
    Ok(())
}
