//! Charts of `odometry_calibration`.

use charts::{Axis, Chart, Series};

use super::{POINTS, Point, PoseErrors};

const WIDTH: u32 = 760;
const HEIGHT: u32 = 400;

/// One chart per kind of deviation, and one of all of them in stated sigmas.
pub(super) fn draw(points: &[Point], stamp: &str) -> Vec<(String, String)> {
    let mut files: Vec<(String, String)> = POINTS
        .iter()
        .filter_map(|(kind, _)| {
            let chart = errors(points, kind.name(), kind.unit())?.footnote(stamp);
            let name = format!("odometry_calibration-{}.svg", kind.name());
            Some((name, chart.to_svg(WIDTH, HEIGHT)))
        })
        .collect();
    let chart = in_sigmas(points).footnote(stamp);
    let name = "odometry_calibration-sigmas.svg".to_owned();
    files.push((name, chart.to_svg(WIDTH, HEIGHT)));
    files
}

/// Points of a kind, with those of the exact calibration.
fn of<'a>(points: &'a [Point], kind: &str) -> Vec<&'a Point> {
    let mut all: Vec<&Point> = points
        .iter()
        .filter(|p| p.kind.is_none_or(|k| k == kind))
        .collect();
    all.sort_by(|a, b| a.strength.total_cmp(&b.strength));
    all
}

/// Strengths in order, with the median of a value over walks and rigs.
fn medians(points: &[&Point], value: impl Fn(&Point) -> Option<f64>) -> Vec<(f64, f64)> {
    let groups = points.chunk_by(|a, b| a.strength == b.strength);
    groups
        .filter_map(|group| {
            let mut values: Vec<f64> = group.iter().filter_map(|p| value(p)).collect();
            values.sort_by(f64::total_cmp);
            let median = values.get(values.len() / 2)?;
            Some((group[0].strength, *median))
        })
        .collect()
}

fn errors(points: &[Point], kind: &str, unit: &str) -> Option<Chart> {
    let mut points = of(points, kind);
    points.iter().find(|p| p.kind.is_some())?;
    // Without an IMU the stated sigma is that of the tilt of the world, some 19 % of the path.
    points.retain(|p| p.with_imu());
    let name = kind.replace('_', " ");
    let mut chart = Chart::new(&format!(
        "Error and stated sigma over the error of the {name}"
    ))
    .subtitle("median over simulated walks of 20 s, one and three cameras, with IMU")
    .x_axis(Axis::linear(&format!("error of the {name}"), unit).include(0.0))
    .y_axis(Axis::linear("position", "% of path length").include(0.0));
    type Pick = fn(&Point) -> &PoseErrors;
    let both: [(&str, Pick); 2] = [("causal", |p| &p.causal), ("refined", |p| &p.refined)];
    for (poses, pick) in both {
        let error = medians(&points, |p| pick(p).figures.ate_percent);
        let sigma = medians(&points, |p| pick(p).sigma_percent);
        chart = chart
            .series(Series::line(&format!("error, {poses}"), error))
            .series(Series::line(&format!("stated sigma, {poses}"), sigma));
    }
    Some(chart)
}

/// Largest root mean square error in stated sigmas over walks and rigs, by strength relative to the
/// strongest.
fn in_sigmas(points: &[Point]) -> Chart {
    let mut chart = Chart::new("Errors in stated sigmas over errors of the stereo calibration")
        .subtitle("worst of walks and rigs, causal and refined, position and rotation")
        .x_axis(Axis::linear("strength relative to the largest", "").include(0.0))
        .y_axis(Axis::linear("root mean square error", "stated sigmas").include(0.0))
        .hline(1.0, "right");
    for (kind, strengths) in POINTS {
        let points = of(points, kind.name());
        let largest = strengths[strengths.len() - 1];
        let groups = points.chunk_by(|a, b| a.strength == b.strength);
        let worst = groups.map(|group| {
            let figures = group
                .iter()
                .flat_map(|p| [&p.causal.figures, &p.refined.figures]);
            let worst = figures.filter_map(|f| f.sigmas).flatten();
            (group[0].strength / largest, worst.fold(0.0, f64::max))
        });
        chart = chart.series(Series::line(&kind.name().replace('_', " "), worst));
    }
    chart
}
