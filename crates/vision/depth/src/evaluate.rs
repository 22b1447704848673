//! Accuracy of a disparity map against ground truth.
//!
//! Contract: only pixels that are visible in both images and have ground truth are counted. A map
//! without disparities in difficult areas has a low error ratio among its disparities
//! ([`Scores::bad_ratio`]), so that this ratio is always reported with the density, and
//! [`Scores::bad_ratio_of_all`] counts absent pixels as errors.

use crate::error::DepthError;
use crate::map::DisparityMap;

/// Ground truth of a left image; row-major.
#[derive(Clone, Copy, Debug)]
pub struct GroundTruth<'a> {
    /// Disparity, px; NaN where unknown.
    pub disparity: &'a [f32],
    /// Whether the same point is visible in the right image.
    pub visible: &'a [bool],
}

/// Error thresholds of bad pixels, px.
pub const BAD_PX: [f32; 4] = [0.5, 1.0, 2.0, 3.0];

/// Counts of an evaluation, from which the ratios follow; those of several images can be added.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scores {
    /// Number of evaluated pixels.
    pub pixels: u64,
    /// Evaluated pixels with a disparity.
    pub found: u64,
    /// Pixels with an error above each of [`BAD_PX`].
    pub bad: [u64; BAD_PX.len()],
    /// Sum of absolute errors of the pixels with a disparity, px.
    pub error_px: f64,
    /// Pixels with an error of at most two sigma.
    pub within_two_sigma: u64,
}

impl Scores {
    /// Compares a map with ground truth.
    ///
    /// # Errors
    /// [`DepthError::Size`] if their sizes differ.
    ///
    /// ```
    /// use depth::DisparityMap;
    /// use depth::evaluate::{BAD_PX, GroundTruth, Scores};
    ///
    /// let map = DisparityMap {
    ///     width: 4,
    ///     height: 1,
    ///     disparity: vec![10.0, 10.25, 14.0, f32::NAN],
    ///     sigma: vec![0.25, 0.25, 0.25, f32::NAN],
    /// };
    /// let truth = GroundTruth { disparity: &[10.0; 4], visible: &[true; 4] };
    /// let scores = Scores::of(&map, truth)?;
    /// assert_eq!(scores.density(), 0.75);
    /// assert_eq!(BAD_PX[1], 1.0);
    /// assert_eq!(scores.bad, [1; 4]); // one error of 4 px
    /// // An absent pixel counts as an error here.
    /// assert_eq!(scores.bad_ratio_of_all(1), 0.5);
    /// assert_eq!(scores.coverage(), 2.0 / 3.0);
    /// # Ok::<(), depth::DepthError>(())
    /// ```
    pub fn of(map: &DisparityMap, truth: GroundTruth<'_>) -> Result<Self, DepthError> {
        let count = map.disparity.len();
        for found in [truth.disparity.len(), truth.visible.len(), map.sigma.len()] {
            if found != count {
                return Err(DepthError::Size {
                    eye: "true",
                    found: [found / map.width.max(1), map.width],
                    expected: [map.height, map.width],
                });
            }
        }
        let mut scores = Self::default();
        for i in 0..count {
            if !truth.visible[i] || truth.disparity[i].is_nan() {
                continue;
            }
            scores.pixels += 1;
            if map.disparity[i].is_nan() {
                continue;
            }
            scores.found += 1;
            let error = (map.disparity[i] - truth.disparity[i]).abs();
            for (bad, limit) in scores.bad.iter_mut().zip(BAD_PX) {
                *bad += u64::from(error > limit);
            }
            scores.error_px += f64::from(error);
            scores.within_two_sigma += u64::from(error <= 2.0 * map.sigma[i]);
        }
        Ok(scores)
    }

    /// Adds the counts of another image.
    ///
    /// ```
    /// use depth::evaluate::Scores;
    ///
    /// let mut sum = Scores { pixels: 100, found: 100, error_px: 10.0, ..Scores::default() };
    /// sum.add(&Scores { pixels: 300, found: 100, error_px: 50.0, ..Scores::default() });
    /// assert_eq!(sum.density(), 0.5);
    /// assert_eq!(sum.mean_error_px(), 0.3);
    /// ```
    pub fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.found += other.found;
        for (bad, other) in self.bad.iter_mut().zip(other.bad) {
            *bad += other;
        }
        self.error_px += other.error_px;
        self.within_two_sigma += other.within_two_sigma;
    }

    /// Fraction of pixels that have a disparity.
    pub fn density(&self) -> f64 {
        ratio(self.found, self.pixels)
    }

    /// Fraction of disparities with an error above the `k`-th of [`BAD_PX`].
    pub fn bad_ratio(&self, k: usize) -> f64 {
        ratio(self.bad[k], self.found)
    }

    /// Fraction of all pixels with an error above the `k`-th of [`BAD_PX`] or without a disparity.
    pub fn bad_ratio_of_all(&self, k: usize) -> f64 {
        ratio(self.bad[k] + self.pixels - self.found, self.pixels)
    }

    /// Mean absolute error of the disparities, px.
    pub fn mean_error_px(&self) -> f64 {
        self.error_px / self.found.max(1) as f64
    }

    /// Fraction of disparities within two sigma of the ground truth.
    pub fn coverage(&self) -> f64 {
        ratio(self.within_two_sigma, self.found)
    }
}

fn ratio(part: u64, all: u64) -> f64 {
    part as f64 / all.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(disparity: Vec<f32>, sigma: f32) -> DisparityMap {
        DisparityMap {
            width: disparity.len(),
            height: 1,
            sigma: vec![sigma; disparity.len()],
            disparity,
        }
    }

    #[test]
    fn ratios_count_visible_pixels_with_ground_truth() {
        let nan = f32::NAN;
        let truth = GroundTruth {
            disparity: &[10.0, 10.0, 10.0, 10.0, nan, 10.0],
            visible: &[true, true, true, true, true, false],
        };
        let map = map(vec![10.4, 11.5, nan, 14.0, 99.0, 99.0], 0.8);
        let scores = Scores::of(&map, truth).unwrap();
        assert_eq!((scores.pixels, scores.found), (4, 3));
        assert_eq!(scores.bad, [2, 2, 1, 1]);
        assert_eq!(scores.density(), 0.75);
        assert_eq!(scores.bad_ratio(2), 1.0 / 3.0);
        assert_eq!(scores.bad_ratio_of_all(2), 0.5);
        assert!((scores.mean_error_px() - 5.9 / 3.0).abs() < 1e-6);
        assert_eq!(scores.coverage(), 2.0 / 3.0);
        let mut twice = scores;
        twice.add(&scores);
        assert_eq!((twice.pixels, twice.density()), (8, 0.75));
    }

    #[test]
    fn empty_map_has_zero_ratios() {
        let truth = GroundTruth {
            disparity: &[],
            visible: &[],
        };
        let scores = Scores::of(&map(vec![], 1.0), truth).unwrap();
        assert_eq!((scores.density(), scores.mean_error_px()), (0.0, 0.0));
    }

    #[test]
    fn size_mismatch_is_rejected() {
        let truth = GroundTruth {
            disparity: &[1.0],
            visible: &[true],
        };
        assert!(Scores::of(&map(vec![1.0, 2.0], 1.0), truth).is_err());
    }
}
