//! Least and greatest depth of areas of an image, by a pyramid: blocks that a view cannot change
//! are skipped as a whole.

use super::frame::Cell;

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
    pub(crate) fn new(size: [usize; 2], cells: &[Cell]) -> Self {
        let range = cells
            .iter()
            .map(|cell| [cell.min_depth, cell.max_depth])
            .collect();
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
        let cells: Vec<Cell> = (0..size[0] * size[1])
            .map(|i| {
                let depth = counter_random::uniform(1, 2, i as u64) as f32 + 1.0;
                let is_empty = i % 5 == 0;
                Cell {
                    min_depth: if is_empty { f32::INFINITY } else { depth },
                    max_depth: if is_empty { 0.0 } else { depth },
                    ..Cell::default()
                }
            })
            .collect();
        let pyramid = DepthPyramid::new(size, &cells);
        for (from, to) in [
            ([0, 0], [0, 0]),
            ([3, 2], [9, 4]),
            ([0, 0], [36, 21]),
            ([30, 20], [36, 21]),
        ] {
            let found = pyramid.range(from, to).unwrap_or(NOTHING);
            for row in from[1]..=to[1] {
                for column in from[0]..=to[0] {
                    let cell = &cells[row * size[0] + column];
                    assert!(cell.max_depth <= found[1] && cell.min_depth >= found[0]);
                }
            }
        }
        assert_eq!(pyramid.range([0, 0], [0, 0]), None);
    }
}
