//! Local statistics over cells of 4x4 pixels and their 3x3 neighborhoods, which is cheaper than a
//! window per pixel.
//!
//! Contract: the neighborhood of a pixel is the 12x12 pixels of its cell and the eight adjacent
//! cells, clipped at the image border.

use rayon::prelude::*;

use imaging::ImageView;

/// Side length of a cell, px.
pub(crate) const CELL_PX: usize = 4;

/// One value per cell, row-major.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cells<T> {
    columns: usize,
    cells: Vec<T>,
}

impl<T: Copy + Default + Send + Sync> Cells<T> {
    /// Computes all cells of an image of this size; `value` gets the ranges of columns and rows of
    /// a cell.
    fn fill(
        &mut self,
        [width, height]: [usize; 2],
        value: impl Fn(std::ops::Range<usize>, std::ops::Range<usize>) -> T + Sync,
    ) {
        self.columns = width.div_ceil(CELL_PX);
        let rows = height.div_ceil(CELL_PX);
        self.cells.resize(self.columns * rows, T::default());
        let cells = self.cells.par_chunks_exact_mut(self.columns).enumerate();
        cells.for_each(|(row, cells)| {
            let ys = row * CELL_PX..((row + 1) * CELL_PX).min(height);
            for (column, cell) in cells.iter_mut().enumerate() {
                let xs = column * CELL_PX..((column + 1) * CELL_PX).min(width);
                *cell = value(xs, ys.clone());
            }
        });
    }

    /// Combines each cell with its eight neighbors; `join` combines two values.
    fn merge_neighbors(&self, joined: &mut Self, join: impl Fn(T, T) -> T + Sync) {
        let columns = self.columns;
        joined.columns = columns;
        joined.cells.resize(self.cells.len(), T::default());
        let rows = self.cells.len() / columns.max(1);
        let cells = joined
            .cells
            .par_chunks_exact_mut(columns.max(1))
            .enumerate();
        cells.for_each_init(Vec::new, |column, (row, cells)| {
            column.clear();
            column.extend_from_slice(&self.cells[row * columns..(row + 1) * columns]);
            for other in [row.wrapping_sub(1), row + 1] {
                if other < rows {
                    let other = &self.cells[other * columns..(other + 1) * columns];
                    for (a, b) in column.iter_mut().zip(other) {
                        *a = join(*a, *b);
                    }
                }
            }
            for (x, cell) in cells.iter_mut().enumerate() {
                *cell = column[x];
                for other in [x.wrapping_sub(1), x + 1] {
                    if let Some(other) = column.get(other) {
                        *cell = join(*cell, *other);
                    }
                }
            }
        });
    }

    /// Sets each cell to a value of the same cell of two others.
    pub(crate) fn zip<A: Copy + Sync, B: Copy + Sync>(
        &mut self,
        a: &Cells<A>,
        b: &Cells<B>,
        value: impl Fn(A, B) -> T + Sync + Send,
    ) {
        self.columns = a.columns;
        let both = a.cells.par_iter().zip(&b.cells);
        both.map(|(a, b)| value(*a, *b))
            .collect_into_vec(&mut self.cells);
    }

    /// Value of the cell that contains a pixel.
    pub(crate) fn at(&self, x: usize, y: usize) -> T {
        self.cells[y / CELL_PX * self.columns + x / CELL_PX]
    }
}

/// Disparity statistics of the neighborhood of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Neighborhood {
    /// Minimum and maximum disparity, px.
    pub(crate) min: f32,
    pub(crate) max: f32,
    /// Number of pixels with a disparity.
    pub(crate) found: u16,
    /// Number of pixels.
    pub(crate) all: u16,
}

impl Default for Neighborhood {
    fn default() -> Self {
        Self {
            min: f32::INFINITY,
            max: f32::NEG_INFINITY,
            found: 0,
            all: 0,
        }
    }
}

/// Disparity statistics of the neighborhood of every pixel of a map; NaN means absent.
#[derive(Debug, Default)]
pub(crate) struct LocalStats {
    own: Cells<Neighborhood>,
    pub(crate) near: Cells<Neighborhood>,
}

