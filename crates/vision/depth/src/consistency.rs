//! Left-right consistency check, uniqueness check and subpixel refinement.
//!
//! A pixel is consistent if the matched pixel of the right image has the same winner up to a small
//! difference. Others keep their disparity and the difference: they are evidence where a surface
//! around them is consistent ([`crate::speckle`], [`crate::sigma`]). The subpixel minimum is that
//! of two lines of equal and opposite slope through the three sums around the winner, which suits
//! costs that count differing bits (Haller, Pantilie, Oniga and Nedevschi, "Real-time semi-global
//! dense stereo solution with improved sub-pixel accuracy", IV 2010, call it symmetric V).

use rayon::prelude::*;

use crate::aggregation::{NONE, Winner};

/// Difference of a pixel whose match has no winner.
pub(crate) const NO_MATCH: u8 = u8::MAX;

/// Winners of both images and the limits of the checks.
pub(crate) struct Winners<'a> {
    pub(crate) width: usize,
    pub(crate) first: i32,
    pub(crate) left: &'a [Winner],
    pub(crate) right: &'a [u16],
    /// Minimum margin of the second-best non-adjacent sum over the winner, percent.
    pub(crate) uniqueness_percent: u16,
}

impl Winners<'_> {
    /// Computes the disparity of each pixel, px, and its difference from that of the matched pixel
    /// of the right image, px, at most [`NO_MATCH`]; NaN where no disparity is valid or unique.
    pub(crate) fn disparities(&self, map: &mut Vec<f32>, differences: &mut Vec<u8>) {
        map.resize(self.left.len(), f32::NAN);
        differences.resize(self.left.len(), NO_MATCH);
        let width = self.width;
        let rows = map.par_chunks_exact_mut(width);
        let rows = rows
            .zip(differences.par_chunks_exact_mut(width))
            .enumerate();
        rows.for_each(|(y, (to, differences))| {
            let left = &self.left[y * width..(y + 1) * width];
            let right = &self.right[y * width..(y + 1) * width];
            for (x, winner) in left.iter().enumerate() {
                let column = x as i64 - i64::from(self.first) - i64::from(winner.lane);
                let other = usize::try_from(column).ok().and_then(|x| right.get(x));
                let apart = other.map_or(u16::MAX, |lane| lane.abs_diff(winner.lane));
                differences[x] = apart.min(u16::from(NO_MATCH)) as u8;
                let unique = u32::from(winner.second) * 100
                    >= u32::from(winner.least) * u32::from(100 + self.uniqueness_percent);
                to[x] = match winner.lane != NONE && unique {
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
