//! Least and greatest depth of areas of an image, by a pyramid: blocks that a view cannot change
//! are skipped as a whole.

use super::cells::{CellRow, Cells};

/// See the module. Level 0 are the cells of the image, each level halves.
#[derive(Debug)]
pub(crate) struct DepthPyramid {
    levels: Vec<Level>,
}

#[derive(Debug)]
struct Level {
    size: [usize; 2],
    /// Least and greatest depth; infinite and 0 without depth.
    range: Vec<[f32; 2]>,
}

const NOTHING: [f32; 2] = [f32::INFINITY, 0.0];

fn union(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

impl DepthPyramid {
    pub(crate) fn new(cells: &Cells) -> Self {
        let size = cells.size;
        let of_row = |row: &CellRow| {
            let of = |i: usize| [row.min_depth[i], row.max_depth[i]];
            (1..=size[0]).map(of).collect::<Vec<[f32; 2]>>()
        };
        let range = cells.rows.iter().flat_map(of_row).collect();
        let mut levels = vec![Level { size, range }];
        while let Some(below) = levels
            .last()
            .filter(|level| level.size.iter().any(|k| *k > 1))
        {
            let size = below.size.map(|k| k.div_ceil(2));
            let mut range = vec![NOTHING; size[0] * size[1]];
            for (i, of) in below.range.iter().enumerate() {
                let at = i / below.size[0] / 2 * size[0] + i % below.size[0] / 2;
                range[at] = union(range[at], *of);
            }
            levels.push(Level { size, range });
        }
        Self { levels }
    }

    /// Least and greatest depth of the cells from one to another, both included; `None` without
    /// depth. Areas may be somewhat larger than stated.
    pub(crate) fn range(&self, from: [usize; 2], to: [usize; 2]) -> Option<[f32; 2]> {
        let extent = (to[0] - from[0]).max(to[1] - from[1]) + 1;
        // At most 5 x 5 entries.
        let level = (extent / 4)
            .checked_ilog2()
            .map_or(0, |level| level as usize + 1);
        let level = level.min(self.levels.len() - 1);
        let Level { size, range } = &self.levels[level];
        let mut found = NOTHING;
        for row in from[1] >> level..=(to[1] >> level).min(size[1] - 1) {
            for column in from[0] >> level..=(to[0] >> level).min(size[0] - 1) {
                found = union(found, range[row * size[0] + column]);
            }
        }
        (found[0] <= found[1]).then_some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_contain_those_of_the_cells() {
        let size = [37, 22];
        let mut cells = Cells::default();
        cells.resize(size);
        for (i, row) in cells.rows.iter_mut().enumerate() {
            for j in (0..size[0]).filter(|j| (i + j) % 5 != 0) {
                let counter = (i * size[0] + j) as u64;
                let depth = counter_random::uniform(1, 2, counter) as f32 + 1.0;
                (row.min_depth[j + 1], row.max_depth[j + 1]) = (depth, depth);
            }
        }
        let pyramid = DepthPyramid::new(&cells);
        for (from, to) in [
            ([0, 0], [0, 0]),
            ([3, 2], [9, 4]),
            ([0, 0], [36, 21]),
            ([30, 20], [36, 21]),
        ] {
            let found = pyramid.range(from, to).unwrap_or(NOTHING);
            for row in from[1]..=to[1] {
                for column in from[0]..=to[0] {
                    let cells = &cells.rows[row];
                    assert!(cells.max_depth[column + 1] <= found[1]);
                    assert!(cells.min_depth[column + 1] >= found[0]);
                }
            }
        }
        assert_eq!(pyramid.range([0, 0], [0, 0]), None);
    }
}
