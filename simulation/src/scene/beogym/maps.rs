//! Walkable levels of a point cloud.
//!
//! The points of a cell form clusters along the vertical. A flat cluster with head room above is a
//! surface, its height the median of its points; what stands higher than a step above a surface and
//! lower than the head room is an obstacle. A cell without points is unknown. Nothing is blurred or
//! filled. The lowest surface of each cell is level 0; surfaces above it, such as bridges, are
//! level 1 and so on.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use scene_bundle::outputs::grid::{Grid, MAX_GRID_SIDE};
use scene_bundle::outputs::maps::{FREE, KNOWN, MapLevel, OCCUPIED, UNCERTAIN};

use super::BeogymConfig;
use crate::scene::measures::{complete, neighbors};

/// Most cells of a map.
const MAX_CELLS: usize = 1 << 26;
/// Vertical extent of a surface in a cell beyond which it is a wall, m: a cell of 10 cm on a slope
/// of 60 degrees, with noise.
const MAX_THICKNESS_M: f64 = 0.25;
/// Vertical gap between clusters, m.
const MIN_GAP_M: f64 = 0.15;
/// Sigma of a height from which a cell is flagged as uncertain, m.
const MAX_CERTAIN_SIGMA_M: f64 = 0.01;
/// Reach of the plane for a normal, cells.
const NORMAL_CELLS: isize = 2;
/// A cell whose lowest surface is higher than a step and this slope above the lowest one nearby
/// has no ground hit: it is a wall or a canopy. Cells around it, and rise per metre.
const LOCAL_CELLS: isize = 5;
const MAX_SLOPE: f64 = 0.7;

/// A cluster of points of a cell.
#[derive(Clone, Copy, Debug)]
struct Cluster {
    low: f64,
    high: f64,
    median: f64,
    sigma: f64,
    count: usize,
}

/// The levels of points in a world with z up, or why there are none.
pub(super) fn levels(points: &[[f64; 3]], config: &BeogymConfig) -> Result<Vec<MapLevel>, String> {
    let grid = grid(points, config)?;
    let mut columns: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for [x, y, z] in points {
        if let Some(cell) = grid.cell([*x, *y]) {
            columns.entry(cell).or_default().push(*z);
        }
    }
    let columns: BTreeMap<usize, Vec<Cluster>> = columns
        .into_iter()
        .map(|(cell, heights)| (cell, clusters(heights, config)))
        .collect();
    let lowest = ground(&columns, grid, config);
    let mut all: Vec<MapLevel> = Vec::new();
    for (cell, clusters) in &columns {
        let mut number = 0;
        for (index, cluster) in clusters.iter().enumerate() {
            let is_flat = cluster.high - cluster.low <= MAX_THICKNESS_M;
            let is_ground = index > 0 || lowest.contains(cell);
            let above = &clusters[index + 1..];
            let head = above
                .iter()
                .map(|of| of.low - cluster.median)
                .find(|gap| *gap > config.max_step_m);
            let has_room = head.is_none_or(|gap| gap >= config.head_room_m);
            if !is_flat || !is_ground {
                continue;
            }
            // What is close above a surface stands on it; only open surfaces are higher levels.
            if number > 0 && !has_room {
                continue;
            }
            if all.len() <= number {
                all.push(MapLevel::unknown(grid));
            }
            set(&mut all[number], *cell, cluster, head, has_room);
            number += 1;
        }
        // Only a wall: an obstacle of the ground.
        if number == 0 {
            if all.is_empty() {
                all.push(MapLevel::unknown(grid));
            }
            all[0].occupancy[*cell] = OCCUPIED;
        }
    }
    let min_cells = config.min_level_m2 / (config.cell_m * config.cell_m);
    let count = |level: &MapLevel| level.flags.iter().filter(|flags| **flags != 0).count() as f64;
    let mut number = 0;
    all.retain(|level| {
        number += 1;
        number == 1 || count(level) >= min_cells
    });
    for level in &mut all {
        normals(level);
        complete(level);
    }
    if all.first().is_none_or(|level| count(level) == 0.0) {
        return Err("no level ground in the points".to_owned());
    }
    Ok(all)
}

