//! Alignment of the rows of a pair that is not rectified exactly.
//!
//! Contract: a pair shows the row offset of its matches, and a matcher that compares rows loses
//! accuracy and matches with it: a quarter of a pixel doubles the errors of more than 1 px on
//! Motorcycle (Middlebury 2014). The offset is estimated as a polynomial of the place in the right
//! image (a rotation, another focal length and decentering of a lens are of second order), from
//! blocks with texture, robustly, and the right image is resampled where it is significant.
//! Otherwise no pixel changes. Of the same error along the rows, which is an error of the disparity,
//! the pair shows the part of a roll, which is corrected; the sigma model has a term for the rest.

use rayon::prelude::*;

use crate::band::Band;
use crate::linear::solve;
use crate::prediction::{Block, predict};
use crate::smoothing::smooth;
use imaging::ImageView;

/// Terms of the polynomial.
const TERMS: usize = 6;
/// Standard deviation of a coefficient before any measurement, px.
const PRIOR_SIGMA_PX: f64 = 1.0;
/// Standard deviation of the offset of a block around the polynomial, px.
const BLOCK_SIGMA_PX: f64 = 0.1;
/// Minimum predicted share of the variance of a block: below, the match may be wrong.
const MIN_PREDICTED_RATIO: f64 = 0.8;
/// Gain between the images of a block with a match.
const VALID_GAINS: std::ops::Range<f64> = 0.5..2.0;
/// Maximum offset of a block, px.
const MAX_STEP_PX: f64 = 1.0;
/// Maximum offset, px.
const MAX_OFFSET_PX: f64 = 3.0;
/// Minimum number of blocks.
const MIN_BLOCKS: usize = 20;
/// Number of estimates, each from the image that the previous one aligns.
const PASSES: usize = 2;
/// Number of reweighted fits.
const ITERATIONS: usize = 8;
/// Ratio of the root mean square offset to its standard deviation from which on it is significant.
const SIGNIFICANCE: f64 = 4.0;
/// Places along each side at which offsets are averaged.
const STEPS: usize = 5;
/// Columns that are resampled with one offset.
const SEGMENT_PX: usize = 16;
/// Places per row between which is not interpolated.
const STEPS_PER_ROW: usize = 64;
/// Half of the sum of weights, for rounding: sums are within 16 bits.
const HALF: i16 = 32;

/// Row offset of a pair over the right image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RowOffsets {
    /// Columns and rows of the image.
    size: [f64; 2],
    coefficients: [f64; TERMS],
}

/// Buffers that are reused from one pair to the next.
#[derive(Debug, Default)]
pub(crate) struct RowAlignment {
    smoothed: [Vec<u8>; 2],
    smoothed_aligned: Vec<u8>,
    /// The right image with the rows of the left one.
    pub(crate) aligned: Vec<u8>,
}

