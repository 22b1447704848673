//! Standard deviation of disparities.
//!
//! Contract: the sigma of a disparity is half of the 95 % quantile of the error of disparities with
//! the same evidence. [`Evidence`] has four components, and the logarithm of the error is the sum
//! of one table entry for each of them ([`Model`]). The sigma therefore covers heavy tails: it is
//! large where one in ten disparities has a large error.
//!
//! The tables of the presets were fitted on simulated walks; `docs/reference/depth.md` gives their
//! coverage on other data. [`Model::fit`] fits a model to other ground truth.

mod fit;
mod tables;

pub use fit::Sample;

use crate::aggregation::{Paths, Winner};
use crate::correlation::Neighborhood;

/// Measurements from which the sigma of a disparity is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Excess of the second-best cost over the best, relative to the best cost.
    pub second_best_margin: f32,
    /// Larger cost increase to an adjacent disparity, relative to the best cost.
    pub cost_slope: f32,
    /// Maximum minus minimum disparity in the neighborhood of the pixel, px.
    pub disparity_range_px: f32,
    /// Fraction of pixels in the neighborhood that have a disparity.
    pub density: f32,
}

/// Number of components of the evidence.
const KINDS: usize = 4;
/// Number of classes of each component.
const CLASSES: usize = 10;

/// Additive model of the logarithm of the error: one entry for each class of each component of the
/// evidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Upper edges of the classes; the last class is unbounded.
    edges: [[f32; CLASSES - 1]; KINDS],
    /// Contribution of a class to the logarithm of the 95 % quantile of the error.
    logs: [[f32; CLASSES]; KINDS],
}

/// Resolution of errors, px: it is added to the error before the logarithm is taken.
const MIN_ERROR_PX: f32 = 0.05;
/// Offset per path that is added to the best cost in the ratios, so that they are defined for a
/// best cost of 0.
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
    /// Model for disparities of these aggregation paths.
    pub fn of(paths: Paths) -> &'static Self {
        match paths {
            Paths::Three => &tables::THREE,
            Paths::Four | Paths::Eight => &tables::EIGHT,
        }
    }

    /// Sigma of a disparity, px.
    ///
    /// ```
    /// use depth::Paths;
    /// use depth::sigma::{Evidence, Model};
    ///
    /// let model = Model::of(Paths::Eight);
    /// let clear = Evidence { second_best_margin: 5.0, cost_slope: 3.0, disparity_range_px: 0.5, density: 1.0 };
    /// let ambiguous = Evidence { second_best_margin: 0.1, cost_slope: 0.1, disparity_range_px: 8.0, density: 0.4 };
    /// assert!(model.sigma_px(&clear) < 0.5);
    /// assert!(model.sigma_px(&ambiguous) > 3.0 * model.sigma_px(&clear));
    /// ```
    pub fn sigma_px(&self, evidence: &Evidence) -> f32 {
        let mut log = 0.0;
        for (kind, value) in evidence.kinds().into_iter().enumerate() {
            log += self.logs[kind][class(&self.edges[kind], value)];
        }
        0.5 * (log.exp() - MIN_ERROR_PX).max(MIN_ERROR_PX)
    }
}

/// Class of a value. NaN is in the first class.
fn class(edges: &[f32; CLASSES - 1], value: f32) -> usize {
    // Branch-free: there are few edges, and the values are unpredictable.
    edges.iter().map(|edge| usize::from(value >= *edge)).sum()
}

#[cfg(test)]
mod tests;
