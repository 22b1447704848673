//! The Go2 at rest on exact parts in MuJoCo.

use std::path::Path;

use anyhow::Result;
use serde_json::{Value, json};

use super::values::{entries, modules};
use crate::python;

const SCRIPT: &str = "sim_physics/stand.py";

/// A row for each place: heights of the feet above the ground, height and tilt of the trunk beside
/// those on a plane of MuJoCo. `tread_m` is the height of the tread 0.9 m ahead.
///
/// # Errors
/// No interpreter with the robot.
pub(super) fn go2(stairs: &Path, tread_m: f64) -> Result<Vec<Value>> {
    let places = [
        json!({ "place": "mujoco plane", "model": null, "at": [0.0, 0.0], "ground_m": 0.0 }),
        json!({ "place": "plane", "model": stairs, "at": [-1.0, 0.2], "ground_m": 0.0 }),
        json!({ "place": "tread", "model": stairs, "at": [0.9, -0.3], "ground_m": tread_m }),
    ];
    let question = json!({ "modules": modules(), "jobs": places });
    let answer = python::ask_in(python::PHYSICS, SCRIPT, &question)?;
    let found = entries(&answer["jobs"]);
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or(f64::NAN);
    let rows = places.iter().zip(found).map(|(place, own)| {
        let from_plane = |key: &str| (number(own, key) - number(&found[0], key)).abs();
        json!({
            "place": place["place"],
            "body": "go2",
            "engine": "mujoco",
            "mujoco": answer["mujoco"],
            "go2": own,
            "from_plane": {
                "height_mm": from_plane("trunk_above_ground_mm"),
                "tilt_deg": from_plane("tilt_deg"),
            },
        })
    });
    Ok(rows.collect())
}
