//! Corner detector: Shi–Tomasi on a grid.
//!
//! The score is the smaller eigenvalue of the second moments of the gradients (Shi and Tomasi, Good
//! Features to Track, 1994); the pixel with the highest score in each free cell of a grid is a
//! corner. A cell is free if it contains no tracked feature and none is near its best corner. Cells
//! without texture remain empty.

use crate::config::DetectorConfig;
use imaging::Level;

/// Radius of the window over which gradients are summed, and width of the image border without
/// corners, px.
const WINDOW_RADIUS_PX: usize = 3;
const BORDER_PX: usize = WINDOW_RADIUS_PX + 5;

/// Search area and limits.
pub(crate) struct Search<'a> {
    /// Side of a cell, px.
    pub(crate) cell: usize,
    /// Positions of tracked features, px.
    pub(crate) occupied: &'a [[f32; 2]],
    /// Mask, row-major, one byte per pixel: no corners at 0.
    pub(crate) mask: Option<&'a [u8]>,
    /// Maximum number of corners.
    pub(crate) max_count: usize,
}

/// Detects corners in free cells, the strongest first.
pub(crate) fn detect(config: &DetectorConfig, level: &Level, search: &Search<'_>) -> Vec<[f32; 2]> {
    let (columns, rows) = (level.width / search.cell, level.height / search.cell);
    let mut free = vec![true; columns * rows];
    for [x, y] in search.occupied {
        let (column, row) = (*x as usize / search.cell, *y as usize / search.cell);
        if column < columns && row < rows {
            free[row * columns + column] = false;
        }
    }
    let min_distance = (search.cell / 2) as f32;
    let mut found: Vec<(f32, [f32; 2])> = Vec::new();
    let mut scores = Scores::default();
    for (k, _) in free.iter().enumerate().filter(|(_, free)| **free) {
        let left = (k % columns * search.cell).max(BORDER_PX);
        let top = (k / columns * search.cell).max(BORDER_PX);
        let right = ((k % columns + 1) * search.cell).min(level.width - BORDER_PX);
        let bottom = ((k / columns + 1) * search.cell).min(level.height - BORDER_PX);
        if left >= right || top >= bottom {
            continue;
        }
        scores.compute(level, [left, top], [right, bottom]);
        let mut best = (config.min_eigenvalue as f32, None);
        for (i, score) in scores.values.iter().enumerate() {
            if *score <= best.0 {
                continue;
            }
            let (x, y) = (left + i % (right - left), top + i / (right - left));
            let masked = search.mask.is_some_and(|m| m[y * level.width + x] == 0);
            let at = [x as f32, y as f32];
            let near = |other: &[f32; 2]| {
                (other[0] - at[0]).abs() < min_distance && (other[1] - at[1]).abs() < min_distance
            };
            if masked
                || search.occupied.iter().any(near)
                || found.iter().any(|(_, other)| near(other))
            {
                continue;
            }
            best = (*score, Some(at));
        }
        if let (score, Some(at)) = best {
            found.push((score, at));
        }
    }
    // Cells are in order and the sort is stable, so that equal scores have a fixed order.
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate(search.max_count);
    found.into_iter().map(|(_, at)| at).collect()
}

/// Scores of a rectangle, with buffers.
#[derive(Default)]
struct Scores {
    values: Vec<f32>,
    products: [Vec<f32>; 3],
    columns: [Vec<f32>; 3],
}

