//! Linear prediction of blocks of the left image from the right one: what one eye shows of the
//! other.
//!
//! Contract: a few rows of a block are matched to the right image within the band by the sum of
//! absolute differences, and a linear filter of the match is fitted to them by least squares. It
//! takes out subpixel disparity, a row offset, and different gain and blur. Its residual is the
//! noise of the block ([`crate::noise`]), its first moment along the column the row offset
//! ([`crate::row_alignment`]).

use rayon::prelude::*;

use crate::band::Band;
use crate::linear::solve;
use imaging::ImageView;

/// Side length of a block, px.
pub(crate) const BLOCK_PX: usize = 16;
/// Predicted rows of a block: few, since the disparity of a slanted surface changes from row to
/// row.
const ROWS: usize = 3;
/// First of them.
const FIRST_ROW: usize = (BLOCK_PX - ROWS) / 2;
/// Pixels of the right image that predict one of the left: columns and rows from the match.
const TAPS: [[isize; 2]; 7] = [[-2, 0], [-1, 0], [0, 0], [1, 0], [2, 0], [0, -1], [0, 1]];
/// Number of taps.
const COUNT: usize = TAPS.len();
/// Taps, the left pixel and the constant.
const TERMS: usize = COUNT + 2;
/// Maximum column offset of a tap.
const TAP_COLUMNS: usize = 2;
/// Index of the tap in the row above.
const ABOVE: usize = 5;
/// Index of the tap in the row below.
const BELOW: usize = 6;
/// Ridge on the diagonal of the normal equations, squared gray levels per pixel: areas without
/// texture have no unique filter.
const RIDGE: f64 = 1e-2;

/// A block and the prediction of its middle rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Block {
    /// First column and row, px of the left image.
    pub(crate) corner: [usize; 2],
    /// `None` if the band leaves no match inside the right image.
    pub(crate) prediction: Option<Prediction>,
}

/// Prediction of the middle rows of a block.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prediction {
    /// Center of the match, px of the right image.
    pub(crate) center: [f64; 2],
    /// Standard deviation of the noise of one image, if both have the same: gray levels.
    pub(crate) noise: f64,
    /// Share of the variance of the left rows that is predicted.
    pub(crate) predicted_ratio: f64,
    /// Sum of the filter: the gain of the left image.
    pub(crate) gain: f64,
    /// Row of the right image minus row of the left one, px.
    pub(crate) row_offset_px: f64,
    /// Variance of the row offset by the residual, px².
    pub(crate) row_variance_px2: f64,
}

/// Predicts blocks: every second row of them, and every `step`-th column.
pub(crate) fn predict(
    left: &ImageView<'_>,
    right: &ImageView<'_>,
    band: &Band,
    step: usize,
) -> Vec<Block> {
    let columns = (left.width().saturating_sub(2) / BLOCK_PX).div_ceil(step);
    let rows = left
        .height()
        .saturating_sub(2 + BLOCK_PX)
        .div_ceil(2 * BLOCK_PX);
    let block = |k: usize| {
        let corner = [step * (k % columns), 2 * (k / columns)].map(|at| at * BLOCK_PX + 1);
        Block {
            corner,
            prediction: predict_block(left, right, band, corner),
        }
    };
    (0..columns * rows).into_par_iter().map(block).collect()
}

fn predict_block(
    left: &ImageView<'_>,
    right: &ImageView<'_>,
    band: &Band,
    [x, top]: [usize; 2],
) -> Option<Prediction> {
    let y = top + FIRST_ROW;
    let column = best_match(left, right, band, [x, y])?;
    // Sums over pixels of the products of the taps, the left pixel and 1: integers below 2^24,
    // which single precision holds exactly.
    let mut products = [[0.0_f32; TERMS]; TERMS];
    for k in 0..ROWS {
        let rows = [0, 1, 2].map(|dy| right.row(y + k + dy - 1));
        for i in 0..BLOCK_PX {
            let mut values = [1.0; TERMS];
            for (value, [dx, dy]) in values.iter_mut().zip(TAPS) {
                let at = (column + i).wrapping_add_signed(dx);
                *value = f32::from(rows[1_usize.wrapping_add_signed(dy)][at]);
            }
            values[COUNT] = f32::from(left.row(y + k)[x + i]);
            for (row, a) in products.iter_mut().zip(values) {
                for (product, b) in row.iter_mut().zip(values) {
                    *product += a * b;
                }
            }
        }
    }
    let count = (BLOCK_PX * ROWS) as f64;
    let spread = |i: usize, j: usize| {
        let sum = |k: usize| f64::from(products[k][COUNT + 1]);
        count * f64::from(products[i][j]) - sum(i) * sum(j)
    };
    let mut matrix = [[0.0; COUNT]; COUNT];
    for (i, row) in matrix.iter_mut().enumerate() {
        for (j, value) in row.iter_mut().enumerate() {
            *value = spread(i, j);
        }
        row[i] += count * count * RIDGE;
    }
    let of_left = std::array::from_fn(|i| spread(i, COUNT));
    let mut of_rows = [0.0; COUNT];
    (of_rows[ABOVE], of_rows[BELOW]) = (-1.0, 1.0);
    let [filter, of_moment] = solve(matrix, [of_left, of_rows]);
    let predicted: f64 = (0..COUNT).map(|i| filter[i] * spread(i, COUNT)).sum();
    let freedom = count - COUNT as f64 - 1.0;
    let residual = (spread(COUNT, COUNT) - predicted).max(0.0) / (count * freedom);
    let gain: f64 = filter.iter().sum();
    let row_variance = residual * count * (of_moment[BELOW] - of_moment[ABOVE]);
    Some(Prediction {
        center: [column + BLOCK_PX / 2, y + ROWS / 2].map(|at| at as f64),
        // The noise of the right image passes through the filter.
        noise: (residual / (1.0 + filter.iter().map(|w| w * w).sum::<f64>())).sqrt(),
        predicted_ratio: predicted / spread(COUNT, COUNT).max(1.0),
        gain,
        row_offset_px: (filter[BELOW] - filter[ABOVE]) / gain,
        row_variance_px2: row_variance / (gain * gain),
    })
}

/// Column of the right image where the rows of a block match best: the smallest sum of absolute
/// differences, the first one among equals.
fn best_match(
    left: &ImageView<'_>,
    right: &ImageView<'_>,
    band: &Band,
    [x, y]: [usize; 2],
) -> Option<usize> {
    let last = left.width().checked_sub(BLOCK_PX + TAP_COLUMNS)?;
    let [low, high] = band.row(y + ROWS / 2);
    let columns = (low..=high).filter_map(|d| usize::try_from(x as i64 - i64::from(d)).ok());
    let columns = columns.filter(|column| (TAP_COLUMNS..last).contains(column));
    let rows: [_; ROWS] = std::array::from_fn(|k| (row_at(left, x, y + k), right.row(y + k)));
    columns.min_by_key(|column| {
        let difference = |(left, right): &(&[u8; BLOCK_PX], &[u8])| {
            let right: &[u8; BLOCK_PX] = right[*column..*column + BLOCK_PX]
                .try_into()
                .expect("a slice of the length of a block");
            let mut sum = 0;
            for (a, b) in left.iter().zip(right) {
                sum += u32::from(a.abs_diff(*b));
            }
            sum
        };
        rows.iter().map(difference).sum::<u32>()
    })
}

/// One row of a block.
fn row_at<'a>(image: &ImageView<'a>, x: usize, y: usize) -> &'a [u8; BLOCK_PX] {
    image.row(y)[x..x + BLOCK_PX]
        .try_into()
        .expect("a slice of the length of a block")
}