impl RowAlignment {
    /// Estimates the row offsets of a pair and aligns the right image. `None` where no offset is
    /// significant, or less than `min_rms_px` root mean square.
    pub(crate) fn run(
        &mut self,
        [left, right]: [&ImageView<'_>; 2],
        band: &Band,
        min_rms_px: f64,
    ) -> Option<RowOffsets> {
        let size = [right.width(), right.height()];
        let [of_left, of_right] = &mut self.smoothed;
        rayon::join(
            || smooth(left, 1.0, of_left),
            || smooth(right, 1.0, of_right),
        );
        let [smooth_left, smooth_right] = [view(size, of_left)?, view(size, of_right)?];
        let none = RowOffsets {
            size: size.map(|side| side as f64),
            coefficients: [0.0; TERMS],
        };
        let (mut offsets, sigma) = none.fit(&predict(&smooth_left, &smooth_right, band, 1))?;
        if offsets.rms_px() < min_rms_px.max(SIGNIFICANCE * sigma) {
            return None;
        }
        for _ in 1..PASSES {
            offsets.resample(&smooth_right, &mut self.smoothed_aligned);
            let aligned = view(size, &self.smoothed_aligned)?;
            let (step, _) = none.fit(&predict(&smooth_left, &aligned, band, 1))?;
            offsets = offsets.plus(&step);
        }
        offsets.resample(right, &mut self.aligned);
        Some(offsets)
    }
}

impl RowOffsets {
    /// Fits the offsets of blocks, and gives the root mean square of their standard deviation, px;
    /// `None` if there are too few.
    fn fit(&self, blocks: &[Block]) -> Option<(Self, f64)> {
        let found = blocks.iter().filter_map(|block| block.prediction);
        let matched = found.filter(|found| {
            found.predicted_ratio >= MIN_PREDICTED_RATIO
                && VALID_GAINS.contains(&found.gain)
                && found.row_offset_px.abs() <= MAX_STEP_PX
        });
        let points: Vec<([f64; TERMS], f64, f64)> = matched
            .map(|found| {
                let variance = found.row_variance_px2 + BLOCK_SIGMA_PX * BLOCK_SIGMA_PX;
                (self.terms(found.center), found.row_offset_px, variance)
            })
            .collect();
        if points.len() < MIN_BLOCKS {
            return None;
        }
        let mut coefficients = [0.0; TERMS];
        let mut covariance = [[0.0; TERMS]; TERMS];
        for _ in 0..ITERATIONS {
            let mut matrix = [[0.0; TERMS]; TERMS];
            // The right side, and the columns of the identity.
            let mut sides = [[0.0; TERMS]; TERMS + 1];
            for i in 0..TERMS {
                matrix[i][i] = 1.0 / (PRIOR_SIGMA_PX * PRIOR_SIGMA_PX);
                sides[1 + i][i] = 1.0;
            }
            for (terms, offset, variance) in &points {
                let error = offset - dot(&coefficients, terms);
                // Cauchy's weight.
                let weight = 1.0 / (variance + error * error);
                for (i, row) in matrix.iter_mut().enumerate() {
                    for (value, term) in row.iter_mut().zip(terms) {
                        *value += weight * terms[i] * term;
                    }
                    sides[0][i] += weight * terms[i] * offset;
                }
            }
            let [solution, inverse @ ..] = solve(matrix, sides);
            (coefficients, covariance) = (solution, inverse);
        }
        let fit = Self {
            size: self.size,
            coefficients,
        };
        let variance = fit.mean(|terms| dot(terms, &covariance.map(|row| dot(&row, terms))));
        Some((fit, variance.sqrt()))
    }

    /// With a step of the estimate.
    fn plus(&self, step: &Self) -> Self {
        let sum = |k: usize| self.coefficients[k] + step.coefficients[k];
        Self {
            size: self.size,
            coefficients: std::array::from_fn(sum),
        }
    }

    /// Monomials of a place in the right image.
    fn terms(&self, place: [f64; 2]) -> [f64; TERMS] {
        let [x, y] = [0, 1].map(|k| 2.0 * place[k] / self.size[k] - 1.0);
        [1.0, x, y, x * y, x * x, y * y]
    }

    /// Row of the right image minus row of the left one at a place in the right image, px.
    fn at(&self, place: [f64; 2]) -> f64 {
        dot(&self.coefficients, &self.terms(place)).clamp(-MAX_OFFSET_PX, MAX_OFFSET_PX)
    }

    /// By how much a row of disparities is too large, px: rows that are displaced in proportion to
    /// the column show a right image that is rolled, which displaces columns in proportion to the
    /// row.
    pub(crate) fn disparity_error(&self, row: usize) -> f64 {
        let [width, height] = self.size;
        let roll = self.coefficients[1] / (0.5 * width);
        roll * (row as f64 + 0.5 - 0.5 * height)
    }

    /// Root mean square over the image, px.
    pub(crate) fn rms_px(&self) -> f64 {
        self.mean(|terms| dot(&self.coefficients, terms).powi(2))
            .sqrt()
    }

    /// Mean over the image.
    fn mean(&self, of: impl Fn(&[f64; TERMS]) -> f64) -> f64 {
        let at = |k: usize, side: f64| side * (k as f64 + 0.5) / STEPS as f64;
        let places =
            (0..STEPS * STEPS).map(|k| [at(k % STEPS, self.size[0]), at(k / STEPS, self.size[1])]);
        places.map(|place| of(&self.terms(place))).sum::<f64>() / (STEPS * STEPS) as f64
    }

