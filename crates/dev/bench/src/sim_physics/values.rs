//! Values of the script, and the goal of contacts.

use serde_json::Value;

/// Farthest contact from the true surface, mm.
pub(super) const CONTACT_GOAL_MM: f64 = 10.0;

/// Entries of an array; none of anything else.
pub(super) fn entries(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}
