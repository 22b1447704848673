//! Standard deviation of disparities.
//!
//! Contract: the sigma of a disparity is half of the 95 % quantile of the error of disparities with
//! the same evidence. [`Evidence`] has six components, and the logarithm of the error is the sum
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
    /// Fraction of pixels in the neighborhood that have a consistent disparity.
    pub density: f32,
    /// Difference from the disparity of the matched pixel of the right image, px.
    pub lr_difference_px: f32,
    /// Correlation of the two images in the neighborhood.
    pub correlation: f32,
}

/// Number of components of the evidence.
const KINDS: usize = 6;
/// Number of those of a single pixel, which are the first; the others are of its neighborhood.
const PIXEL_KINDS: usize = 3;
/// Place of the left-right difference among them.
const LR_DIFFERENCE: usize = 2;
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
    pub(crate) fn new(
        paths: Paths,
        winner: &Winner,
        lr_difference_px: u8,
        near: Neighborhood,
        correlation: f32,
    ) -> Self {
        let [second_best_margin, cost_slope] = distinctness(paths, winner);
        let of_pixel = Self {
            second_best_margin,
            cost_slope,
            lr_difference_px: f32::from(lr_difference_px),
            ..Self::default()
        };
        of_pixel.with_neighborhood(near, correlation)
    }

    fn with_neighborhood(self, near: Neighborhood, correlation: f32) -> Self {
        Self {
            disparity_range_px: near.max - near.min,
            density: f32::from(near.found) / f32::from(near.all.max(1)),
            correlation,
            ..self
        }
    }

    fn kinds(&self) -> [f32; KINDS] {
        [
            self.second_best_margin,
            self.cost_slope,
            self.lr_difference_px,
            self.disparity_range_px,
            self.density,
            self.correlation,
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
    /// let clear = Evidence {
    ///     second_best_margin: 5.0,
    ///     cost_slope: 3.0,
    ///     disparity_range_px: 0.5,
    ///     density: 1.0,
    ///     lr_difference_px: 0.0,
    ///     correlation: 0.95,
    /// };
    /// let ambiguous =
    ///     Evidence { second_best_margin: 0.1, cost_slope: 0.1, density: 0.4, ..clear };
    /// assert!(model.sigma_px(&clear) < 0.5);
    /// assert!(model.sigma_px(&ambiguous) > 3.0 * model.sigma_px(&clear));
    /// ```
    pub fn sigma_px(&self, evidence: &Evidence) -> f32 {
        let logs = self.logs_of(evidence);
        let [of_pixel, of_neighborhood] = [&logs[..PIXEL_KINDS], &logs[PIXEL_KINDS..]];
        sigma_px(of_pixel.iter().sum(), of_neighborhood.iter().sum())
    }

    fn logs_of(&self, evidence: &Evidence) -> [f32; KINDS] {
        let kinds = evidence.kinds();
        std::array::from_fn(|kind| self.log(kind, kinds[kind]))
    }

    /// Logarithm of a component. Unknown evidence is as weak as any.
    fn log(&self, kind: usize, value: f32) -> f32 {
        let logs = &self.logs[kind];
        match value.is_nan() {
            true => logs.iter().copied().fold(f32::NEG_INFINITY, f32::max),
            false => logs[class(&self.edges[kind], value)],
        }
    }

    /// Logarithms that all pixels of a neighborhood share.
    pub(crate) fn neighborhood_log(&self, near: Neighborhood, correlation: f32) -> f32 {
        let evidence = Evidence::default().with_neighborhood(near, correlation);
        self.logs_of(&evidence)[PIXEL_KINDS..].iter().sum()
    }

    /// Logarithm of each left-right difference.
    pub(crate) fn lr_logs(&self) -> Vec<f32> {
        let differences = u8::MIN..=u8::MAX;
        differences
            .map(|difference| self.log(LR_DIFFERENCE, f32::from(difference)))
            .collect()
    }

    /// Sigma of a disparity in a neighborhood with this logarithm, px; that of its left-right
    /// difference is `lr_log`. The same as [`Model::sigma_px`].
    pub(crate) fn sigma_in_px(
        &self,
        paths: Paths,
        winner: &Winner,
        lr_log: f32,
        neighborhood_log: f32,
    ) -> f32 {
        let [margin, slope] = distinctness(paths, winner);
        let logs = [
            self.logs[0][class(&self.edges[0], margin)],
            self.logs[1][class(&self.edges[1], slope)],
            lr_log,
        ];
        sigma_px(logs.iter().sum(), neighborhood_log)
    }
}

/// Margin of the second-best cost and slope of the cost, relative to the best cost.
fn distinctness(paths: Paths, winner: &Winner) -> [f32; 2] {
    let count = match paths {
        Paths::Three => 3.0,
        Paths::Four => 4.0,
        Paths::Eight => 8.0,
    };
    let best = f32::from(winner.least);
    let [before, behind] = winner.beside.map(|sum| f32::from(sum) - best);
    let whole = best + COST_OFFSET_PER_PATH * count;
    [
        (f32::from(winner.second) - best) / whole,
        before.max(behind) / whole,
    ]
}

/// Sigma from the logarithms of the components, px.
fn sigma_px(of_pixel: f32, of_neighborhood: f32) -> f32 {
    let quantile = (of_pixel + of_neighborhood).exp();
    0.5 * (quantile - MIN_ERROR_PX).max(MIN_ERROR_PX)
}

/// Class of a value that is not NaN.
fn class(edges: &[f32; CLASSES - 1], value: f32) -> usize {
    // Branch-free: there are few edges, and the values are unpredictable.
    edges.iter().map(|edge| usize::from(value >= *edge)).sum()
}

#[cfg(test)]
mod tests;
