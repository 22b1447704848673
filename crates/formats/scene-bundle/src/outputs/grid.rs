//! Grids over the world seen from above, as in the outputs `maps` and `collision`.

use serde::{Deserialize, Serialize};

use super::Fault;

/// Largest number of columns and of rows.
pub const MAX_GRID_SIDE: usize = 65535;

/// A grid of square cells: x of the world along the columns, y along the rows. Values of its cells
/// are row-major, the row of least y first.
///
/// ```
/// use scene_bundle::outputs::grid::Grid;
///
/// let grid = Grid { cell_m: 0.5, origin_m: [10.0, 20.0], columns: 4, rows: 3 };
/// assert_eq!(grid.cells(), 12);
/// assert_eq!(grid.center_m(6), [11.0, 20.5]);
/// assert_eq!(grid.cell([11.2, 20.3]), Some(6));
/// assert_eq!(grid.cell([9.7, 20.3]), None);
/// // Cells reach half a cell beyond their centers.
/// assert_eq!(grid.corner_m(), [9.75, 19.75]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Edge of a cell, m.
    pub cell_m: f64,
    /// Center of the first cell, x and y in the world, m.
    pub origin_m: [f64; 2],
    /// Number of columns, at most [`MAX_GRID_SIDE`].
    pub columns: usize,
    /// Number of rows, at most [`MAX_GRID_SIDE`].
    pub rows: usize,
}

impl Grid {
    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.columns * self.rows
    }

    /// Center of a cell, x and y in the world, m.
    pub fn center_m(&self, index: usize) -> [f64; 2] {
        let cell = [index % self.columns, index / self.columns];
        [0, 1].map(|k| self.origin_m[k] + cell[k] as f64 * self.cell_m)
    }

    /// The cell that contains a position, x and y in the world, m.
    pub fn cell(&self, at: [f64; 2]) -> Option<usize> {
        let corner = self.corner_m();
        let [column, row] = [0, 1].map(|k| (at[k] - corner[k]) / self.cell_m);
        let is_inside =
            (0.0..self.columns as f64).contains(&column) && (0.0..self.rows as f64).contains(&row);
        is_inside.then(|| row as usize * self.columns + column as usize)
    }

    /// Corner of the first cell at least x and y, m.
    pub fn corner_m(&self) -> [f64; 2] {
        self.origin_m.map(|v| v - 0.5 * self.cell_m)
    }

    /// Size in x and y, from the first border to the last, m.
    pub fn size_m(&self) -> [f64; 2] {
        [self.columns, self.rows].map(|count| count as f64 * self.cell_m)
    }

    pub(crate) fn check(&self, place: &str) -> Result<(), Fault> {
        let sides = 1..=MAX_GRID_SIDE;
        if !sides.contains(&self.columns) || !sides.contains(&self.rows) {
            let found = format!("{} columns and {} rows", self.columns, self.rows);
            return Err(Fault::new(place, found, "1 to 65535 of each"));
        }
        if !(self.cell_m.is_finite() && self.cell_m > 0.0) {
            let found = format!("cells of {} m", self.cell_m);
            return Err(Fault::new(place, found, "a positive number"));
        }
        if self.origin_m.iter().any(|v| !v.is_finite()) {
            let found = format!("an origin at {:?}", self.origin_m);
            return Err(Fault::new(place, found, "finite numbers"));
        }
        Ok(())
    }
}
