//! Values of the scripts, where their modules are, and goals.

use std::path::{Path, PathBuf};

use serde_json::Value;

/// Feet go this far from footprints, m.
pub(super) const FEET_REACH_M: f64 = 0.6;

/// Surfaces farther from the true ground belong to another level, m.
pub(super) const LEVEL_M: f64 = 0.4;

/// Farthest contact from the true surface, mm.
pub(super) const CONTACT_GOAL_MM: f64 = 10.0;

/// Share of the places of feet at which a shape may hold a foot that the truth does not hold.
/// Source: reference page of the simulators, 3.9.
pub(super) const FALSE_SUPPORT_GOAL: f64 = 0.001;

/// Largest error of the height of a body at rest on a plane, mm.
pub(super) const REST_GOAL_MM: f64 = 2.0;

/// Entries of an array; none of anything else.
pub(super) fn entries(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// Where the Python package `paws_sim` has its modules.
pub(super) fn modules() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../simulation/python/python/paws_sim")
}
