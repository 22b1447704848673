//! Charts of `odometry_faults`.

use charts::{Axis, Chart, Series};

use super::{Outcome, POINTS, Point, WALKS};

/// Names and texts of all charts.
pub(super) fn draw(points: &[Point], stamp: &str) -> Vec<(String, String)> {
    let mut files = Vec::new();
    let mut add = |name: &str, chart: Chart, height: u32| {
        let svg = chart.footnote(stamp).to_svg(760, height);
        files.push((format!("odometry_faults-{name}.svg"), svg));
    };
    add("outcomes", outcomes(points), 420);
    for (kind, strengths) in POINTS {
        let name = kind.name();
        if strengths.len() > 1 && points.iter().any(|p| p.kind == Some(name)) {
            add(name, curve(points, name, kind.unit()), 380);
        }
    }
    files
}

/// Number of points of each kind by outcome.
fn outcomes(points: &[Point]) -> Chart {
    let mut kinds = vec![None];
    kinds.extend(POINTS.map(|(kind, _)| Some(kind.name())));
    kinds.retain(|kind| points.iter().any(|p| p.kind == *kind));
    let names = kinds.iter().map(|kind| kind.unwrap_or("no fault"));
    let count = |outcome: Outcome| {
        let of = |kind: &Option<&str>| {
            let own = points
                .iter()
                .filter(|p| p.kind == *kind && p.outcome == outcome);
            own.count() as f64
        };
        kinds.iter().map(of).collect::<Vec<_>>()
    };
    let wrong: f64 = count(Outcome::SilentlyWrong).iter().sum();
    Chart::new("Outcome by fault type")
        .subtitle(&format!(
            "points of all strengths and walks; {wrong} of {} silently wrong, 0 is the target",
            points.len()
        ))
        .x_axis(Axis::categories("", names))
        .y_axis(Axis::linear("points", "").include(0.0))
        .series(Series::bars("ok", count(Outcome::Ok)).slot(2))
        .series(Series::bars("flagged", count(Outcome::Flagged)).slot(0))
        .series(Series::bars("silently wrong", count(Outcome::SilentlyWrong)).slot(1))
}

/// Error against strength, by outcome.
fn curve(points: &[Point], kind: &str, unit: &str) -> Chart {
    let chart = Chart::new(&format!("Error under a fault: {kind}"))
        .subtitle("largest error of the motion since the start of the fault; walks of 20 s, fault from 6 to 10 s")
        .x_axis(Axis::linear("strength", unit).include(0.0))
        .y_axis(Axis::log("error", "m"));
    WALKS.into_iter().fold(chart, |chart, walk| {
        let own = points
            .iter()
            .filter(|p| p.walk == walk && (p.kind == Some(kind) || p.kind.is_none()));
        let own: Vec<&Point> = own.collect();
        let labels = own.iter().map(|p| match p.outcome {
            Outcome::Ok => "ok",
            Outcome::Flagged => "flagged",
            Outcome::SilentlyWrong => "WRONG",
        });
        let labels: Vec<&str> = labels.collect();
        chart.series(Series::line(walk, own.iter().map(|p| (p.strength, p.off_m))).labels(labels))
    })
}
