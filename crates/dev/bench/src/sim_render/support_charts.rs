//! Charts of the part `support`.

use charts::{Axis, Chart, Series};
use serde_json::Value;

use crate::report::{number, rows};

/// Borders of the steps in which predictions are drawn, dB.
const STEPS_DB: [f64; 5] = [12.0, 15.0, 18.0, 21.0, 24.0];

/// Predicted against real PSNR of the held-out views.
pub(super) fn held_out(part: &Value) -> Chart {
    let samples = rows(&part["held_out"]["samples"]).iter();
    let points = samples.map(|own| (number(&own["psnr_db"]), number(&own["predicted_db"])));
    let points: Vec<(f64, f64)> = points.collect();
    let ends = points.iter().flat_map(|(a, b)| [*a, *b]);
    let [low, high] = [f64::min, f64::max].map(|of| ends.clone().reduce(of).unwrap_or(0.0));
    Chart::new("Predicted PSNR of held-out views")
        .subtitle("from what the training saw; on the diagonal the prediction is right")
        .x_axis(Axis::linear("PSNR", "dB"))
        .y_axis(Axis::linear("predicted", "dB"))
        .series(Series::scatter("held-out views of the scene", points))
        .series(Series::line("right", [(low, low), (high, high)]))
}

/// The scene from above.
pub(super) fn map(part: &Value) -> Chart {
    let map = &part["map"];
    let pair = |own: &Value| (number(&own[0]), number(&own[1]));
    let of = |name: &str| rows(&map[name]).iter().map(pair).collect::<Vec<_>>();
    let limit_db = number(&map["min_support_db"]);
    let subtitle = format!(
        "mean of 8 headings, dB; starts have at least {limit_db} dB ahead, episodes end below"
    );
    let mut chart = Chart::new("Predicted PSNR of what an agent sees, from above")
        .subtitle(&subtitle)
        .x_axis(Axis::linear("x", "m"))
        .y_axis(Axis::linear("y", "m"));
    for step in 0..=STEPS_DB.len() {
        let from = step
            .checked_sub(1)
            .map_or(f64::NEG_INFINITY, |k| STEPS_DB[k]);
        let to = STEPS_DB.get(step).copied().unwrap_or(f64::INFINITY);
        let places = rows(&map["places_x_y_mean_best_db"]).iter();
        let own = places.filter(|own| (from..to).contains(&number(&own[2])));
        let points: Vec<(f64, f64)> = own.map(pair).collect();
        if points.is_empty() {
            continue;
        }
        let name = match (from.is_finite(), to.is_finite()) {
            (false, _) => format!("below {to}"),
            (_, false) => format!("above {from}"),
            _ => format!("{from} to {to}"),
        };
        chart = chart.series(Series::scatter(&name, points));
    }
    chart
        .series(Series::line("recorded path", of("path")))
        .series(Series::scatter("starts", of("starts")))
        .series(Series::scatter("ends", of("truncated")))
}
