//! The part of a plane that was observed, as a grid on it.

/// Cells of a plane, with a count each.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct SupportGrid {
    pub(crate) cell_m: f64,
    /// Cell of the first entry.
    pub(crate) from: [i32; 2],
    /// Cells along both axes.
    pub(crate) size: [usize; 2],
    pub(crate) counts: Vec<u16>,
}

impl SupportGrid {
    /// An empty grid around coordinates, with a margin.
    pub(crate) fn around(
        cell_m: f64,
        coordinates: impl Iterator<Item = [f64; 2]>,
        margin_m: f64,
    ) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for at in coordinates {
            for k in 0..2 {
                low[k] = low[k].min(at[k]);
                high[k] = high[k].max(at[k]);
            }
        }
        if low[0] > high[0] {
            return Self {
                cell_m,
                ..Self::default()
            };
        }
        let from = low.map(|k| ((k - margin_m) / cell_m).floor() as i32);
        let to = high.map(|k| ((k + margin_m) / cell_m).floor() as i32 + 1);
        let size = [0, 1].map(|k| (to[k] - from[k]) as usize);
        Self {
            cell_m,
            from,
            size,
            counts: vec![0; size[0] * size[1]],
        }
    }

    /// Index of the cell of coordinates, if the grid has it.
    pub(crate) fn index(&self, at: [f64; 2]) -> Option<usize> {
        let cell = [0, 1].map(|k| (at[k] / self.cell_m).floor() as i32 - self.from[k]);
        let inside = (0..2).all(|k| cell[k] >= 0 && (cell[k] as usize) < self.size[k]);
        inside.then(|| cell[1] as usize * self.size[0] + cell[0] as usize)
    }

    pub(crate) fn add(&mut self, at: [f64; 2]) {
        if let Some(index) = self.index(at) {
            self.counts[index] = self.counts[index].saturating_add(1);
        }
    }

    /// Adds to all cells whose centers are in a square around coordinates, or to the one there.
    pub(crate) fn add_square(&mut self, at: [f64; 2], reach_m: f64) {
        if reach_m <= 0.5 * self.cell_m {
            self.add(at);
            return;
        }
        let cell = |offset: f64| at.map(|k| ((k + offset) / self.cell_m - 0.5).ceil() as i32);
        let (from, to) = (cell(-reach_m), cell(reach_m));
        for y in from[1]..to[1] {
            for x in from[0]..to[0] {
                self.add([x, y].map(|k| (f64::from(k) + 0.5) * self.cell_m));
            }
        }
    }

    /// A share of the median count of the cells that have one; at least 1.
    pub(crate) fn min_count(&self, share: f64) -> u16 {
        let mut counts: Vec<u16> = self
            .counts
            .iter()
            .copied()
            .filter(|count| *count > 0)
            .collect();
        counts.sort_unstable();
        let median = counts.get(counts.len() / 2).copied().unwrap_or(0);
        ((share * f64::from(median)).round() as u16).max(1)
    }

    /// Coordinates of the center of a cell.
    pub(crate) fn center(&self, index: usize) -> [f64; 2] {
        let cell = [index % self.size[0], index / self.size[0]];
        [0, 1].map(|k| (f64::from(self.from[k]) + cell[k] as f64 + 0.5) * self.cell_m)
    }

    /// Cells with at least a count.
    pub(crate) fn mask(&self, min_count: u16) -> Vec<bool> {
        self.counts
            .iter()
            .map(|count| *count >= min_count)
            .collect()
    }

    /// A mask after a number of steps of growing (`true`) or shrinking by a cell to all eight
    /// sides.
    pub(crate) fn grown(&self, mask: &[bool], steps: usize, grows: bool) -> Vec<bool> {
        let [width, height] = self.size;
        let mut mask = mask.to_vec();
        for _ in 0..steps {
            let at = |mask: &[bool], x: usize, y: usize| {
                let inside = (1..=width).contains(&x) && (1..=height).contains(&y);
                inside && mask[(y - 1) * width + x - 1]
            };
            let next = (0..mask.len()).map(|i| {
                let (x, y) = (i % width + 1, i / width + 1);
                let mut around = (0..9).map(|k| at(&mask, x + k % 3 - 1, y + k / 3 - 1));
                match grows {
                    true => around.any(|is| is),
                    false => around.all(|is| is),
                }
            });
            mask = next.collect();
        }
        mask
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_grow_and_shrink() {
        let mut grid = SupportGrid::around(0.1, [[0.0, 0.0], [0.5, 0.3]].into_iter(), 0.15);
        assert_eq!(grid.size, [9, 7]);
        for i in 0..15 {
            grid.add([0.05 + 0.1 * (i % 5) as f64, 0.05 + 0.1 * (i / 5) as f64]);
        }
        let mask = grid.mask(1);
        let count = |mask: &[bool]| mask.iter().filter(|is| **is).count();
        assert_eq!(count(&mask), 15);
        assert_eq!(count(&grid.grown(&mask, 1, false)), 3);
        assert_eq!(count(&grid.grown(&mask, 1, true)), 35);
        assert_eq!(grid.center(grid.index([0.05, 0.05]).unwrap()), [0.05, 0.05]);
        assert_eq!(grid.index([9.0, 0.0]), None);
        // Three by three cells of 10 cm, around a point.
        let mut square = SupportGrid::around(0.1, [[0.0, 0.0], [0.5, 0.5]].into_iter(), 0.2);
        square.add_square([0.25, 0.25], 0.15);
        square.add([0.25, 0.25]);
        assert_eq!(count(&square.mask(1)), 9);
        assert_eq!((square.min_count(2.0), square.min_count(0.1)), (2, 1));
    }
}
