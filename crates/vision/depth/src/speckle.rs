//! Speckle filter: removes small connected regions of a disparity map.
//!
//! Contract: pixels that share a side and whose disparities differ by at most a step are in one
//! region; regions with fewer than a minimum number of consistent pixels become absent. The upper
//! and the lower half are processed in parallel and joined, which gives the same regions as one
//! pass over the whole map.

use rayon::prelude::*;

/// Union-find over pixels: the parent of a pixel is an earlier pixel of its region; the first pixel
/// is its own parent.
#[derive(Debug, Default)]
pub(crate) struct SpeckleFilter {
    parents: Vec<u32>,
    sizes: Vec<u32>,
}

impl SpeckleFilter {
    /// Removes the regions of fewer than `min_px` consistent pixels from a map; NaN means absent.
    pub(crate) fn remove(
        &mut self,
        width: usize,
        map: &mut [f32],
        is_consistent: impl Fn(usize) -> bool + Sync,
        step: f32,
        min_px: usize,
    ) {
        if min_px <= 1 || map.is_empty() {
            return;
        }
        let count = map.len();
        self.parents.resize(count, 0);
        self.sizes.resize(count, 0);
        let middle = count / width / 2 * width;
        let (upper, lower) = self.parents.split_at_mut(middle);
        let (upper_sizes, lower_sizes) = self.sizes.split_at_mut(middle);
        let input = &*map;
        rayon::join(
            || join_rows(width, 0, upper, &input[..middle], step),
            || join_rows(width, middle, lower, &input[middle..], step),
        );
        let counts = &is_consistent;
        rayon::join(
            || count_pixels(0, upper, upper_sizes, counts),
            || count_pixels(middle, lower, lower_sizes, counts),
        );
        // Join across the seam. Only the roots of regions change.
        if middle > 0 {
            for i in middle..middle + width {
                if (input[i] - input[i - width]).abs() <= step {
                    let (first, second) = join(&mut self.parents, 0, i, i - width);
                    if first != second {
                        self.sizes[first] += self.sizes[second];
                    }
                }
            }
        }
        let (parents, sizes) = (&self.parents, &self.sizes);
        let rows = map.par_chunks_mut(width).zip(parents.par_chunks(width));
        rows.for_each(|(row, of_row)| {
            for (value, parent) in row.iter_mut().zip(of_row) {
                let mut root = *parent as usize;
                while parents[root] as usize != root {
                    root = parents[root] as usize;
                }
                if (sizes[root] as usize) < min_px {
                    *value = f32::NAN;
                }
            }
        });
    }
}

/// Makes every parent the root of its region, and counts the consistent pixels of a region at its
/// root. The first pixel has the index `base`.
fn count_pixels(
    base: usize,
    parents: &mut [u32],
    sizes: &mut [u32],
    is_consistent: &(impl Fn(usize) -> bool + Sync),
) {
    sizes.fill(0);
    for i in 0..parents.len() {
        // The parents of earlier pixels are roots already.
        let root = parents[parents[i] as usize - base];
        parents[i] = root;
        sizes[root as usize - base] += u32::from(is_consistent(base + i));
    }
}

/// Joins the pixels of consecutive rows, whose first pixel has the index `base`.
fn join_rows(width: usize, base: usize, parents: &mut [u32], map: &[f32], step: f32) {
    for (i, value) in map.iter().enumerate() {
        parents[i] = (base + i) as u32;
        if i % width > 0 && (value - map[i - 1]).abs() <= step {
            // The previous pixel is in the same region, and no pixel has this one as its parent
            // yet.
            parents[i] = parents[i - 1];
        }
        if i >= width && (value - map[i - width]).abs() <= step {
            join(parents, base, base + i, base + i - width);
        }
    }
}

/// Joins two regions. The root with the larger index becomes a child of the other one, so that
/// parents precede children. Returns both roots.
fn join(parents: &mut [u32], base: usize, a: usize, b: usize) -> (usize, usize) {
    let (a, b) = (root(parents, base, a), root(parents, base, b));
    let (first, second) = (a.min(b), a.max(b));
    parents[second - base] = first as u32;
    (first, second)
}

/// Root of a region, with path compression.
fn root(parents: &mut [u32], base: usize, of: usize) -> usize {
    let mut at = of;
    loop {
        let parent = parents[at - base] as usize;
        if parent == at {
            return at;
        }
        let above = parents[parent - base];
        parents[at - base] = above;
        at = above as usize;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Random;

    /// Reference implementation: flood fill from every pixel.
    fn reference(
        width: usize,
        map: &[f32],
        is_consistent: impl Fn(usize) -> bool,
        step: f32,
        min_px: usize,
    ) -> Vec<f32> {
        let height = map.len() / width;
        let min_speckle_px = |from: usize| {
            let mut input = vec![false; map.len()];
            let mut open = vec![from];
            input[from] = true;
            let mut size = 0;
            while let Some(i) = open.pop() {
                size += usize::from(is_consistent(i));
                let (x, y) = (i % width, i / width);
                let mut near = Vec::new();
                near.extend((x > 0).then(|| i - 1));
                near.extend((x + 1 < width).then_some(i + 1));
                near.extend((y > 0).then(|| i - width));
                near.extend((y + 1 < height).then_some(i + width));
                for k in near {
                    if !input[k] && (map[k] - map[i]).abs() <= step {
                        input[k] = true;
                        open.push(k);
                    }
                }
            }
            size
        };
        let kept = |i: usize| {
            if min_speckle_px(i) >= min_px {
                map[i]
            } else {
                f32::NAN
            }
        };
        (0..map.len()).map(kept).collect()
    }

    #[test]
    fn regions_equal_those_of_the_reference() {
        let mut random = Random(31);
        let mut speckle_filter = SpeckleFilter::default();
        for (width, height) in [(1, 1), (1, 7), (17, 1), (24, 19), (30, 30)] {
            for min_px in [0, 2, 6, 20] {
                let map: Vec<f32> = (0..width * height)
                    .map(|_| match random.below(8) {
                        0 => f32::NAN,
                        v => (v / 3) as f32,
                    })
                    .collect();
                let mut found = map.clone();
                let is_consistent = |i: usize| !i.is_multiple_of(5);
                speckle_filter.remove(width, &mut found, is_consistent, 1.0, min_px);
                let expected = reference(width, &map, is_consistent, 1.0, min_px);
                let same = |(a, b): (&f32, &f32)| a == b || (a.is_nan() && b.is_nan());
                assert!(found.iter().zip(&expected).all(same), "{width} {min_px}");
            }
        }
    }
}
