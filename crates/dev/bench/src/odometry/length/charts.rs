//! Charts of `odometry_length`.

use charts::{Axis, Chart, Series};

use super::{Adjustment, Minute};

/// Names and texts of all charts.
pub(super) fn draw(
    walk: &str,
    minutes: &[Minute],
    marks: &[Adjustment],
    stamp: &str,
) -> Vec<(String, String)> {
    let mut files = Vec::new();
    let mut add = |name: &str, chart: Chart| {
        let svg = chart.footnote(stamp).to_svg(760, 360);
        files.push((format!("odometry_length-{name}.svg"), svg));
    };
    let subtitle = format!("{walk}: three stereo cameras of 336x188 per eye at 15 Hz, balanced");
    let over = |of: &dyn Fn(&Minute) -> f64| -> Vec<(f64, f64)> {
        minutes.iter().map(|m| (m.minute as f64, of(m))).collect()
    };
    let chart = |title: &str| Chart::new(title).subtitle(&subtitle);
    add(
        "time",
        chart("Time of causal poses for each minute of recording")
            .x_axis(Axis::linear("minute of the recording", ""))
            .y_axis(Axis::linear("time for a minute", "s").include(0.0))
            .series(Series::line("wall time", over(&|m| m.wall_s)))
            .series(Series::line(
                "processor time of all threads",
                over(&|m| m.cpu_s),
            )),
    );
    add(
        "memory",
        chart("Memory of causal poses")
            .x_axis(Axis::linear("minute of the recording", ""))
            .y_axis(Axis::linear("memory of odometry", "MB").include(0.0))
            .series(Series::line("", over(&|m| m.memory_mb))),
    );
    let whole = |of: &dyn Fn(&Adjustment) -> f64| -> Vec<(f64, f64)> {
        marks.iter().map(|m| (m.minutes as f64, of(m))).collect()
    };
    let length = || Axis::log("length of the recording", "min");
    add(
        "adjusting",
        chart("Time of the bundle adjustment at the end")
            .x_axis(length())
            .y_axis(Axis::log("time", "s"))
            .series(Series::line("wall time", whole(&|m| m.wall_s)))
            .series(Series::line("processor time", whole(&|m| m.cpu_s))),
    );
    add(
        "adjusting-memory",
        chart("Memory of the bundle adjustment at the end")
            .x_axis(length())
            .y_axis(Axis::log("memory", "MB"))
            .series(Series::line(
                "peak, including keyframes",
                whole(&|m| m.peak_mb),
            )),
    );
    let percent = |p: Option<f64>| p.unwrap_or(f64::NAN);
    add(
        "error",
        chart("Error over the length of the recording")
            .x_axis(length())
            .y_axis(Axis::log("ATE", "% of path length"))
            .series(Series::line(
                "causal poses",
                whole(&|m| percent(m.causal.ate_percent)),
            ))
            .series(Series::line(
                "adjusted",
                whole(&|m| percent(m.adjusted.ate_percent)),
            )),
    );
    files
}
