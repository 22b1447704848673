//! Connected parts of the ground.

use super::layer::Layer;
use crate::agent::AgentConfig;

/// Numbers the connected parts, over all levels, in the order of their first cells.
pub(super) fn label(layers: &mut [Layer], agent: &AgentConfig) {
    let mut next = 0;
    let mut open: Vec<(usize, usize)> = Vec::new();
    for level in 0..layers.len() {
        for cell in 0..layers[level].grid().cells() {
            if layers[level].walkable_m(cell).is_none() || layers[level].has_component(cell) {
                continue;
            }
            layers[level].set_component(cell, next);
            open.push((level, cell));
            while let Some((level, cell)) = open.pop() {
                for (level, cell) in neighbors(layers, agent.max_step_m, level, cell) {
                    if !layers[level].has_component(cell) {
                        layers[level].set_component(cell, next);
                        open.push((level, cell));
                    }
                }
            }
            next += 1;
        }
    }
}

/// Cells to which the agent can step from one: the eight around on its level, diagonal ones only
/// between free ones, and on other levels those at their places; each at most a step higher or
/// lower.
pub(crate) fn neighbors(
    layers: &[Layer],
    max_step_m: f64,
    level: usize,
    cell: usize,
) -> Vec<(usize, usize)> {
    let grid = layers[level].grid();
    let Some(height_m) = layers[level].walkable_m(cell) else {
        return Vec::new();
    };
    let (column, row) = ((cell % grid.columns) as i64, (cell / grid.columns) as i64);
    let mut found = Vec::with_capacity(8);
    for (number, layer) in layers.iter().enumerate() {
        for (x, y) in AROUND.map(|(x, y)| (column + x, row + y)) {
            let other = if number == level {
                let inside =
                    (0..grid.columns as i64).contains(&x) && (0..grid.rows as i64).contains(&y);
                inside.then(|| y as usize * grid.columns + x as usize)
            } else {
                let at = [x, y].map(|cells| cells as f64 * grid.cell_m);
                layer
                    .grid()
                    .cell([grid.origin_m[0] + at[0], grid.origin_m[1] + at[1]])
            };
            let Some(other) = other else { continue };
            let is_diagonal = x != column && y != row;
            let is_beside = |x: i64, y: i64| {
                layers[level]
                    .walkable_m(y as usize * grid.columns + x as usize)
                    .is_some()
            };
            if number == level && is_diagonal && !(is_beside(x, row) && is_beside(column, y)) {
                continue;
            }
            let is_step = |to: f32| f64::from((to - height_m).abs()) <= max_step_m;
            if layer.walkable_m(other).is_some_and(is_step) {
                found.push((number, other));
            }
        }
    }
    found
}

const AROUND: [(i64, i64); 8] = [
    (-1, -1),
    (0, -1),
    (1, -1),
    (-1, 0),
    (1, 0),
    (-1, 1),
    (0, 1),
    (1, 1),
];