fn grid(points: &[[f64; 3]], config: &BeogymConfig) -> Result<Grid, String> {
    let mut corners = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    for point in points {
        for k in 0..2 {
            corners[0][k] = corners[0][k].min(point[k]);
            corners[1][k] = corners[1][k].max(point[k]);
        }
    }
    if points.is_empty() || config.cell_m.is_nan() || config.cell_m <= 0.0 {
        return Err(format!(
            "{} points and cells of {} m",
            points.len(),
            config.cell_m
        ));
    }
    // Centers of cells at multiples of their size.
    let [first, last] = corners.map(|corner| corner.map(|v| (v / config.cell_m).round()));
    let [columns, rows] = [0, 1].map(|k| (last[k] - first[k] + 1.0) as usize);
    let is_small = columns <= MAX_GRID_SIDE && rows <= MAX_GRID_SIDE;
    if !is_small || columns * rows > MAX_CELLS {
        return Err(format!("a map of {columns} x {rows} cells"));
    }
    Ok(Grid {
        cell_m: config.cell_m,
        origin_m: first.map(|v| v * config.cell_m),
        columns,
        rows,
    })
}

fn clusters(mut heights: Vec<f64>, config: &BeogymConfig) -> Vec<Cluster> {
    heights.sort_by(f64::total_cmp);
    let parts = heights.chunk_by(|a, b| b - a <= MIN_GAP_M);
    let parts = parts.filter(|part| part.len() >= config.min_points);
    let cluster = |part: &[f64]| {
        let mean = part.iter().sum::<f64>() / part.len() as f64;
        let squares: f64 = part.iter().map(|z| (z - mean) * (z - mean)).sum();
        Cluster {
            low: part[0],
            high: part[part.len() - 1],
            median: part[part.len() / 2],
            sigma: (squares / part.len() as f64).sqrt(),
            count: part.len(),
        }
    };
    parts.map(cluster).collect()
}

/// Cells whose lowest cluster is ground: not far above the lowest one nearby.
fn ground(
    columns: &BTreeMap<usize, Vec<Cluster>>,
    grid: Grid,
    config: &BeogymConfig,
) -> std::collections::BTreeSet<usize> {
    let lowest = |cell: usize| Some(columns.get(&cell)?.first()?.median);
    let is_ground = |cell: &usize| {
        let Some(height) = lowest(*cell) else {
            return false;
        };
        neighbors(grid, *cell, LOCAL_CELLS).all(|other| {
            let offset = [grid.center_m(*cell), grid.center_m(other)];
            let away = (offset[0][0] - offset[1][0]).hypot(offset[0][1] - offset[1][1]);
            lowest(other).is_none_or(|of| height - of <= config.max_step_m + MAX_SLOPE * away)
        })
    };
    columns.keys().copied().filter(is_ground).collect()
}

fn set(level: &mut MapLevel, cell: usize, of: &Cluster, head_m: Option<f64>, is_free: bool) {
    level.elevation[cell] = of.median as f32;
    (level.lower[cell], level.upper[cell]) = (of.low as f32, of.high as f32);
    // Of a median of independent points; no less than a millimetre.
    let sigma = (1.2533 * of.sigma / (of.count as f64).sqrt()).max(0.001);
    level.sigma[cell] = sigma as f32;
    level.clearance[cell] = head_m.map_or(f32::INFINITY, |gap| gap as f32);
    level.views[cell] = of.count.min(255) as u8;
    level.flags[cell] = KNOWN;
    if sigma > MAX_CERTAIN_SIGMA_M {
        level.flags[cell] |= UNCERTAIN;
    }
    level.occupancy[cell] = if is_free { FREE } else { OCCUPIED };
}

/// Normals and slopes of the planes of least squares through the cells around.
pub(super) fn normals(level: &mut MapLevel) {
    for cell in 0..level.grid.cells() {
        if !level.has_height(cell) {
            continue;
        }
        let [x, y] = level.grid.center_m(cell);
        let z = f64::from(level.elevation[cell]);
        let (mut matrix, mut right) = (Matrix3::<f64>::zeros(), Vector3::zeros());
        // Surfaces beyond a step edge are others.
        let max_m = |away: f64| 0.05 + MAX_SLOPE * away;
        for other in neighbors(level.grid, cell, NORMAL_CELLS).chain([cell]) {
            let [dx, dy] = level.grid.center_m(other);
            let row = Vector3::new(dx - x, dy - y, 1.0);
            let height = f64::from(level.elevation[other]) - z;
            if level.has_height(other) && height.abs() <= max_m(row.xy().norm()) {
                matrix += row * row.transpose();
                right += row * height;
            }
        }
        let plane = matrix.cholesky().map(|of| of.solve(&right));
        let gradient = plane
            .filter(|p| p.iter().all(|v| v.is_finite()))
            .unwrap_or_default();
        let normal = Vector3::new(-gradient.x, -gradient.y, 1.0).normalize();
        level.normal[cell] = normal.map(|v| v as f32).into();
        level.slope[cell] = libm::acos(normal.z.min(1.0)) as f32;
    }
}
