//! Errors of one trajectory as a row of a table: ATE, scale, consistency.

use reconstruction::evaluate::{Alignment, Settings, evaluate};
use scene_bundle::{Status, Trajectory};
use serde_json::{Value, json};

/// Head of the columns of [`columns`].
pub(crate) const HEAD: &str = "ATE, mm | largest, mm | rotation, ° | scale error, % | NEES position | NEES rotation | silently wrong | tracked";
/// Separators of [`HEAD`].
pub(crate) const RULE: &str = "---|---|---|---|---|---|---|---";

/// Errors against the ground truth, of the best fit without scale. The scale error is positive if
/// the estimate is too long. NEES is over its dimensions: 1 is right. *Silently wrong* are tracked
/// poses beyond three stated sigmas in position or rotation, aligned by the first pose.
pub(crate) fn errors(trajectory: &Trajectory, truth: &Trajectory) -> Value {
    let found = evaluate(trajectory, truth, &Settings::default());
    let scaled = Settings {
        alignment: Alignment::Sim3,
        ..Settings::default()
    };
    let scale = evaluate(trajectory, truth, &scaled).true_from_estimated;
    let absolute = found.absolute.as_ref();
    let consistency = found.consistency.as_ref();
    let tracked = (trajectory.poses().iter())
        .filter(|p| matches!(p.status, Status::Tracked | Status::Relocalised));
    json!({
        "path_m": found.path_m,
        "ate_m": absolute.map(|a| a.translation_m.rmse),
        "largest_m": absolute.map(|a| a.translation_m.max),
        "rotation_deg": absolute.and_then(|a| a.rotation_rad).map(|r| r.rmse.to_degrees()),
        "scale_percent": scale.map(|s| 100.0 * (1.0 / s.scale - 1.0)),
        "nees_position": consistency.map(|c| c.nees_translation / 3.0),
        "nees_rotation": consistency.map(|c| c.nees_rotation / 3.0),
        "sharpness_position": consistency.map(|c| c.sharpness_translation),
        "sharpness_rotation": consistency.map(|c| c.sharpness_rotation),
        "silently_wrong": consistency.map(|c| c.silently_wrong - c.silently_wrong_dead_reckoned),
        "compared": consistency.map(|c| c.count),
        "tracked": tracked.count(),
        "poses": trajectory.poses().len(),
    })
}

/// The errors as columns under [`HEAD`], ready to go between bars.
pub(crate) fn columns(errors: &Value) -> String {
    let number = |key: &str, by: f64, digits: usize| {
        let value = errors[key].as_f64();
        value.map_or("—".to_owned(), |v| format!("{:.digits$}", by * v))
    };
    [
        number("ate_m", 1e3, 1),
        number("largest_m", 1e3, 1),
        number("rotation_deg", 1.0, 2),
        number("scale_percent", 1.0, 2),
        number("nees_position", 1.0, 2),
        number("nees_rotation", 1.0, 2),
        format!("{} of {}", errors["silently_wrong"], errors["compared"]),
        format!("{} of {}", errors["tracked"], errors["poses"]),
    ]
    .join(" | ")
}
