//! Charts of `feet_faults`.

use charts::{Axis, Chart, Series, Span, Timeline};

use super::faults::{SWEEPS, Sweep};
use super::outcome::{FootScores, Outcome};
use super::point::{NO_FAULT, Point};
use super::walks::WALKS;

/// Names and texts of all charts.
pub(super) fn draw(points: &[Point], stamp: &str) -> Vec<(String, String)> {
    let errors = errors(points).footnote(stamp).to_svg(760, 480);
    vec![
        (
            "feet_faults-outcomes.svg".to_owned(),
            outcomes(points, stamp).to_svg(760),
        ),
        ("feet_faults-errors.svg".to_owned(), errors),
    ]
}

fn name(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Ok => "ok",
        Outcome::Flagged => "flagged",
        Outcome::SilentlyWrong => "silently wrong",
    }
}

/// A row per fault and walk, strengths from left to right.
fn outcomes(points: &[Point], stamp: &str) -> Timeline {
    let wrong = points
        .iter()
        .filter(|p| p.outcome == Outcome::SilentlyWrong);
    let subtitle = format!(
        "contacts and poses of the feet; {} of {} points silently wrong, 0 is the target",
        wrong.count(),
        points.len()
    );
    let chart = Timeline::new(
        "Outcome by fault and strength",
        Axis::linear("strength, from the least to the largest", "").include(4.0),
    );
    let chart = chart
        .subtitle(&subtitle)
        .footnote(stamp)
        .kinds(Outcome::ALL.map(name));
    let chart = WALKS.iter().fold(chart, |chart, walk| {
        row(chart, points, walk.name, (NO_FAULT, &[]), "")
    });
    SWEEPS.iter().fold(chart, |chart, sweep| {
        let note = note(sweep);
        WALKS.iter().fold(chart, |chart, walk| {
            let fault = (sweep.name, sweep.strengths);
            row(chart, points, walk.name, fault, &note)
        })
    })
}

/// Points of a fault on a walk at the places of their strengths, or side by side.
fn row(
    chart: Timeline,
    points: &[Point],
    walk: &str,
    (fault, strengths): (&str, &[f64]),
    note: &str,
) -> Timeline {
    let own = points.iter().filter(|p| p.walk == walk && p.fault == fault);
    let place = |point: &Point, order: usize| {
        let own = strengths.iter().position(|own| *own == point.strength);
        own.unwrap_or(order) as f64
    };
    let spans = own.enumerate().map(|(order, point)| Span {
        from: place(point, order) + 0.03,
        to: place(point, order) + 0.97,
        kind: Outcome::ALL
            .iter()
            .position(|own| *own == point.outcome)
            .unwrap_or(0),
    });
    let spans: Vec<Span> = spans.collect();
    match spans.is_empty() {
        true => chart,
        false => chart.row(&format!("{fault}, {walk}"), note, spans),
    }
}

/// Strengths with their unit.
fn note(sweep: &Sweep) -> String {
    match sweep.strengths {
        [_] => String::new(),
        all => {
            let all: Vec<String> = all.iter().map(f64::to_string).collect();
            format!("{} {}", all.join(", "), sweep.unit)
        }
    }
}

/// Largest errors of contacts, also in sigmas.
fn errors(points: &[Point]) -> Chart {
    let chart = Chart::new("Largest error of a contact's place, by outcome")
        .subtitle(
            "a point per fault, strength and walk; faults that are silently wrong are named once",
        )
        .x_axis(Axis::log("error", "m"))
        .y_axis(Axis::log("error in stated sigmas", ""))
        .hline(3.0, "3 sigmas");
    let mut named: Vec<&str> = Vec::new();
    let slots = [2, 0, 1];
    Outcome::ALL
        .into_iter()
        .zip(slots)
        .fold(chart, |chart, (outcome, slot)| {
            let own = points.iter().filter(|p| p.outcome == outcome);
            let own = own.filter(|p| p.feet.iter().any(|foot| foot.places.count > 0));
            let own: Vec<&Point> = own.collect();
            let most = |point: &Point, of: fn(&FootScores) -> f64| {
                point.feet.iter().map(of).fold(1e-4, f64::max)
            };
            let places = own.iter().map(|point| {
                let sigmas = most(point, |foot| foot.places.largest_sigmas);
                (most(point, |foot| foot.places.largest), sigmas)
            });
            let labels = own.iter().map(|point| {
                let is_new = outcome == Outcome::SilentlyWrong && !named.contains(&point.fault);
                if is_new {
                    named.push(point.fault);
                }
                if is_new { point.fault } else { "" }
            });
            let labels: Vec<&str> = labels.collect();
            chart.series(
                Series::scatter(name(outcome), places)
                    .slot(slot)
                    .labels(labels),
            )
        })
}
