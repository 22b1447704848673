//! Median filter over 3x3 disparities.
//!
//! Absent neighbors, and those outside the image, count as the disparity itself. Absent disparities
//! remain absent.

use rayon::prelude::*;

use crate::lanes::{Kernel, Lanes, Level};

/// Writes the medians of `map` to `filtered`; NaN means absent.
pub(crate) fn median(level: Level, width: usize, map: &[f32], filtered: &mut Vec<f32>) {
    filtered.resize(map.len(), f32::NAN);
    let height = map.len() / width;
    let rows = filtered.par_chunks_exact_mut(width).enumerate();
    rows.for_each_init(
        || [0; 3].map(|_| vec![f32::NAN; width.next_multiple_of(CHUNK) + 2]),
        |near, (y, to)| {
            for (k, row) in near.iter_mut().enumerate() {
                let inside = (y + k).checked_sub(1).filter(|y| *y < height);
                match inside {
                    Some(y) => row[1..=width].copy_from_slice(&map[y * width..(y + 1) * width]),
                    None => row.fill(f32::NAN),
                }
            }
            let [above, here, below] = near;
            level.run(Row {
                near: [above, here, below],
                to,
            });
        },
    );
}

/// Filters one row. The neighbor rows start one pixel before it and extend to one pixel after its
/// last, possibly partial, chunk of [`CHUNK`] pixels.
struct Row<'a> {
    near: [&'a [f32]; 3],
    to: &'a mut [f32],
}

/// Number of pixels that are sorted in parallel.
const CHUNK: usize = 128;

impl Kernel for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let width = self.to.len();
        let mut nine = [[0.0; CHUNK]; 9];
        for from in (0..width).step_by(CHUNK) {
            let at = |k: usize| &self.near[k / 3][from + k % 3..][..CHUNK];
            let middle = at(4);
            for (k, values) in nine.iter_mut().enumerate() {
                let row = at(k);
                for i in 0..CHUNK {
                    values[i] = if row[i].is_nan() { middle[i] } else { row[i] };
                }
            }
            sort_to_middle(&mut nine);
            let count = CHUNK.min(width - from);
            self.to[from..][..count].copy_from_slice(&nine[4][..count]);
        }
    }
}

/// Sorting network for the median of nine, for several pixels: the three columns are sorted, then
/// the median is that of the maximum of the minima, the median of the medians and the minimum of
/// the maxima. The result is at index 4.
#[inline(always)]
fn sort_to_middle(nine: &mut [[f32; CHUNK]; 9]) {
    for column in 0..3 {
        sort(nine, column, column + 3);
        sort(nine, column + 3, column + 6);
        sort(nine, column, column + 3);
    }
    // The maximum of the three minima moves to index 2, the minimum of the three maxima to 6.
    sort(nine, 0, 1);
    sort(nine, 1, 2);
    sort(nine, 7, 8);
    sort(nine, 6, 7);
    // The median of the three medians moves to index 4.
    sort(nine, 3, 4);
    sort(nine, 4, 5);
    sort(nine, 3, 4);
    sort(nine, 2, 4);
    sort(nine, 4, 6);
    sort(nine, 2, 4);
}

/// Orders two values. NaN is compared with NaN only: a pixel without disparity has nine of them.
#[inline(always)]
fn sort(nine: &mut [[f32; CHUNK]; 9], first: usize, second: usize) {
    for i in 0..CHUNK {
        let (a, b) = (nine[first][i], nine[second][i]);
        nine[first][i] = if b < a { b } else { a };
        nine[second][i] = if b < a { a } else { b };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{self, Random};

    #[test]
    fn medians_equal_those_of_sorted_neighborhoods() {
        let mut random = Random(21);
        for (level, (width, height)) in reference::with_levels([(1, 1), (3, 2), (40, 9)]) {
            let map: Vec<f32> = (0..width * height)
                .map(|_| match random.below(4) {
                    0 => f32::NAN,
                    _ => random.below(100) as f32 / 4.0,
                })
                .collect();
            let mut found = Vec::new();
            median(level, width, &map, &mut found);
            for (i, found) in found.into_iter().enumerate() {
                let (x, y) = ((i % width) as i32, (i / width) as i32);
                let here = map[i];
                let mut nine: Vec<f32> = (0..9)
                    .map(|k| {
                        let (x, y) = (x + k % 3 - 1, y + k / 3 - 1);
                        let inside = x >= 0 && y >= 0 && x < width as i32 && y < height as i32;
                        let value = |(): ()| map[y as usize * width + x as usize];
                        let value = inside.then_some(()).map_or(f32::NAN, value);
                        if value.is_nan() { here } else { value }
                    })
                    .collect();
                nine.sort_by(f32::total_cmp);
                if here.is_nan() {
                    assert!(found.is_nan());
                } else {
                    assert_eq!(found, nine[4], "{level:?} {x} {y}");
                }
            }
        }
    }
}
