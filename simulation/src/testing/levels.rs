//! Walkable levels of exact surfaces, as output `maps` has them.

use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::{EDGE, FREE, KNOWN, MapLevel, OCCUPIED, UNKNOWN};

use super::surfaces::{Patch, Surfaces};
use crate::scene::measures::{MIN_EDGE_M, complete, slope_of};

/// An obstacle is between the height of a step and head room above the ground, m.
const OBSTACLE_M: [f64; 2] = [0.2, 1.9];

/// The levels of a scene in the cells of a rectangle.
pub(crate) fn levels(
    surfaces: &Surfaces,
    min_m: [f64; 2],
    max_m: [f64; 2],
    cell_m: f64,
) -> Vec<MapLevel> {
    let numbers = surfaces.patches.iter().filter_map(|patch| patch.level);
    let count = numbers.max().map_or(0, |last| last + 1);
    let [columns, rows] =
        [0, 1].map(|k| ((max_m[k] - min_m[k]) / cell_m).round().max(1.0) as usize);
    let grid = Grid {
        cell_m,
        origin_m: min_m.map(|v| v + 0.5 * cell_m),
        columns,
        rows,
    };
    (0..count)
        .map(|number| level(surfaces, number, grid))
        .collect()
}

fn level(surfaces: &Surfaces, number: usize, grid: Grid) -> MapLevel {
    let mut level = MapLevel::unknown(grid);
    let is_of_level = |patch: &&Patch| patch.level == Some(number);
    let patches: Vec<&Patch> = surfaces.patches.iter().filter(is_of_level).collect();
    let highest = |at: [f64; 2]| {
        let heights = patches
            .iter()
            .filter_map(|patch| Some((patch.height_m(at)?, patch.normal())));
        heights.max_by(|a, b| a.0.total_cmp(&b.0))
    };
    for cell in 0..grid.cells() {
        let center = grid.center_m(cell);
        let Some((z, normal)) = highest(center) else {
            continue;
        };
        // Just inside of the border: what begins there is not in the cell.
        let reach = 0.499 * grid.cell_m;
        let offsets = [-reach, 0.0, reach];
        let corners = offsets
            .iter()
            .flat_map(|dx| offsets.map(|dy| [center[0] + dx, center[1] + dy]));
        let heights = corners
            .filter_map(|at| Some(highest(at)?.0))
            .map(|z| z as f32);
        let (low, high) = heights.fold((z as f32, z as f32), |(l, h), z| (l.min(z), h.max(z)));
        let above = surfaces.ray_m([center[0], center[1], z + 1e-6], [0.0, 0.0, 1.0]);
        level.elevation[cell] = z as f32;
        (level.lower[cell], level.upper[cell]) = (low, high);
        level.sigma[cell] = 0.001;
        level.normal[cell] = normal.map(|v| v as f32);
        level.slope[cell] = libm::acos(normal[2].min(1.0)) as f32;
        level.clearance[cell] = above.map_or(f32::INFINITY, |z| z as f32);
        level.views[cell] = 20;
        level.flags[cell] = KNOWN;
        level.occupancy[cell] = FREE;
        if f64::from(high - low) > MIN_EDGE_M + 1.5 * grid.cell_m * slope_of(normal) {
            level.flags[cell] |= EDGE;
        }
    }
    mark_obstacles(&mut level, surfaces, &patches);
    complete(&mut level);
    level
}

/// Cells that a box touches are occupied; what is below of it is not seen.
fn mark_obstacles(level: &mut MapLevel, surfaces: &Surfaces, patches: &[&Patch]) {
    let grid = level.grid;
    for [low, high] in &surfaces.obstacles {
        for cell in 0..grid.cells() {
            let center = grid.center_m(cell);
            // A border on a border does not touch.
            let reach = 0.5 * grid.cell_m - 1e-6;
            let touches = (0..2).all(|k| low[k] < center[k] + reach && high[k] > center[k] - reach);
            if !touches {
                continue;
            }
            // Without ground below it stands on its own.
            let ground = patches.iter().filter_map(|patch| patch.height_m(center));
            let ground = ground.max_by(f64::total_cmp).unwrap_or(low[2]);
            if high[2] > ground + OBSTACLE_M[0] && low[2] < ground + OBSTACLE_M[1] {
                forget(level, cell);
                level.occupancy[cell] = OCCUPIED;
            }
        }
    }
}

fn forget(level: &mut MapLevel, cell: usize) {
    for layer in [
        &mut level.elevation,
        &mut level.lower,
        &mut level.upper,
        &mut level.sigma,
        &mut level.slope,
        &mut level.clearance,
    ] {
        layer[cell] = f32::NAN;
    }
    level.normal[cell] = [f32::NAN; 3];
    (level.views[cell], level.flags[cell], level.occupancy[cell]) = (0, 0, UNKNOWN);
}
