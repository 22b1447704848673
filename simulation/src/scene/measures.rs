//! Layers of a level that follow from its heights, normals and occupancy.

use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::{EDGE, FREE, MapLevel};

/// Height difference between cells beyond their slopes that is an edge, m. This and the following
/// values are those of the stage `maps`.
pub(crate) const MIN_EDGE_M: f64 = 0.03;
/// Reach of the layers `step` and `roughness`, m.
const STEP_REACH_M: f64 = 0.12;
/// Slope, step and roughness at which traversability is 0.
const MAX_MEASURES: [f64; 3] = [0.6, 0.2, 0.05];

/// Fills steps, roughness, traversability, flags of edges and distances.
pub(crate) fn complete(level: &mut MapLevel) {
    measure(level);
    distances(level);
}

/// Rise per metre of a plane with this normal.
pub(crate) fn slope_of(normal: [f64; 3]) -> f64 {
    normal[0].hypot(normal[1]) / normal[2].max(0.05)
}

/// Height of another cell above the plane of a cell, m.
fn above_plane(level: &MapLevel, cell: usize, other: usize, height: f32) -> f64 {
    let [from, to] = [cell, other].map(|cell| level.grid.center_m(cell));
    let [nx, ny, nz] = level.normal[cell].map(f64::from);
    let by_slope = -(nx * (to[0] - from[0]) + ny * (to[1] - from[1])) / nz.max(0.05);
    f64::from(height) - f64::from(level.elevation[cell]) - by_slope
}

/// Cells within a number of cells around one.
pub(crate) fn neighbors(grid: Grid, cell: usize, reach: isize) -> impl Iterator<Item = usize> {
    let (columns, rows) = (grid.columns as isize, grid.rows as isize);
    let (x, y) = (cell as isize % columns, cell as isize / columns);
    let offsets = (-reach..=reach).flat_map(move |dy| (-reach..=reach).map(move |dx| [dx, dy]));
    offsets.filter_map(move |[dx, dy]| {
        let is_near = dx * dx + dy * dy <= reach * reach && [dx, dy] != [0, 0];
        let is_inside = (0..columns).contains(&(x + dx)) && (0..rows).contains(&(y + dy));
        (is_near && is_inside).then_some(((y + dy) * columns + x + dx) as usize)
    })
}

/// Step, roughness, traversability, and edges beside a cell.
fn measure(level: &mut MapLevel) {
    let reach = (STEP_REACH_M / level.grid.cell_m).round().max(1.0) as isize;
    for cell in 0..level.grid.cells() {
        if !level.has_height(cell) {
            continue;
        }
        let normal = level.normal[cell].map(f64::from);
        let inside = f64::from(level.upper[cell] - level.lower[cell]);
        let mut step = (inside - 1.5 * level.grid.cell_m * slope_of(normal)).max(0.0);
        let (mut squares, mut count) = (0.0, 1.0);
        for other in neighbors(level.grid, cell, reach) {
            if level.has_height(other) {
                for height in [level.lower[other], level.upper[other]] {
                    step = step.max(above_plane(level, cell, other, height).abs());
                }
                squares += above_plane(level, cell, other, level.elevation[other]).powi(2);
                count += 1.0;
            }
        }
        let roughness = (squares / count).sqrt();
        let measures = [f64::from(level.slope[cell]), step, roughness];
        let shares = [0, 1, 2].map(|k| 1.0 - measures[k] / MAX_MEASURES[k]);
        (level.step[cell], level.roughness[cell]) = (step as f32, roughness as f32);
        level.traversability[cell] = shares.into_iter().fold(1.0, f64::min).max(0.0) as f32;
    }
    let beside: Vec<usize> = (0..level.grid.cells())
        .filter(|cell| neighbors(level.grid, *cell, 1).any(|other| is_edge(level, *cell, other)))
        .collect();
    for cell in beside {
        level.flags[cell] |= EDGE;
    }
}

/// Whether neighboring heights differ by more than either slope explains.
fn is_edge(level: &MapLevel, cell: usize, other: usize) -> bool {
    let jump = |from: usize, to: usize| above_plane(level, from, to, level.elevation[to]).abs();
    let has_both = level.has_height(cell) && level.has_height(other);
    has_both && jump(cell, other).min(jump(other, cell)) > MIN_EDGE_M
}

/// Signed distances to borders between cells: those of free ground, and edges. The grid is doubled,
/// centers of cells have odd coordinates, borders even ones.
fn distances(level: &mut MapLevel) {
    let grid = level.grid;
    let [width, height] = [2 * grid.columns + 1, 2 * grid.rows + 1];
    let mut is_border = vec![false; width * height];
    for cell in 0..grid.cells() {
        let (x, y) = (cell % grid.columns, cell / grid.columns);
        let node = (2 * y + 1) * width + 2 * x + 1;
        let beside = [
            (x + 1 < grid.columns, cell + 1, node + 1),
            (y + 1 < grid.rows, cell + grid.columns, node + width),
        ];
        for (exists, other, border) in beside {
            let is_free = |cell: usize| level.occupancy[cell] == FREE;
            is_border[border] =
                exists && (is_free(cell) != is_free(other) || is_edge(level, cell, other));
        }
    }
    let squares = squared_distances(&is_border, width);
    for cell in 0..grid.cells() {
        let (x, y) = (cell % grid.columns, cell / grid.columns);
        let square = squares[(2 * y + 1) * width + 2 * x + 1];
        let distance = 0.5 * grid.cell_m * square.sqrt();
        let sign = if level.occupancy[cell] == FREE {
            1.0
        } else {
            -1.0
        };
        level.distance[cell] = (sign * distance) as f32;
    }
}

/// Squared distance of every node to the nearest one that is set: along rows, then over columns.
fn squared_distances(is_set: &[bool], width: usize) -> Vec<f64> {
    let height = is_set.len() / width;
    if !is_set.contains(&true) {
        return vec![f64::INFINITY; is_set.len()];
    }
    let mut along = vec![f64::INFINITY; is_set.len()];
    for row in 0..height {
        let mut sweep = |columns: &mut dyn Iterator<Item = usize>| {
            let mut distance = f64::INFINITY;
            for column in columns {
                let node = row * width + column;
                distance = if is_set[node] { 0.0 } else { distance + 1.0 };
                along[node] = along[node].min(distance);
            }
        };
        sweep(&mut (0..width));
        sweep(&mut (0..width).rev());
    }
    let mut squares = along.clone();
    for column in 0..width {
        for row in 0..height {
            let mut best = along[row * width + column].powi(2);
            for away in 1..height {
                let square = (away * away) as f64;
                if square >= best {
                    break;
                }
                for other in [row.checked_sub(away), Some(row + away)]
                    .into_iter()
                    .flatten()
                {
                    if other < height {
                        best = best.min(square + along[other * width + column].powi(2));
                    }
                }
            }
            squares[row * width + column] = best;
        }
    }
    squares
}
