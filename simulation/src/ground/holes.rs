//! Bridges over small holes in what was seen.
//!
//! Contract: a hole is a connected set of unknown cells (also over corners) whose rim is all free
//! ground: neither an obstacle nor the border of the map touches it. It is bridged by the plane
//! through its rim where its area is at most [`AgentConfig::max_hole_m2`] and no cell of the rim is
//! farther from the plane than [`AgentConfig::max_residual_m`]. Everything else that was not seen
//! stays unknown.

use scene_bundle::outputs::grid::Grid;

use crate::agent::AgentConfig;

/// What a cell is for bridging.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Its height is known and nothing is on it.
    Free,
    /// Not seen.
    Unknown,
    /// Anything else.
    Other,
}

/// A hole with the plane over it.
#[derive(Clone, Debug)]
pub(super) struct Bridge {
    /// Its cells.
    pub(super) cells: Vec<usize>,
    /// A point of the plane, m.
    center_m: [f64; 3],
    /// Slopes of the plane along x and y.
    pub(super) slope: [f64; 2],
    /// Root mean square distance of the rim from the plane, m.
    pub(super) sigma_m: f64,
}

impl Bridge {
    /// Height of the plane, m.
    pub(super) fn height_m(&self, at_m: [f64; 2]) -> f64 {
        let [x, y] = [0, 1].map(|k| at_m[k] - self.center_m[k]);
        self.center_m[2] + self.slope[0] * x + self.slope[1] * y
    }
}

/// All bridges of a level, in the order of their first cells.
pub(super) fn find(
    grid: &Grid,
    agent: &AgentConfig,
    kind: impl Fn(usize) -> Kind,
    height_m: impl Fn(usize) -> f64,
) -> Vec<Bridge> {
    let most = agent.max_hole_m2 / (grid.cell_m * grid.cell_m);
    let (columns, rows) = (grid.columns, grid.rows);
    let mut is_done = vec![false; grid.cells()];
    let mut bridges = Vec::new();
    for first in 0..grid.cells() {
        if is_done[first] || kind(first) != Kind::Unknown {
            continue;
        }
        is_done[first] = true;
        let (mut cells, mut rim) = (vec![first], Vec::new());
        let mut is_enclosed = true;
        let mut next = 0;
        // All cells of the hole are visited, also of one that is too large: each belongs to one.
        while next < cells.len() {
            let (column, row) = (cells[next] % columns, cells[next] / columns);
            next += 1;
            if column == 0 || row == 0 || column + 1 == columns || row + 1 == rows {
                is_enclosed = false;
            }
            for y in row.saturating_sub(1)..=(row + 1).min(rows - 1) {
                for x in column.saturating_sub(1)..=(column + 1).min(columns - 1) {
                    let cell = y * columns + x;
                    match kind(cell) {
                        Kind::Unknown if !is_done[cell] => {
                            is_done[cell] = true;
                            cells.push(cell);
                        }
                        Kind::Unknown => {}
                        Kind::Free => rim.push(cell),
                        Kind::Other => is_enclosed = false,
                    }
                }
            }
        }
        if is_enclosed && cells.len() as f64 <= most {
            rim.sort_unstable();
            rim.dedup();
            bridges.extend(bridge(grid, agent, cells, &rim, &height_m));
        }
    }
    bridges
}

/// The plane of least squares through the rim, where the rim lies on it.
fn bridge(
    grid: &Grid,
    agent: &AgentConfig,
    cells: Vec<usize>,
    rim: &[usize],
    height_m: impl Fn(usize) -> f64,
) -> Option<Bridge> {
    let points = rim.iter().map(|cell| {
        let [x, y] = grid.center_m(*cell);
        [x, y, height_m(*cell)]
    });
    let count = rim.len() as f64;
    let mut center_m = [0.0; 3];
    for point in points.clone() {
        for (sum, value) in center_m.iter_mut().zip(point) {
            *sum += value / count;
        }
    }
    let [mut xx, mut xy, mut yy, mut xz, mut yz] = [0.0; 5];
    for point in points.clone() {
        let [x, y, z] = [0, 1, 2].map(|k| point[k] - center_m[k]);
        xx += x * x;
        xy += x * y;
        yy += y * y;
        xz += x * z;
        yz += y * z;
    }
    // A rim encloses its hole: it has extent along both axes.
    let determinant = xx * yy - xy * xy;
    let slope = [
        (yy * xz - xy * yz) / determinant,
        (xx * yz - xy * xz) / determinant,
    ];
    let mut bridge = Bridge {
        cells,
        center_m,
        slope,
        sigma_m: 0.0,
    };
    let mut squares = 0.0;
    for [x, y, z] in points {
        let residual_m = (z - bridge.height_m([x, y])).abs();
        if !(residual_m <= agent.max_residual_m) {
            return None;
        }
        squares += residual_m * residual_m;
    }
    bridge.sigma_m = (squares / count).sqrt();
    Some(bridge)
}
