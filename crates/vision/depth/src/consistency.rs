//! Left-right consistency check, uniqueness check and subpixel refinement.
//!
//! A pixel passes the check if the matched pixel of the right image has the same winner up to a
//! small difference. The subpixel minimum is that of two lines of equal and opposite slope through
//! the three sums around the winner, which suits costs that count differing bits (Haller, Pantilie,
//! Oniga and Nedevschi, "Real-time semi-global dense stereo solution with improved sub-pixel
//! accuracy", IV 2010, call it symmetric V).

use rayon::prelude::*;

use crate::aggregation::{NONE, Winner};

/// Winners of both images and the limits of the checks.
pub(crate) struct Winners<'a> {
    pub(crate) width: usize,
    pub(crate) first: i32,
    pub(crate) left: &'a [Winner],
    pub(crate) right: &'a [u16],
    /// Maximum difference of the two winners, px.
    pub(crate) max_lr_difference_px: u16,
    /// Minimum margin of the second-best non-adjacent sum over the winner, percent.
    pub(crate) uniqueness_percent: u16,
}

impl Winners<'_> {
    /// Computes the disparity of each pixel, px; NaN where a check fails.
    pub(crate) fn left_right_check(&self, map: &mut Vec<f32>) {
        map.resize(self.left.len(), f32::NAN);
        let width = self.width;
        let rows = map.par_chunks_exact_mut(width).enumerate();
        rows.for_each(|(y, to)| {
            let left = &self.left[y * width..(y + 1) * width];
            let right = &self.right[y * width..(y + 1) * width];
            for (x, (winner, to)) in left.iter().zip(to).enumerate() {
                let column = x as i64 - i64::from(self.first) - i64::from(winner.lane);
                let other = usize::try_from(column).ok().and_then(|x| right.get(x));
                let agree = other
                    .is_some_and(|lane| lane.abs_diff(winner.lane) <= self.max_lr_difference_px);
                let unique = u32::from(winner.second) * 100
                    >= u32::from(winner.least) * u32::from(100 + self.uniqueness_percent);
                let is_valid = winner.lane != NONE && agree && unique;
                *to = match is_valid {
                    true => self.first as f32 + f32::from(winner.lane) + subpixel(winner),
                    false => f32::NAN,
                };
            }
        });
    }
}

/// Subpixel offset of the minimum from the winner, px, from -0.5 to 0.5.
fn subpixel(winner: &Winner) -> f32 {
    let [before, behind] = winner
        .beside
        .map(|sum| f32::from(sum) - f32::from(winner.least));
    let steep = before.max(behind);
    if steep <= 0.0 {
        return 0.0;
    }
    0.5 * (before - behind) / steep
}
