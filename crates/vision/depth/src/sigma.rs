//! How far a disparity may be off.
//!
//! Contract: a disparity's sigma is half of that error which 95 % of the disparities that look alike stay below. What looks alike is
//! told by four things ([`Evidence`]); the logarithm of the error is the sum of one number for each of them ([`Model`]).
//! So a sigma is honest about heavy tails: where one in ten is far off, it is large.
//!
//! The tables of the presets were fitted on simulated walks; `docs/depth.md` says how well they hold on others. Who has truth of
//! his own can fit a model to it: [`Model::fit`].

mod fit;
mod tables;

pub use fit::Sample;

use crate::aggregation::{Paths, Winner};
use crate::correlation::Neighborhood;

/// What there is to judge a disparity by.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// How much more the second best costs, as a ratio of the best.
    pub second_best_margin: f32,
    /// How steeply costs rise beside the best, as a ratio of it.
    pub cost_slope: f32,
    /// Greatest less least disparity around the pixel, px.
    pub disparity_range_px: f32,
    /// Share of pixels around it that have a disparity.
    pub density: f32,
}

/// Kinds of evidence.
const KINDS: usize = 4;
/// Classes of each.
const CLASSES: usize = 10;

/// Logarithms of errors, one for each class of each kind of evidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Where classes end; the last one does not.
    edges: [[f32; CLASSES - 1]; KINDS],
    /// What a class adds to the logarithm of the error of 95 %.
    logs: [[f32; CLASSES]; KINDS],
}

/// Errors are not told apart below this, px: the logarithm is that of the error and this.
const MIN_ERROR_PX: f32 = 0.05;
/// What the ratios of costs add to the best cost, for each path, so that a best of 0 has one.
const COST_OFFSET_PER_PATH: f32 = 2.5;

impl Evidence {
    pub(crate) fn new(paths: Paths, winner: &Winner, near: Neighborhood) -> Self {
        let count = match paths {
            Paths::Three => 3.0,
            Paths::Four => 4.0,
            Paths::Eight => 8.0,
        };
        let best = f32::from(winner.least);
        let [before, behind] = winner.beside.map(|sum| f32::from(sum) - best);
        let whole = best + COST_OFFSET_PER_PATH * count;
        Self {
            second_best_margin: (f32::from(winner.second) - best) / whole,
            cost_slope: before.max(behind) / whole,
            disparity_range_px: near.max - near.min,
            density: f32::from(near.found) / f32::from(near.all.max(1)),
        }
    }

    fn kinds(&self) -> [f32; KINDS] {
        [
            self.second_best_margin,
            self.cost_slope,
            self.disparity_range_px,
            self.density,
        ]
    }
}

impl Model {
    /// The model of disparities that so many paths lead to.
    pub fn of(paths: Paths) -> &'static Self {
        match paths {
            Paths::Three => &tables::THREE,
            Paths::Four | Paths::Eight => &tables::EIGHT,
        }
    }

    /// The sigma of a disparity, px.
    pub fn sigma_px(&self, evidence: &Evidence) -> f32 {
        let mut log = 0.0;
        for (kind, value) in evidence.kinds().into_iter().enumerate() {
            log += self.logs[kind][class(&self.edges[kind], value)];
        }
        0.5 * (log.exp() - MIN_ERROR_PX).max(MIN_ERROR_PX)
    }
}

/// The class that a value is in. Not a number is in the last one.
fn class(edges: &[f32; CLASSES - 1], value: f32) -> usize {
    // Without a branch: few edges, and values that nobody can predict.
    edges.iter().map(|edge| usize::from(value >= *edge)).sum()
}

#[cfg(test)]
mod tests;