    /// Writes the right image with the rows of the left one: cubic interpolation along columns
    /// (Catmull and Rom); rows outside are those of the border.
    fn resample(&self, right: &ImageView<'_>, aligned: &mut Vec<u8>) {
        let (width, height) = (right.width(), right.height());
        aligned.resize(width * height, 0);
        let weights = Weights::new();
        let rows = aligned.par_chunks_exact_mut(width).enumerate();
        rows.for_each(|(y, to)| {
            for (k, to) in to.chunks_mut(SEGMENT_PX).enumerate() {
                let from = k * SEGMENT_PX;
                let middle = from as f64 + 0.5 * SEGMENT_PX as f64;
                let (first, weights) = weights.at(y as f64 + self.at([middle, y as f64]));
                let near = [0, 1, 2, 3].map(|k| {
                    let row = (first + k).clamp(0, height as i32 - 1) as usize;
                    &right.row(row)[from..from + to.len()]
                });
                match <&mut [u8; SEGMENT_PX]>::try_from(&mut *to) {
                    Ok(to) => interpolate(weights, near, to),
                    Err(_) => interpolate(weights, near, to),
                }
            }
        });
    }
}

/// Weighted sum of four rows; called with arrays too, for which the compiler uses vectors.
#[inline(always)]
fn interpolate(weights: [i16; 4], near: [&[u8]; 4], to: &mut [u8]) {
    let near = near.map(|row| &row[..to.len()]);
    for (i, to) in to.iter_mut().enumerate() {
        let sum: i16 = (0..4).map(|k| weights[k] * i16::from(near[k][i])).sum();
        *to = ((sum + HALF) / (2 * HALF)).clamp(0, 255) as u8;
    }
}

fn view([width, height]: [usize; 2], pixels: &[u8]) -> Option<ImageView<'_>> {
    ImageView::packed(width, height, pixels).ok()
}

/// Weights of four rows for each place between the second and the third, in steps.
struct Weights([[i16; 4]; STEPS_PER_ROW]);

impl Weights {
    fn new() -> Self {
        let at = |step: usize| {
            let t = step as f64 / STEPS_PER_ROW as f64;
            let of = [
                0.5 * (-t + 2.0 * t * t - t * t * t),
                0.5 * (2.0 - 5.0 * t * t + 3.0 * t * t * t),
                0.5 * (t + 4.0 * t * t - 3.0 * t * t * t),
            ];
            let [a, b, c] = of.map(|weight| (weight * f64::from(2 * HALF)).round() as i16);
            [a, b, c, 2 * HALF - a - b - c]
        };
        Self(std::array::from_fn(at))
    }

    /// First of four rows and their weights for a place, px.
    fn at(&self, row: f64) -> (i32, [i16; 4]) {
        let steps = (row * STEPS_PER_ROW as f64).round() as i32;
        let whole = steps.div_euclid(STEPS_PER_ROW as i32);
        let step = steps.rem_euclid(STEPS_PER_ROW as i32);
        (whole - 1, self.0[step as usize])
    }
}

