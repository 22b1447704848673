//! Which blocks the surfaces of an image need.

use rayon::prelude::*;

use super::block::EDGE;
use super::frame::Frame;
use super::grid::{Key, MAX_COORDINATE, pack};
use crate::config::FusionConfig;

/// Entries of the table that removes most repetitions before sorting.
const RECENT: usize = 1024;

/// Steps along a normal whose last blocks are known.
const MAX_STEPS: usize = 8;
/// Rows of cells of a task.
const ROWS: usize = 4;

/// A cell on a plane.
struct Cell {
    /// Mean pixel, inverse depth there, 1/m, its gradient, and sigma of depth, m.
    at: [f32; 2],
    inverse: f32,
    gradient: [f32; 2],
    sigma: f32,
    /// Outward normal in the view.
    normal: [f32; 3],
}

impl Cell {
    fn of(frame: &Frame<'_>, [column, row]: [usize; 2]) -> Option<Self> {
        let (cells, planes) = (&frame.images.cells.rows[row], &frame.planes.rows[row]);
        let gradient = [0, 1].map(|k| planes.gradient[k][column]);
        (!gradient[0].is_nan()).then(|| Self {
            at: [0, 1].map(|k| cells.at[k][column + 1]),
            inverse: planes.inverse[column],
            gradient,
            sigma: cells.sigma[column + 1],
            normal: [0, 1, 2].map(|k| planes.normal[k][column]),
        })
    }
}

/// Packed keys of the blocks within the truncation of the surfaces of an image, sorted.
pub(crate) fn blocks_at_surfaces(config: &FusionConfig, frame: &Frame<'_>) -> Vec<u64> {
    let [columns, rows] = frame.images.cells.size;
    let rows: Vec<Vec<u64>> = (0..rows.div_ceil(ROWS))
        .into_par_iter()
        .map(|chunk| {
            let mut recent = Recent::new();
            for row in chunk * ROWS..((chunk + 1) * ROWS).min(rows) {
                for column in 0..columns {
                    if let Some(cell) = Cell::of(frame, [column, row]) {
                        add_cell(config, frame, &cell, &mut recent);
                    }
                }
            }
            recent.keys
        })
        .collect();
    let mut keys: Vec<u64> = rows.into_iter().flatten().collect();
    keys.sort_unstable();
    keys.dedup();
    keys
}

/// Keys without most of their repetitions.
struct Recent {
    table: Vec<u64>,
    keys: Vec<u64>,
    /// The last blocks, from one to another, of each corner of a cell and step along its normal.
    last: Vec<(Key, Key)>,
}

impl Recent {
    fn new() -> Self {
        Self {
            table: vec![u64::MAX; RECENT],
            keys: Vec::new(),
            last: vec![([i32::MAX; 3], [i32::MAX; 3]); 5 * MAX_STEPS],
        }
    }

    fn add(&mut self, key: Key) {
        let packed = pack(key);
        let entry = &mut self.table[(packed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 54) as usize];
        if *entry != packed {
            *entry = packed;
            self.keys.push(packed);
        }
    }
}

fn add_cell(config: &FusionConfig, frame: &Frame<'_>, cell: &Cell, recent: &mut Recent) {
    let [a, b] = cell.gradient;
    let view = frame.view;
    let side = frame.cell_px;
    let depth = 1.0 / cell.inverse;
    let [u, v] = [0, 1].map(|k| (f64::from(cell.at[k]) - view.center_px[k]) / view.focal_px[k]);
    let n = cell.normal.map(f64::from);
    let cos = -(n[0] * u + n[1] * v + n[2]);
    let is_shallow = cos < config.min_incidence_cos * (1.0 + u * u + v * v).sqrt();
    let along = f64::from(cell.sigma) * cos;
    let floor = 0.25 * config.unit_sigma_m * config.unit_sigma_m;
    let sigma = (along * along + view.pose_sigma_m * view.pose_sigma_m + floor).sqrt();
    if is_shallow || sigma > config.max_sigma_m || f64::from(depth) > config.max_depth_m {
        return;
    }
    let [front, back] = truncation(config, sigma);
    let normal = frame.pose.rotate(cell.normal.map(f64::from));
    let block_m = config.voxel_m * EDGE as f64;
    // A cell that is larger than some voxels on the surface needs its corners as well.
    let incidence = f64::from(-cell.normal[2])
        .abs()
        .max(config.min_incidence_cos);
    let footprint = side as f64 * f64::from(depth) / (view.focal_px[0] * incidence);
    let half = 0.5 * side as f32;
    let corners: &[[f32; 2]] = match footprint > 2.0 * config.voxel_m {
        true => &[
            [0.0, 0.0],
            [-1.0, -1.0],
            [1.0, -1.0],
            [-1.0, 1.0],
            [1.0, 1.0],
        ],
        false => &[[0.0, 0.0]],
    };
    let steps = ((front + back) / (0.5 * block_m)).ceil().max(1.0);
    let margin = 1.5 * config.voxel_m;
    let blocks_per_m = 1.0 / block_m;
    for (corner, [right, down]) in corners.iter().enumerate() {
        let (du, dv) = (half * right, half * down);
        let inverse = cell.inverse + a * du + b * dv;
        if !(inverse > 0.0 && 1.0 / inverse < 1.5 * depth) {
            continue;
        }
        let (u, v) = (f64::from(cell.at[0] + du), f64::from(cell.at[1] + dv));
        let x = view.position(&frame.pose, u, v, 1.0 / f64::from(inverse));
        for step in 0..=steps as usize {
            let s = (front + back) * step as f64 / steps - back;
            let center = [0, 1, 2].map(|k| x[k] + s * normal[k]);
            let block = |offset: f64| center.map(|c| floor_i32((c + offset) * blocks_per_m));
            let (from, to) = (block(-margin), block(margin));
            // Mostly those of the cell before.
            let known = recent.last.get_mut(corner * MAX_STEPS + step);
            if let Some(known) = known {
                if *known == (from, to) {
                    continue;
                }
                *known = (from, to);
            }
            if from.iter().chain(&to).any(|k| k.abs() > MAX_COORDINATE) {
                continue;
            }
            for z in from[2]..=to[2] {
                for y in from[1]..=to[1] {
                    for x in from[0]..=to[0] {
                        recent.add([x, y, z]);
                    }
                }
            }
        }
    }
}

/// Truncation towards zero is an instruction, `floor` a call on older processors.
fn floor_i32(x: f64) -> i32 {
    let truncated = x as i32;
    truncated - i32::from(x < f64::from(truncated))
}

/// Distances in front of a surface and behind it up to which voxels are updated, m.
pub(crate) fn truncation(config: &FusionConfig, sigma: f64) -> [f64; 2] {
    let front = (config.front_sigmas * sigma).min(config.max_front_m);
    let back = (config.back_sigmas * sigma).min(config.max_back_m);
    [
        front.max(config.front_voxels * config.voxel_m),
        back.max(config.back_voxels * config.voxel_m),
    ]
}
