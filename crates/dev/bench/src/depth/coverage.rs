//! Share of errors within two stated sigmas, in every quarter of the stated sigma.

use depth::DisparityMap;

use super::frames::Frame;

/// Parts of equal size, from the smallest to the largest sigma.
const PARTS: usize = 4;

/// Disparities whose error is known.
#[derive(Default)]
pub(crate) struct Coverage {
    /// Sigma and absolute error of each, px.
    errors: Vec<[f32; 2]>,
}

/// Share within two sigmas.
pub(crate) struct Shares {
    pub(crate) all: f64,
    /// In each quarter of the sigma, the smallest first.
    pub(crate) quarters: [f64; PARTS],
    /// px.
    pub(crate) median_sigma: f32,
}

impl Coverage {
    /// Adds the disparities of a map that both eyes see and whose truth is known.
    pub(crate) fn add(&mut self, map: &DisparityMap, frame: &Frame) {
        let known = (0..map.disparity.len()).filter(|i| frame.visible[*i]);
        let errors = known.map(|i| [map.sigma[i], (map.disparity[i] - frame.truth[i]).abs()]);
        self.errors
            .extend(errors.filter(|[_, error]| !error.is_nan()));
    }

    /// The shares.
    pub(crate) fn shares(mut self) -> Shares {
        self.errors.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
        let count = self.errors.len();
        let within = |part: &[[f32; 2]]| {
            let within = part.iter().filter(|[sigma, error]| *error <= 2.0 * sigma);
            within.count() as f64 / part.len().max(1) as f64
        };
        Shares {
            all: within(&self.errors),
            quarters: std::array::from_fn(|k| {
                within(&self.errors[k * count / PARTS..(k + 1) * count / PARTS])
            }),
            median_sigma: self.errors.get(count / 2).map_or(f32::NAN, |of| of[0]),
        }
    }
}
