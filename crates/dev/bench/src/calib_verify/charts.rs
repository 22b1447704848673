//! Charts of `calib_verify`.

use calib::verify::Parameter;
use charts::{Axis, Bins, Chart, Series};

use super::{Clean, Point, ROTATIONS_DEG, STEREO_ROTATIONS_DEG, TIME_OFFSETS_MS, counts};

/// Names and texts of all charts.
pub(super) fn draw(clean: &[Clean], points: &[Point], stamp: &str) -> Vec<(String, String)> {
    let mut files = Vec::new();
    let mut add = |name: &str, chart: Chart| {
        let svg = chart.footnote(stamp).to_svg(760, 380);
        files.push((format!("calib_verify-{name}.svg"), svg));
    };
    let turn = || Axis::log("rotation", "\u{b0}");
    let delay = || Axis::log("time offset", "ms");
    add(
        "rotated",
        curve(
            "A camera rotated on the plate",
            points,
            Parameter::Camera,
            &ROTATIONS_DEG,
            turn(),
        ),
    );
    add(
        "eyes",
        curve(
            "A right camera rotated",
            points,
            Parameter::StereoRotation,
            &STEREO_ROTATIONS_DEG,
            turn(),
        ),
    );
    add(
        "images",
        curve(
            "Images stamped late",
            points,
            Parameter::ImageTime,
            &TIME_OFFSETS_MS,
            delay(),
        ),
    );
    add(
        "clock",
        curve(
            "Time offset of a camera's clock",
            points,
            Parameter::Clock,
            &TIME_OFFSETS_MS,
            delay(),
        ),
    );
    add("scores", scores(clean));
    add("bursts", bursts(clean));
    files
}

/// Ratio of each outcome against the size of the error.
fn curve(title: &str, points: &[Point], what: Parameter, sizes: &[f64], axis: Axis) -> Chart {
    let names = [
        "named",
        "flagged",
        "undetermined",
        "below the minimum detectable error",
        "silent",
    ];
    let walks = points
        .iter()
        .filter(|p| p.what == what && p.size == sizes[0])
        .count();
    let mut chart = Chart::new(title)
        .subtitle(&format!("{walks} points each"))
        .x_axis(axis)
        .y_axis(Axis::linear("share", "%").include(0.0).include(100.0));
    for (k, name) in names.iter().enumerate() {
        let share = |size: &f64| {
            let counts = counts(points, what, *size);
            let all: usize = counts.iter().sum();
            (*size, 100.0 * counts[k] as f64 / all.max(1) as f64)
        };
        chart = chart.series(Series::line(name, sizes.iter().map(share)));
    }
    chart
}

/// Errors over their sigmas.
fn scores(clean: &[Clean]) -> Chart {
    let mut chart = Chart::new("Errors over their stated sigmas, clean walks")
        .x_axis(Axis::linear("error over sigma", ""))
        .y_axis(Axis::linear("count", "").include(0.0));
    for (k, name) in ["stereo", "camera against IMU", "image time"]
        .iter()
        .enumerate()
    {
        let values = clean.iter().flat_map(|c| c.scores[k].iter().copied());
        let values: Vec<f64> = values.map(|v| v.clamp(-8.0, 8.0)).collect();
        chart = chart.series(Series::histogram(name, values, Bins::Count(40)));
    }
    chart
}

/// Median sigma against the number of bursts.
fn bursts(clean: &[Clean]) -> Chart {
    let mut chart = Chart::new("Sigma against the number of bursts")
        .subtitle("median over walks and cameras; each burst is 16 images per camera")
        .x_axis(Axis::linear("bursts", "").include(0.0))
        .y_axis(Axis::log("sigma", ""));
    for (value, name) in [(0, "rotation against IMU, \u{b0}"), (1, "image time, ms")] {
        let median = |part: usize| {
            let of = |c: &Clean| {
                c.by_bursts[part]
                    .iter()
                    .map(|s| s[value])
                    .collect::<Vec<_>>()
            };
            let mut values: Vec<f64> = clean
                .iter()
                .flat_map(of)
                .filter(|v| v.is_finite())
                .collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
        };
        let points = [(2.0, median(2)), (4.0, median(1)), (8.0, median(0))];
        chart = chart.series(Series::line(name, points));
    }
    chart
}
