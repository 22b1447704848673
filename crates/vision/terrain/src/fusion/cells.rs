//! Cells of pixels: their depths, and the mean of those on one surface.
//!
//! Values lie in rows of one quantity each, so that loops over a row use vector instructions.

use simd_dispatch::Kernel;

use super::step::step;
use crate::config::FusionConfig;
use crate::instructions::{larger, smaller};
use crate::view::{DepthView, PixelClass};

/// A row of cells. All fields have one cell without depth before the first and after the last one.
#[derive(Clone, Debug, Default)]
pub(crate) struct CellRow {
    /// Least and greatest depth, m; infinite and 0 without depth.
    pub(crate) min_depth: Vec<f32>,
    pub(crate) max_depth: Vec<f32>,
    /// Number of pixels on the surface at the center of the cell; the mean of their columns, rows,
    /// inverse depths and sigmas of depth.
    pub(crate) count: Vec<f32>,
    pub(crate) at: [Vec<f32>; 2],
    pub(crate) inverse: Vec<f32>,
    pub(crate) sigma: Vec<f32>,
}

impl CellRow {
    fn resize(&mut self, columns: usize) {
        let [columns_at, rows_at] = &mut self.at;
        for of in [
            &mut self.max_depth,
            &mut self.count,
            columns_at,
            rows_at,
            &mut self.inverse,
            &mut self.sigma,
        ] {
            of.resize(columns + 2, 0.0);
            (of[0], of[columns + 1]) = (0.0, 0.0);
        }
        self.min_depth.resize(columns + 2, f32::INFINITY);
        (self.min_depth[0], self.min_depth[columns + 1]) = (f32::INFINITY, f32::INFINITY);
    }
}

/// All cells of an image.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cells {
    /// Columns and rows.
    pub(crate) size: [usize; 2],
    pub(crate) rows: Vec<CellRow>,
}

impl Cells {
    pub(crate) fn resize(&mut self, size: [usize; 2]) {
        self.size = size;
        self.rows.resize_with(size[1], CellRow::default);
        for row in &mut self.rows {
            row.resize(size[0]);
        }
    }
}

/// Fills a row of cells.
pub(crate) struct Means<'a> {
    pub(crate) config: &'a FusionConfig,
    pub(crate) view: &'a DepthView<'a>,
    /// First row of pixels.
    pub(crate) first_row: usize,
    /// Edge of a cell, px.
    pub(crate) cell_px: usize,
    /// Depths of the rows of pixels, m; 0 for none, negative for pixels that are not known to be
    /// static.
    pub(crate) depth: &'a mut [f32],
    pub(crate) cells: &'a mut CellRow,
}

/// What the pixels of a column of a row of cells add up to.
struct Columns {
    reference: Vec<f32>,
    max_step: Vec<f32>,
    count: Vec<f32>,
    row: Vec<f32>,
    inverse: Vec<f32>,
    sigma: Vec<f32>,
    low: Vec<f32>,
    high: Vec<f32>,
}

impl Kernel for Means<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        let width = self.view.size[0];
        let zeros = || vec![0.0f32; width];
        let mut sums = Columns {
            reference: zeros(),
            max_step: zeros(),
            count: zeros(),
            row: zeros(),
            inverse: zeros(),
            sigma: zeros(),
            low: vec![f32::INFINITY; width],
            high: zeros(),
        };
        for (k, depth) in self.depth.chunks_exact_mut(width).enumerate() {
            usable(self.view, self.first_row + k, depth);
            let of = depth.iter().zip(&mut sums.low).zip(&mut sums.high);
            for ((depth, low), high) in of {
                let depth = depth.abs();
                let shown = if depth > 0.0 { depth } else { f32::INFINITY };
                *low = smaller(shown, *low);
                *high = larger(depth, *high);
            }
        }
        let columns = self.cells.count.len() - 2;
        for column in 0..columns {
            self.reference(column, &mut sums);
        }
        for (k, depth) in self.depth.chunks_exact(width).enumerate() {
            add(self.view, self.first_row + k, k as f32, depth, &mut sums);
        }
        for column in 0..columns {
            self.mean(column, &sums);
        }
    }
}

