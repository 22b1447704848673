//! Small holes, filled by the plane of their rim and flagged.

use nalgebra::{Matrix3, Vector3};

use super::level::{EDGE, FILLED, Level};
use crate::config::MapConfig;

/// Fills holes that are narrow, closed, and have a plane rim without edges.
pub(super) fn fill(level: &mut Level, config: &MapConfig) {
    let mut is_visited = vec![false; level.flags.len()];
    for start in 0..level.flags.len() {
        if is_visited[start] || level.has_height(start) {
            continue;
        }
        let hole = hole(level, start, &mut is_visited);
        let Some(hole) = hole.filter(|hole| is_narrow(level, hole, config)) else {
            continue;
        };
        let Some((plane, sigma)) = rim_plane(level, &hole, config) else {
            continue;
        };
        let norm = (1.0 + plane[1] * plane[1] + plane[2] * plane[2]).sqrt();
        for index in hole {
            let [x, y] = level.center(index);
            let z = (plane[0] + plane[1] * x + plane[2] * y) as f32;
            (
                level.elevation[index],
                level.lower[index],
                level.upper[index],
            ) = (z, z, z);
            level.sigma[index] = (2.0 * sigma) as f32;
            level.normal[index] = [-plane[1], -plane[2], 1.0].map(|v| (v / norm) as f32);
            level.clearance[index] = f32::INFINITY;
            level.flags[index] |= FILLED;
        }
    }
}

/// Cells without height that are connected; `None` if they reach the border of the grid.
fn hole(level: &Level, start: usize, is_visited: &mut [bool]) -> Option<Vec<usize>> {
    let [width, height] = level.size;
    let (mut cells, mut next, mut is_closed) = (vec![start], 0, true);
    is_visited[start] = true;
    while next < cells.len() {
        let index = cells[next];
        next += 1;
        let (x, y) = (index % width, index / width);
        if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
            is_closed = false;
        }
        let mut others = Vec::new();
        others.extend((x > 0).then(|| index - 1));
        others.extend((x + 1 < width).then(|| index + 1));
        others.extend((y > 0).then(|| index - width));
        others.extend((y + 1 < height).then(|| index + width));
        for other in others {
            if !is_visited[other] && !level.has_height(other) {
                is_visited[other] = true;
                cells.push(other);
            }
        }
    }
    is_closed.then_some(cells)
}

/// Whether every cell of a hole is within half of the width of its rim.
fn is_narrow(level: &Level, hole: &[usize], config: &MapConfig) -> bool {
    hole.iter().all(|index| {
        let reach = 0.5 * config.max_hole_m + 0.5 * level.cell_m;
        level.near(*index, reach).next().is_some()
    })
}

/// Plane of the cells around a hole, and their largest sigma.
fn rim_plane(level: &Level, hole: &[usize], config: &MapConfig) -> Option<(Vector3<f64>, f64)> {
    let mut rim: Vec<usize> = hole
        .iter()
        .flat_map(|index| {
            level
                .near(*index, 1.5 * level.cell_m)
                .map(|(other, _)| other)
        })
        .filter(|other| level.flags[*other] & FILLED == 0)
        .collect();
    rim.sort_unstable();
    rim.dedup();
    if rim.len() < 6 {
        return None;
    }
    let [x0, y0] = level.center(rim[0]);
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    let mut sigma: f64 = 0.0;
    for index in &rim {
        if level.flags[*index] & EDGE != 0 {
            return None;
        }
        let [x, y] = level.center(*index);
        let at = Vector3::new(1.0, x - x0, y - y0);
        matrix += at * at.transpose();
        right += at * f64::from(level.elevation[*index]);
        sigma = sigma.max(f64::from(level.sigma[*index]));
    }
    let plane = matrix.try_inverse()? * right;
    let is_plane = rim.iter().all(|index| {
        let [x, y] = level.center(*index);
        let z = plane[0] + plane[1] * (x - x0) + plane[2] * (y - y0);
        (z - f64::from(level.elevation[*index])).abs() <= config.max_rim_m
    });
    let at_origin = plane[0] - plane[1] * x0 - plane[2] * y0;
    is_plane.then(|| (Vector3::new(at_origin, plane[1], plane[2]), sigma))
}
