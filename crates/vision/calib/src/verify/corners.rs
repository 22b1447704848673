//! Corner detection (Shi and Tomasi 1994).
//!
//! The response is the smaller eigenvalue of the second moments of the gradients. One corner per
//! cell of a grid, so that they cover the image.

use super::config::CornerConfig;
use imaging::Level;

/// Radius of the window of second moments.
const WINDOW_RADIUS: usize = 3;

/// Corners of a level, the strongest of each cell, at most `most`, in the order of cells.
pub(super) fn corners(level: &Level, most: usize, config: &CornerConfig) -> Vec<[f32; 2]> {
    let (cell, margin) = (config.cell_px, config.margin_px);
    let (width, height) = (level.width, level.height);
    if width < 4 * margin || height < 4 * margin {
        return Vec::new();
    }
    let moments = moments(level);
    let side = (2 * WINDOW_RADIUS + 1) as f32;
    let strength = |x: usize, y: usize| {
        let [a, b, c] = moments[y * width + x].map(|m| m / (side * side));
        0.5 * (a + c - ((a - c) * (a - c) + 4.0 * b * b).sqrt())
    };
    let mut found: Vec<(f32, [f32; 2])> = Vec::new();
    for top in (margin..height - margin).step_by(cell) {
        for left in (margin..width - margin).step_by(cell) {
            let mut best = (config.min_response, None);
            for y in top..(top + cell).min(height - margin) {
                for x in left..(left + cell).min(width - margin) {
                    let s = strength(x, y);
                    if s > best.0 {
                        best = (s, Some([x as f32, y as f32]));
                    }
                }
            }
            found.extend(best.1.map(|at| (best.0, at)));
        }
    }
    let mut order: Vec<f32> = found.iter().map(|f| f.0).collect();
    order.sort_by(|a, b| b.total_cmp(a));
    let strong = order.get(order.len() / 10).copied().unwrap_or(0.0);
    let least = order
        .get(most)
        .copied()
        .unwrap_or(0.0)
        .max(config.min_response_ratio * strong);
    let kept = found.into_iter().filter(|f| f.0 > least);
    kept.map(|f| f.1).collect()
}

/// Sums of `gx²`, `gx gy` and `gy²` over the window of each pixel.
fn moments(level: &Level) -> Vec<[f32; 3]> {
    let (width, height) = (level.width, level.height);
    let mut rows = vec![[0.0_f32; 3]; width * height];
    let mut products = vec![[0.0_f32; 3]; width];
    for y in 1..height - 1 {
        let at = |y: usize| &level.data[y * width..(y + 1) * width];
        let (above, row, below) = (at(y - 1), at(y), at(y + 1));
        for x in 1..width - 1 {
            let half = |a: u8, b: u8| 0.5 * (f32::from(a) - f32::from(b));
            let gx = half(row[x + 1], row[x - 1]);
            let gy = half(below[x], above[x]);
            products[x] = [gx * gx, gx * gy, gy * gy];
        }
        slide(&products, &mut rows[y * width..(y + 1) * width]);
    }
    let mut sums = vec![[0.0_f32; 3]; width * height];
    for y in WINDOW_RADIUS..height - WINDOW_RADIUS {
        for x in 0..width {
            let mut sum = [0.0; 3];
            for k in y - WINDOW_RADIUS..=y + WINDOW_RADIUS {
                let row = &rows[k * width + x];
                (0..3).for_each(|i| sum[i] += row[i]);
            }
            sums[y * width + x] = sum;
        }
    }
    sums
}

/// Sums over `2 WINDOW_RADIUS + 1` neighbours along a row.
fn slide(values: &[[f32; 3]], out: &mut [[f32; 3]]) {
    for x in WINDOW_RADIUS..values.len() - WINDOW_RADIUS {
        let mut sum = [0.0; 3];
        for value in &values[x - WINDOW_RADIUS..=x + WINDOW_RADIUS] {
            (0..3).for_each(|i| sum[i] += value[i]);
        }
        out[x] = sum;
    }
}
