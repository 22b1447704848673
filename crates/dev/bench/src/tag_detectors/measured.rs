//! What is measured on simulated images.

use serde::Serialize;

use super::conditions::Condition;
use super::scores::Score;

/// Scores under a condition.
#[derive(Debug, Serialize)]
pub(super) struct Point {
    pub(super) condition: Condition,
    pub(super) scores: Vec<Score>,
}

/// The value of a sweep's variable, and the point of it.
#[derive(Debug, Serialize)]
pub(super) struct Step {
    pub(super) variable: &'static str,
    pub(super) value: f64,
    /// Index among the points.
    pub(super) point: usize,
}

/// What is measured on simulated images.
#[derive(Debug, Default, Serialize)]
pub(super) struct Measurements {
    pub(super) versions: Vec<String>,
    pub(super) points: Vec<Point>,
    pub(super) steps: Vec<Step>,
    /// Images without a tag: all that is reported is wrong.
    pub(super) without_tag: Vec<Score>,
}