impl LocalStats {
    pub(crate) fn compute(&mut self, width: usize, map: &[f32]) {
        let height = map.len() / width;
        self.own.fill([width, height], |xs, ys| {
            let mut near = Neighborhood::default();
            for y in ys {
                for value in &map[y * width + xs.start..y * width + xs.end] {
                    near.all += 1;
                    // False for NaN.
                    if *value >= f32::NEG_INFINITY {
                        near.found += 1;
                        near.min = near.min.min(*value);
                        near.max = near.max.max(*value);
                    }
                }
            }
            near
        });
        self.own
            .merge_neighbors(&mut self.near, |a, b| Neighborhood {
                min: a.min.min(b.min),
                max: a.max.max(b.max),
                found: a.found + b.found,
                all: a.all + b.all,
            });
    }
}

/// Sums for the correlation of two images over pairs of corresponding pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct PairSums {
    count: u32,
    sums: [u32; 2],
    squares: [u32; 2],
    product: u32,
}

/// Minimum number of pixel pairs; with fewer the correlation is 0.
const MIN_PIXELS: u32 = 24;
/// Regularization of the denominator, gray levels squared: image areas without texture get a
/// correlation near 0.
const FLAT_VARIANCE: f32 = 0.1;

impl PairSums {
    fn add(&mut self, left: u8, right: u8) {
        let pair = [left, right].map(u32::from);
        self.count += 1;
        for (k, value) in pair.into_iter().enumerate() {
            self.sums[k] += value;
            self.squares[k] += value * value;
        }
        self.product += pair[0] * pair[1];
    }

    fn join(self, other: Self) -> Self {
        let add = |a: [u32; 2], b: [u32; 2]| [a[0] + b[0], a[1] + b[1]];
        Self {
            count: self.count + other.count,
            sums: add(self.sums, other.sums),
            squares: add(self.squares, other.squares),
            product: self.product + other.product,
        }
    }

    /// Normalized correlation, -1 to 1.
    pub(crate) fn correlation(self) -> f32 {
        if self.count < MIN_PIXELS {
            return 0.0;
        }
        // Integer arithmetic up to the last step: the sums of squares are far larger than their
        // difference.
        let [n, a, b] = [self.count, self.sums[0], self.sums[1]].map(i64::from);
        let spread = |square: u32, sum: i64| (n * i64::from(square) - sum * sum) as f32;
        let spreads = spread(self.squares[0], a) * spread(self.squares[1], b);
        let common = (n * i64::from(self.product) - a * b) as f32;
        common / (spreads.max(0.0).sqrt() + FLAT_VARIANCE * (n * n) as f32)
    }
}

/// Correlation of the two images around every pixel of the left one, with correspondences from a
/// disparity map.
#[derive(Debug, Default)]
pub(crate) struct Correlation {
    own: Cells<PairSums>,
    joined: Cells<PairSums>,
    /// Correlation of each neighborhood.
    pub(crate) near: Cells<f32>,
}