fn dot(a: &[f64; TERMS], b: &[f64; TERMS]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Random;

    const SIZE: [usize; 2] = [320, 240];
    const SHIFT: usize = 11;

    /// Smooth texture at any place: sums of waves of random directions.
    struct Waves(Vec<[f64; 4]>);

    impl Waves {
        fn new(random: &mut Random) -> Self {
            let mut part = |most: f64| most * (random.below(1000) as f64 / 500.0 - 1.0);
            let waves = (0..40).map(|_| [part(1.2), part(1.2), part(3.2), 8.0]);
            Self(waves.collect())
        }

        fn at(&self, x: f64, y: f64) -> f64 {
            let waves = self.0.iter();
            128.0
                + waves
                    .map(|[u, v, phase, size]| size * (u * x + v * y + phase).sin())
                    .sum::<f64>()
        }
    }

    /// A pair whose right image has a row offset.
    fn pair(offset: impl Fn([f64; 2]) -> f64) -> [Vec<u8>; 2] {
        moved_pair(|[x, y]| [x, y - offset([x, y])])
    }

    /// A pair whose right image shows at each place what belongs elsewhere.
    fn moved_pair(from: impl Fn([f64; 2]) -> [f64; 2]) -> [Vec<u8>; 2] {
        let mut random = Random(61);
        let waves = Waves::new(&mut random);
        let mut image = |gray: &dyn Fn(f64, f64) -> f64| -> Vec<u8> {
            let pixel = |i: usize| {
                let noise = random.below(3) as f64 - 1.0;
                let gray = gray((i % SIZE[0]) as f64, (i / SIZE[0]) as f64) + noise;
                gray.round().clamp(0.0, 255.0) as u8
            };
            (0..SIZE[0] * SIZE[1]).map(pixel).collect()
        };
        let left = image(&|x, y| waves.at(x, y));
        let right = image(&|x, y| {
            let [x, y] = from([x, y]);
            waves.at(x + SHIFT as f64, y)
        });
        [left, right]
    }

    fn run(images: &[Vec<u8>; 2]) -> (Option<RowOffsets>, RowAlignment) {
        let [left, right] =
            [0, 1].map(|eye| ImageView::packed(SIZE[0], SIZE[1], &images[eye]).unwrap());
        let mut alignment = RowAlignment::default();
        let band = Band::full(0, 32, SIZE[1]).unwrap();
        let found = alignment.run([&left, &right], &band, 0.05);
        (found, alignment)
    }

    #[test]
    fn disparities_of_a_rolled_right_image_are_corrected() {
        let roll = 0.005;
        let images = moved_pair(|[x, y]| {
            let [u, v] = [x - 159.5, y - 119.5];
            [x + roll * v, y - roll * u]
        });
        let [left, right] =
            [0, 1].map(|eye| ImageView::packed(SIZE[0], SIZE[1], &images[eye]).unwrap());
        let config = crate::Config::preset(crate::Preset::Balanced);
        let mut matcher = crate::Matcher::new(config, SIZE[0], SIZE[1]).unwrap();
        let band = Band::full(0, 32, SIZE[1]).unwrap();
        let map = matcher.run(&left, &right, &band).unwrap();
        let median_of = |rows: std::ops::Range<usize>| {
            let found = &map.disparity[rows.start * SIZE[0]..rows.end * SIZE[0]];
            let mut found: Vec<f32> = found.iter().copied().filter(|d| !d.is_nan()).collect();
            assert!(found.len() > 1000);
            found.sort_by(f32::total_cmp);
            found[found.len() / 2]
        };
        // Half a pixel at the upper and at the lower border, with opposite signs.
        for rows in [10..25, 112..127, 215..230] {
            let error = median_of(rows.clone()) - SHIFT as f32;
            assert!(error.abs() < 0.05, "{rows:?}: {error}");
        }
    }

    #[test]
    fn offset_of_a_decentered_lens_is_estimated_and_corrected() {
        let offset = |[x, y]: [f64; 2]| {
            let [x, y] = [x / 160.0 - 1.0, y / 120.0 - 1.0];
            0.25 + 0.9 * x * y
        };
        let images = pair(offset);
        let (found, alignment) = run(&images);
        let found = found.unwrap();
        for place in [[30.0, 30.0], [290.0, 30.0], [160.0, 120.0], [30.0, 210.0]] {
            let error = found.at(place) - offset(place);
            assert!(error.abs() < 0.1, "{place:?}: {error}");
        }
        let aligned = pair(|_| 0.0);
        let difference = |right: &[u8]| {
            let pairs = right.iter().zip(&aligned[1]);
            pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>()
        };
        let (before, after) = (difference(&images[1]), difference(&alignment.aligned));
        assert!(after < 0.4 * before, "{after} {before}");
    }

    #[test]
    fn aligned_pair_and_pair_without_texture_are_left_alone() {
        assert_eq!(run(&pair(|_| 0.0)).0, None);
        let even = vec![90; SIZE[0] * SIZE[1]];
        assert_eq!(run(&[even.clone(), even]).0, None);
    }

    #[test]
    fn whole_offset_moves_rows() {
        let mut random = Random(62);
        let pixels = random.image(20, 12);
        let offsets = RowOffsets {
            size: [20.0, 12.0],
            coefficients: [2.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        };
        let mut aligned = Vec::new();
        offsets.resample(&ImageView::packed(20, 12, &pixels).unwrap(), &mut aligned);
        assert_eq!(aligned[..200], pixels[40..]);
        assert_eq!(aligned[200..220], pixels[220..]);
    }
}