/// Depths of a row of pixels.
#[inline(always)]
fn usable(view: &DepthView<'_>, row: usize, out: &mut [f32]) {
    let width = out.len();
    let depths = &view.depth_m[row * width..][..width];
    let sigmas = &view.sigma_m[row * width..][..width];
    for i in 0..width {
        let (depth, sigma) = (depths[i], sigmas[i]);
        // False for NaN.
        let both = (depth > 0.0) & (sigma > 0.0) & (depth < f32::MAX) & (sigma < f32::MAX);
        out[i] = if both { depth } else { 0.0 };
    }
    if let Some(classes) = view.classes {
        let classes = &classes[row * width..][..width];
        for i in 0..width {
            let sign = if classes[i] == PixelClass::Unknown {
                -1.0
            } else {
                1.0
            };
            let share = if classes[i] == PixelClass::Excluded {
                0.0
            } else {
                sign
            };
            out[i] *= share;
        }
    }
}

/// Adds the pixels of a row that are on the surfaces at the centers of their cells.
#[inline(always)]
fn add(view: &DepthView<'_>, row: usize, in_cell: f32, depth: &[f32], sums: &mut Columns) {
    let width = depth.len();
    let sigma = &view.sigma_m[row * width..][..width];
    let reference = &sums.reference[..width];
    let max_step = &sums.max_step[..width];
    let count = &mut sums.count[..width];
    let rows = &mut sums.row[..width];
    let inverse = &mut sums.inverse[..width];
    let sigmas = &mut sums.sigma[..width];
    for u in 0..width {
        let is_near = (depth[u] > 0.0) & ((depth[u] - reference[u]).abs() <= max_step[u]);
        let one = if is_near { 1.0 } else { 0.0 };
        let divisor = if depth[u] > 0.0 { depth[u] } else { 1.0 };
        count[u] += one;
        rows[u] += one * in_cell;
        inverse[u] += one / divisor;
        sigmas[u] += if is_near { sigma[u] } else { 0.0 };
    }
}

impl Means<'_> {
    /// First column of a cell, and the one after its last.
    #[inline(always)]
    fn range(&self, column: usize) -> [usize; 2] {
        let first = column * self.cell_px;
        [first, (first + self.cell_px).min(self.view.size[0])]
    }

    /// The pixel with depth that is nearest to the center of a cell, for all of its columns.
    #[inline(always)]
    fn reference(&self, column: usize, sums: &mut Columns) {
        let width = self.view.size[0];
        let [first, end] = self.range(column);
        let rows = self.depth.len() / width;
        let half = self.cell_px / 2;
        let at = |u: usize, v: usize| self.depth[v * width + u].abs();
        let mut nearest = None;
        if first + half < end && half < rows && at(first + half, half) > 0.0 {
            nearest = Some([first + half, half]);
        } else {
            let mut least = usize::MAX;
            for v in 0..rows {
                for u in first..end {
                    let distance = u.abs_diff(first + half) + v.abs_diff(half);
                    if at(u, v) > 0.0 && distance < least {
                        (nearest, least) = (Some([u, v]), distance);
                    }
                }
            }
        }
        let (mut reference, mut max_step) = (0.0, 0.0);
        if let Some([u, v]) = nearest {
            let sigma = self.view.sigma_m[(self.first_row + v) * width + u];
            reference = at(u, v);
            max_step = step(self.config.step_ratio as f32, reference, sigma);
        }
        sums.reference[first..end].fill(reference);
        sums.max_step[first..end].fill(max_step);
    }

    #[inline(always)]
    fn mean(&mut self, column: usize, sums: &Columns) {
        let [first, end] = self.range(column);
        let (mut low, mut high) = (f32::INFINITY, 0.0f32);
        let [mut count, mut u_sum, mut v_sum, mut inverse, mut sigma] = [0.0f32; 5];
        for u in first..end {
            low = smaller(sums.low[u], low);
            high = larger(sums.high[u], high);
            count += sums.count[u];
            u_sum += (u - first) as f32 * sums.count[u];
            v_sum += sums.row[u];
            inverse += sums.inverse[u];
            sigma += sums.sigma[u];
        }
        let share = if count > 0.0 { 1.0 / count } else { 0.0 };
        let cells = &mut *self.cells;
        cells.min_depth[column + 1] = low;
        cells.max_depth[column + 1] = high;
        cells.count[column + 1] = count;
        cells.at[0][column + 1] = first as f32 + share * u_sum;
        cells.at[1][column + 1] = self.first_row as f32 + share * v_sum;
        cells.inverse[column + 1] = share * inverse;
        cells.sigma[column + 1] = share * sigma;
    }
}