impl Correlation {
    pub(crate) fn compute(&mut self, left: &ImageView<'_>, right: &ImageView<'_>, map: &[f32]) {
        let width = left.width();
        self.own.fill([width, left.height()], |xs, ys| {
            let mut sums = PairSums::default();
            for y in ys {
                let (left, right) = (left.row(y), right.row(y));
                for x in xs.clone() {
                    // NaN converts to 0 here and is skipped below.
                    let disparity = map[y * width + x];
                    let there = x as i32 - (disparity + 0.5).floor() as i32;
                    let other = usize::try_from(there).ok().and_then(|x| right.get(x));
                    if let (Some(other), false) = (other, disparity.is_nan()) {
                        sums.add(left[x], *other);
                    }
                }
            }
            sums
        });
        self.own.merge_neighbors(&mut self.joined, PairSums::join);
        self.near.columns = self.joined.columns;
        self.near.cells.clear();
        let correlations = self.joined.cells.par_iter().map(|l| l.correlation());
        self.near.cells.par_extend(correlations);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Random;

    /// Pixels in the neighborhood of a pixel.
    fn around(width: usize, height: usize, x: usize, y: usize) -> Vec<(usize, usize)> {
        let reach = |v: usize, most: usize| {
            let cell = v / CELL_PX * CELL_PX;
            cell.saturating_sub(CELL_PX)..(cell + 2 * CELL_PX).min(most)
        };
        let columns = reach(x, width);
        let row = |y| columns.clone().map(move |x| (x, y));
        reach(y, height).flat_map(row).collect()
    }

    #[test]
    fn neighborhoods_are_twelve_by_twelve_pixels() {
        let mut random = Random(41);
        for (width, height) in [(1, 1), (9, 13), (33, 18)] {
            let map: Vec<f32> = (0..width * height)
                .map(|_| match random.below(3) {
                    0 => f32::NAN,
                    _ => random.below(50) as f32,
                })
                .collect();
            let mut local_stats = LocalStats::default();
            local_stats.compute(width, &map);
            for (x, y) in [(0, 0), (width - 1, height - 1), (width / 2, height / 2)] {
                let near = around(width, height, x, y);
                let values: Vec<f32> = near.iter().map(|(x, y)| map[y * width + x]).collect();
                let found: Vec<f32> = values.iter().copied().filter(|v| !v.is_nan()).collect();
                let stats = local_stats.near.at(x, y);
                assert_eq!(usize::from(stats.all), values.len());
                assert_eq!(usize::from(stats.found), found.len());
                assert_eq!(
                    stats.min,
                    found.iter().copied().fold(f32::INFINITY, f32::min)
                );
                let max = found.iter().copied().fold(f32::NEG_INFINITY, f32::max);
                assert_eq!(stats.max, max);
            }
        }
    }

    #[test]
    fn correlations_equal_those_computed_from_pixels() {
        let mut random = Random(42);
        let (width, height) = (37, 22);
        let left = random.image(width, height);
        let noise = random.image(width, height);
        let right: Vec<u8> = left
            .iter()
            .zip(&noise)
            .map(|(a, b)| a / 2 + b / 4)
            .collect();
        let map: Vec<f32> = (0..width * height)
            .map(|_| match random.below(4) {
                0 => f32::NAN,
                k => k as f32 * 3.0 - 2.7,
            })
            .collect();
        let images = [&left, &right].map(|eye| ImageView::packed(width, height, eye).unwrap());
        let mut correlation = Correlation::default();
        correlation.compute(&images[0], &images[1], &map);
        for (x, y) in [(0, 0), (7, 5), (18, 11), (30, 15)] {
            let mut pairs = Vec::new();
            for (x, y) in around(width, height, x, y) {
                let disparity = map[y * width + x];
                let there = x as f32 - disparity.round();
                if !disparity.is_nan() && there >= 0.0 && there < width as f32 {
                    let at = |eye: &[u8], x: usize| f64::from(eye[y * width + x]);
                    pairs.push([at(&left, x), at(&right, there as usize)]);
                }
            }
            let count = pairs.len() as f64;
            let mean = [0, 1].map(|k| pairs.iter().map(|p| p[k]).sum::<f64>() / count);
            let common = |a: usize, b: usize| {
                let of = pairs.iter().map(|p| (p[a] - mean[a]) * (p[b] - mean[b]));
                of.sum::<f64>() / count
            };
            let whole = (common(0, 0) * common(1, 1)).sqrt() + 0.1;
            let enough = f64::from(u8::from(count >= f64::from(MIN_PIXELS)));
            let expected = enough * common(0, 1) / whole;
            let found = f64::from(correlation.near.at(x, y));
            assert!((found - expected).abs() < 1e-3, "{found} {expected}");
        }
    }

    #[test]
    fn textureless_images_have_zero_correlation() {
        let even = vec![70; 30 * 20];
        let image = ImageView::packed(30, 20, &even).unwrap();
        let mut correlation = Correlation::default();
        correlation.compute(&image, &image, &vec![0.0; 30 * 20]);
        assert_eq!(correlation.near.at(9, 9), 0.0);
        let mut random = Random(43);
        let scene = random.scene(30, 20);
        let image = ImageView::packed(30, 20, &scene).unwrap();
        correlation.compute(&image, &image, &vec![0.0; 30 * 20]);
        assert!(correlation.near.at(9, 9) > 0.99);
        correlation.compute(&image, &image, &vec![f32::NAN; 30 * 20]);
        assert_eq!(correlation.near.at(9, 9), 0.0);
    }
}
