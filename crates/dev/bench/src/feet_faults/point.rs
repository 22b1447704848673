//! A point: one fault of one strength on one walk.

use serde::Serialize;

use super::faults::SWEEPS;
use super::outcome::{Clean, FootScores, Outcome, outcome};
use super::stages::StageOutputs;
use super::walks::{WALKS, Walk};

/// Name of points without a fault.
pub(super) const NO_FAULT: &str = "no fault";
/// Name, unit and strength of these points.
pub(super) const NO_FAULT_POINT: (&str, &str, f64) = (NO_FAULT, "", 0.0);

/// One fault on one walk.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Point {
    pub(super) walk: &'static str,
    pub(super) fault: &'static str,
    pub(super) unit: &'static str,
    pub(super) strength: f64,
    pub(super) seconds: f64,
    pub(super) outcome: Outcome,
    /// Losses that the stages report.
    pub(super) losses: Vec<String>,
    pub(super) detections: usize,
    /// Of the left and the right foot.
    pub(super) feet: [FootScores; 2],
}

impl Point {
    /// In the order of the faults, walks and strengths.
    pub(super) fn place(&self) -> (Option<usize>, Option<usize>, f64, f64) {
        (
            SWEEPS.iter().position(|sweep| sweep.name == self.fault),
            WALKS.iter().position(|walk| walk.name == self.walk),
            self.strength.abs(),
            self.seconds,
        )
    }
}

/// `clean` is what is stated without a fault, and whether that is of the same walk.
pub(super) fn point(
    walk: &Walk,
    (fault, unit, strength): (&'static str, &'static str, f64),
    seconds: f64,
    feet: &[FootScores; 2],
    found: StageOutputs,
    (clean, is_same_walk): (&Clean, bool),
) -> Point {
    Point {
        walk: walk.name,
        fault,
        unit,
        strength,
        seconds,
        outcome: outcome(feet, clean, is_same_walk, &found.losses),
        losses: found.losses,
        detections: found.detections,
        feet: feet.clone(),
    }
}