impl Scores {
    fn compute(&mut self, level: &Level, from: [usize; 2], to: [usize; 2]) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor supports the target features of the function, as checked above.
            unsafe { self.compute_avx2(level, from, to) };
            return;
        }
        self.compute_portable(level, from, to);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn compute_avx2(&mut self, level: &Level, from: [usize; 2], to: [usize; 2]) {
        self.compute_portable(level, from, to);
    }

    #[inline(always)]
    fn compute_portable(&mut self, level: &Level, from: [usize; 2], to: [usize; 2]) {
        const SIDE: usize = 2 * WINDOW_RADIUS_PX + 1;
        let (width, height) = (to[0] - from[0], to[1] - from[1]);
        let (wide, high) = (width + SIDE - 1, height + SIDE - 1);
        for products in &mut self.products {
            products.clear();
            products.resize(wide * high, 0.0);
        }
        let [xx, xy, yy] = &mut self.products;
        for row in 0..high {
            let at = (from[1] + row - WINDOW_RADIUS_PX) * level.width + from[0] - WINDOW_RADIUS_PX;
            let here = &level.data[at - 1..at + wide + 1];
            let above = &level.data[at - level.width..][..wide];
            let below = &level.data[at + level.width..][..wide];
            let out = row * wide..(row + 1) * wide;
            let (xx, xy, yy) = (
                &mut xx[out.clone()],
                &mut xy[out.clone()],
                &mut yy[out.clone()],
            );
            for i in 0..wide {
                let gx = 0.5 * (f32::from(here[i + 2]) - f32::from(here[i]));
                let gy = 0.5 * (f32::from(below[i]) - f32::from(above[i]));
                xx[i] = gx * gx;
                xy[i] = gx * gy;
                yy[i] = gy * gy;
            }
        }
        // Sums over columns, then over rows. Each sum is computed from scratch, so that it does not
        // depend on the origin of the rectangle.
        for (products, columns) in self.products.iter().zip(&mut self.columns) {
            columns.clear();
            columns.resize(wide * height, 0.0);
            for row in 0..height {
                let out = &mut columns[row * wide..(row + 1) * wide];
                for k in 0..SIDE {
                    let line = &products[(row + k) * wide..][..wide];
                    for i in 0..wide {
                        out[i] += line[i];
                    }
                }
            }
        }
        self.values.clear();
        let scale = 1.0 / (SIDE * SIDE) as f32;
        for row in 0..height {
            let sums = |c: &[f32], i: usize| -> f32 {
                c[row * wide + i..row * wide + i + SIDE].iter().sum::<f32>() * scale
            };
            for i in 0..width {
                let (a, b, c) = (
                    sums(&self.columns[0], i),
                    sums(&self.columns[1], i),
                    sums(&self.columns[2], i),
                );
                let half = 0.5 * (a - c);
                self.values
                    .push(0.5 * (a + c) - (half * half + b * b).sqrt());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gray image with white squares.
    fn level(squares: &[[usize; 2]]) -> Level {
        let (width, height) = (160, 120);
        let mut data = vec![80; width * height];
        for [x, y] in squares {
            for row in *y..y + 12 {
                data[row * width + x..row * width + x + 12].fill(200);
            }
        }
        Level {
            width,
            height,
            data,
        }
    }

    fn search<'a>(occupied: &'a [[f32; 2]], mask: Option<&'a [u8]>) -> Search<'a> {
        Search {
            cell: 40,
            occupied,
            mask,
            max_count: 100,
        }
    }

    #[test]
    fn corners_of_squares_are_found_and_blank_cells_are_empty() {
        let level = level(&[[50, 50], [100, 20]]);
        let found = detect(&Default::default(), &level, &search(&[], None));
        assert!(!found.is_empty());
        let is_corner = |at: &[f32; 2]| {
            [[50, 50], [100, 20]].iter().any(|[x, y]| {
                [[0, 0], [11, 0], [0, 11], [11, 11]].iter().any(|[dx, dy]| {
                    (at[0] - (x + dx) as f32).abs() < 4.0 && (at[1] - (y + dy) as f32).abs() < 4.0
                })
            })
        };
        assert!(found.iter().all(is_corner), "{found:?}");
    }

    #[test]
    fn occupied_and_masked_cells_are_skipped() {
        let level = level(&[[50, 50]]);
        let occupied = [[55.0, 55.0]];
        assert!(detect(&Default::default(), &level, &search(&occupied, None)).is_empty());
        let mask = vec![0; 160 * 120];
        assert!(detect(&Default::default(), &level, &search(&[], Some(&mask))).is_empty());
    }
}
