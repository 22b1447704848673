//! Division of levels that are mostly empty.
//!
//! A grid takes memory by its box, which grows with the square of a walk that goes across it: a
//! kilometre at 45 degrees to the axes would have 300 million cells of 4 cm, a hundred times its
//! ground.

use std::collections::BTreeMap;

use super::floors::Place;
use super::samples::Cell;
use crate::config::MapConfig;

/// The box of some cells: first and last row, first and last column.
#[derive(Clone, Copy)]
struct Extent {
    rows: [i32; 2],
    columns: [i32; 2],
}

impl Extent {
    fn of(cells: impl Iterator<Item = Cell>) -> Self {
        let (mut rows, mut columns) = ([i32::MAX, i32::MIN], [i32::MAX, i32::MIN]);
        for (row, column) in cells {
            rows = [rows[0].min(row), rows[1].max(row)];
            columns = [columns[0].min(column), columns[1].max(column)];
        }
        Self { rows, columns }
    }

    /// Rows and columns.
    fn sides(&self) -> [i64; 2] {
        [self.rows, self.columns].map(|[first, last]| 1 + i64::from(last) - i64::from(first))
    }

    fn exceeds_limits(&self, cells: usize, config: &MapConfig) -> bool {
        let [rows, columns] = self.sides();
        let in_box = rows * columns;
        let is_sparse = (cells as f64) < config.min_level_share * in_box as f64;
        let is_large = in_box > config.max_level_cells as i64;
        (is_large && is_sparse) || rows.max(columns) > config.max_level_side as i64
    }
}

/// The pieces of a level: the level itself, or parts of it that overlap.
pub(super) fn divide(
    level: BTreeMap<Cell, usize>,
    config: &MapConfig,
) -> Vec<BTreeMap<Cell, usize>> {
    let whole = Extent::of(level.keys().copied());
    if !whole.exceeds_limits(level.len(), config) {
        return vec![level];
    }
    let mut open: Vec<Vec<Place>> = vec![level.iter().map(|(cell, own)| (*cell, *own)).collect()];
    let mut pieces = Vec::new();
    while let Some(cells) = open.pop() {
        let extent = Extent::of(cells.iter().map(|(cell, _)| *cell));
        if !extent.exceeds_limits(cells.len(), config) {
            pieces.push(with_margin(&level, &extent, config));
            continue;
        }
        let [rows, columns] = extent.sides();
        let middle = |[first, last]: [i32; 2]| first.midpoint(last);
        let (before, behind) =
            cells
                .into_iter()
                .partition(|((row, column), _)| match rows >= columns {
                    true => *row <= middle(extent.rows),
                    false => *column <= middle(extent.columns),
                });
        open.extend([behind, before]);
    }
    pieces
}

/// The cells of a level in a box and around it.
fn with_margin(
    level: &BTreeMap<Cell, usize>,
    extent: &Extent,
    config: &MapConfig,
) -> BTreeMap<Cell, usize> {
    let margin = (0.5 * config.level_overlap_m / config.cell_m).ceil() as i32;
    let wider = |[first, last]: [i32; 2]| [first - margin, last + margin];
    let ([first, last], [left, right]) = (wider(extent.rows), wider(extent.columns));
    let rows = level.range((first, i32::MIN)..=(last, i32::MAX));
    let inside = rows.filter(|((_, column), _)| (left..=right).contains(column));
    inside.map(|(cell, own)| (*cell, *own)).collect()
}
