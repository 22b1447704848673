//! Charts of the results.

use charts::{Axis, Chart, Series};

use super::measured::{Measurements, Step};
use super::scores::Score;

const SIZE: [u32; 2] = [1200, 420];

/// Sweeps with several points, and how their values are written.
const SWEEPS: [(&str, &str); 4] = [
    ("size", " px"),
    ("tilt", "°"),
    ("motion", " cells"),
    ("noise", " lv"),
];
const CONDITIONS: &str =
    "one variable at a time around 20 px, 17°, no motion, noise of 3 gray levels";

/// Name and SVG of every chart.
pub(super) fn draw(measured: &Measurements, stamp: &str) -> Vec<(String, String)> {
    let methods = measured.methods();
    let recall = Chart::new("Tags found")
        .subtitle(CONDITIONS)
        .y_axis(Axis::linear("found", "%").include(0.0).include(100.0));
    let corners = Chart::new("Errors of corners")
        .subtitle(&format!(
            "RMS over the tags that a method finds; {CONDITIONS}"
        ))
        .y_axis(Axis::log("error", "px"));
    let charts = [
        (
            "recall",
            over_sweeps(measured, &methods, recall, Score::recall_percent),
        ),
        (
            "corners",
            over_sweeps(measured, &methods, corners, |score| score.corner_rms_px),
        ),
        ("time", time(measured, &methods)),
    ];
    let svg = |(name, chart): (&str, Chart)| {
        let chart = chart.footnote(stamp);
        let name = format!("tag_detectors-{name}.svg");
        (name, chart.to_svg(SIZE[0], SIZE[1]))
    };
    charts.into_iter().map(svg).collect()
}

impl Measurements {
    /// Names of the methods.
    fn methods(&self) -> Vec<&str> {
        let first = self.points.first();
        let scores = first.into_iter().flat_map(|point| &point.scores);
        scores.map(|score| &score.method[..]).collect()
    }

    fn score(&self, step: &Step, method: &str) -> Option<&Score> {
        let mut scores = self.points[step.point].scores.iter();
        scores.find(|score| score.method == method)
    }
}

/// Values of all sweeps side by side: a line for each method, with a gap between sweeps.
fn over_sweeps(
    measured: &Measurements,
    methods: &[&str],
    chart: Chart,
    value: impl Fn(&Score) -> f64,
) -> Chart {
    let steps: Vec<(&Step, &str)> = SWEEPS
        .iter()
        .flat_map(|(variable, unit)| {
            let steps = measured.steps.iter();
            let own = steps.filter(move |step| step.variable == *variable);
            own.map(move |step| (step, *unit))
        })
        .collect();
    let names = steps
        .iter()
        .map(|(step, unit)| format!("{}{unit}", step.value));
    let chart = chart.x_axis(Axis::categories("", names));
    methods.iter().fold(chart, |chart, method| {
        let mut points = Vec::new();
        for (n, (step, _)) in steps.iter().enumerate() {
            if n > 0 && steps[n - 1].0.variable != step.variable {
                points.push(charts::BREAK);
            }
            let score = measured.score(step, method);
            points.push((n as f64, score.map_or(f64::NAN, &value)));
        }
        chart.series(Series::line(method, points))
    })
}

/// Processor time of an image, by its width.
fn time(measured: &Measurements, methods: &[&str]) -> Chart {
    let is_width = |step: &&Step| step.variable == "image_width";
    let steps: Vec<&Step> = measured.steps.iter().filter(is_width).collect();
    let names = steps.iter().map(|step| match step.value {
        672.0 => "672 x 376",
        _ => "1280 x 720",
    });
    let chart = Chart::new("Processor time of an image")
        .subtitle("median, one thread; the fit reads what is around one tag, the others all of it")
        .x_axis(Axis::categories("", names))
        .y_axis(Axis::linear("time", "ms").include(0.0))
        .hline(GOAL_MS, "goal of the search at 672 x 376");
    methods.iter().fold(chart, |chart, method| {
        let value = |step: &&Step| measured.score(step, method).map_or(f64::NAN, |own| own.ms);
        chart.series(Series::bars(method, steps.iter().map(value)))
    })
}

/// Goal of the search in an image of 672 x 376, ms.
const GOAL_MS: f64 = 3.0;
