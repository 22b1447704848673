//! Search for a patch of the left image in the right one, in a band around the epipolar line that
//! is wide enough for eyes rotated against each other.
//!
//! Normalized cross-correlation at whole pixels of a reduced level. A match with a second peak of
//! nearly the same correlation is dropped, since repeated texture is ambiguous.

use super::config::SearchConfig;
use imaging::{Level, Patch};

/// Radius of a patch.
const RADIUS: usize = 4;
const SIDE: usize = 2 * RADIUS + 1;
const AREA: usize = SIDE * SIDE;

/// Search area: first and last column and row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Area {
    pub(super) x: [f64; 2],
    pub(super) y: [f64; 2],
}

/// The whole pixel in `right` with the best correlation to the patch around `at` in `left`.
pub(super) fn search(
    left: &Level,
    right: &Level,
    at: [f32; 2],
    area: &Area,
    config: &SearchConfig,
) -> Option<[f32; 2]> {
    let mut template: Patch<SIDE> = [[0.0; SIDE]; SIDE];
    if !left.sample_patch(at[0], at[1], &mut template) {
        return None;
    }
    let values = template.as_flattened_mut();
    let mean = values.iter().sum::<f32>() / AREA as f32;
    values.iter_mut().for_each(|v| *v -= mean);
    let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt();
    if norm < 1.0 {
        return None;
    }
    let range = |[from, to]: [f64; 2], size: usize| {
        let last = size.checked_sub(RADIUS + 1)?;
        let from = from.floor().max(RADIUS as f64) as usize;
        let to = to.ceil().min(last as f64).max(0.0) as usize;
        (from <= to).then_some((from, to))
    };
    let (x0, x1) = range(area.x, right.width)?;
    let (y0, y1) = range(area.y, right.height)?;
    let columns = x1 - x0 + 1;
    let mut scores = Vec::with_capacity(columns * (y1 - y0 + 1));
    for y in y0..=y1 {
        for x in x0..=x1 {
            scores.push(correlation(right, x, y, &template) / norm);
        }
    }
    let place = |i: usize| (x0 + i % columns, y0 + i / columns);
    let best = (0..scores.len()).max_by(|a, b| scores[*a].total_cmp(&scores[*b]))?;
    if scores[best] < config.min_ncc {
        return None;
    }
    let (x, y) = place(best);
    let elsewhere = (0..scores.len()).filter(|i| {
        let (u, v) = place(*i);
        u.abs_diff(x) > config.peak_radius_px || v.abs_diff(y) > config.peak_radius_px
    });
    let second = elsewhere.map(|i| scores[i]).fold(-1.0, f32::max);
    let is_clear = 1.0 - second > config.min_ncc_ratio * (1.0 - scores[best]);
    is_clear.then_some([x as f32, y as f32])
}

/// Product of the template with the patch around a pixel, over the norm of the patch without its
/// mean.
fn correlation(level: &Level, x: usize, y: usize, template: &Patch<SIDE>) -> f32 {
    let (mut sum, mut square, mut product) = (0.0, 0.0, 0.0);
    for (k, row) in template.iter().enumerate() {
        let from = (y - RADIUS + k) * level.width + x - RADIUS;
        for (a, b) in row.iter().zip(&level.data[from..from + SIDE]) {
            let b = f32::from(*b);
            sum += b;
            square += b * b;
            product += a * b;
        }
    }
    let variance = square - sum * sum / AREA as f32;
    if variance < 1.0 {
        return -1.0;
    }
    product / variance.sqrt()
}
