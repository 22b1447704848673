//! Update of the voxels of blocks by an image.
//!
//! A voxel near the surface of its pixel takes the weighted mean of its distances. A voxel far in
//! front of it is free; that changes nothing, unless a surface was there: then views that see
//! through it are counted, and from some number on it loses weight. So free space cannot pull on a
//! neighboring surface, and space that was not seen has no surface.

use rayon::prelude::*;

use super::block::EDGE;
use super::fit::PlaneRow;
use super::frame::Frame;
use super::grid::{Grid, Key};
use super::pyramid::DepthPyramid;
use super::update::{CellNormal, Lattice, Rules, Update};
use crate::config::FusionConfig;

/// A view in the numbers of the inner loop.
pub(crate) struct Integration<'a> {
    frame: &'a Frame<'a>,
    config: FusionConfig,
    pyramid: DepthPyramid,
    /// Rotation (rows) and translation from the world to the view.
    rotation: [f64; 9],
    translation: [f64; 3],
    /// Motion of points at the greatest depth within the frame, m.
    motion_margin: f64,
    /// Of all cells, row-major.
    normals: Vec<CellNormal>,
    rules: Rules,
}

impl<'a> Integration<'a> {
    pub(crate) fn new(config: &FusionConfig, frame: &'a Frame<'a>) -> Self {
        let view = frame.view;
        let inverse = view.world_from_view.inverse();
        let motion = &view.row_motion;
        let time = motion
            .time_s(0.0)
            .abs()
            .max(motion.time_s(view.size[1] as f64).abs());
        let norm = |v: [f64; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
        let speed = norm(motion.velocity) + 2.0 * config.max_depth_m * norm(motion.angular_rate);
        let inverse_focal = view.focal_px.map(|f| (1.0 / f) as f32);
        let columns = frame.images.cells.size[0];
        let of_row = |row: &PlaneRow| {
            let of = |column: usize| {
                let in_view = [0, 1, 2].map(|k| row.normal[k][column]);
                let in_world = frame.pose.rotate(in_view.map(f64::from));
                CellNormal {
                    per_px: [0, 1].map(|k| in_view[k] * inverse_focal[k]),
                    in_world: in_world.map(|v| v as f32),
                }
            };
            (0..columns).map(of).collect::<Vec<_>>()
        };
        Self {
            frame,
            config: *config,
            pyramid: DepthPyramid::new(&frame.images.cells),
            rotation: inverse.rotation_rows(),
            translation: inverse.translation_m(),
            motion_margin: time * speed,
            normals: frame.planes.rows.iter().flat_map(of_row).collect(),
            rules: Rules::new(config),
        }
    }

    /// Updates all blocks of a grid that the view can change.
    pub(crate) fn run(&self, grid: &mut Grid) {
        let block_m = self.config.voxel_m * EDGE as f64;
        let position = self.frame.view.world_from_view.translation_m();
        let reach = self.config.max_depth_m + block_m;
        let from = position.map(|x| ((x - reach) / block_m).floor() as i32);
        let to = position.map(|x| ((x + reach) / block_m).floor() as i32);
        let all = grid.near(from, to);
        let near = all.par_chunks(512).map(|numbers| {
            let can_change =
                |number: &u32| self.can_change(grid.key(*number), grid.has_surface(*number));
            numbers.iter().copied().filter(can_change).collect()
        });
        let mut numbers = near.collect::<Vec<Vec<u32>>>().concat();
        numbers.sort_unstable();
        let blocks = grid.select(&numbers);
        blocks
            .into_par_iter()
            .with_min_len(8)
            .for_each(|(key, block)| {
                simd_dispatch::run(Update {
                    frame: self.frame,
                    normals: &self.normals,
                    rules: &self.rules,
                    lattice: self.lattice(key),
                    block,
                });
            });
    }

    fn to_view(&self, x: [f64; 3]) -> [f64; 3] {
        let r = &self.rotation;
        [0, 1, 2].map(|k| {
            r[3 * k] * x[0] + r[3 * k + 1] * x[1] + r[3 * k + 2] * x[2] + self.translation[k]
        })
    }

    /// Whether a block may have voxels near a surface of the image, or surfaces in front of one.
    fn can_change(&self, key: Key, has_surface: bool) -> bool {
        let config = &self.config;
        let half = 0.5 * (EDGE - 1) as f64;
        let center = key.map(|k| (f64::from(k) * EDGE as f64 + half) * config.voxel_m);
        let radius = half * config.voxel_m * 3f64.sqrt() + self.motion_margin;
        let [x, y, z] = self.to_view(center);
        if z < radius + 0.05 || z > config.max_depth_m + radius + config.max_front_m {
            return false;
        }
        let view = self.frame.view;
        let near = z - radius;
        let side = self.frame.cell_px as f64;
        let (mut from, mut to) = ([0; 2], [0; 2]);
        for (k, x) in [x, y].into_iter().enumerate() {
            let project = |x: f64| {
                // Either depth may give the outermost pixel.
                let of = |z: f64| view.focal_px[k] * x / z + view.center_px[k];
                [of(near), of(z + radius)]
            };
            let [low, high] = [project(x - radius), project(x + radius)];
            let low = low[0].min(low[1]) - 1.0;
            let high = high[0].max(high[1]) + 1.0;
            if high < 0.0 || low > view.size[k] as f64 {
                return false;
            }
            let last = self.frame.images.cells.size[k] - 1;
            from[k] = ((low.max(0.0) / side) as usize).min(last);
            to[k] = ((high / side) as usize).min(last);
        }
        let Some([min_depth, max_depth]) = self.pyramid.range(from, to) else {
            return false;
        };
        let behind = config.max_back_m.max(config.back_voxels * config.voxel_m);
        let before = config.max_front_m.max(config.front_voxels * config.voxel_m);
        let is_behind = near > f64::from(max_depth) + behind / config.min_incidence_cos;
        let is_free = z + radius < f64::from(min_depth) - before / config.min_incidence_cos;
        !is_behind && (!is_free || has_surface)
    }

    /// Positions of voxels at the exposure of their rows, linear within the block.
    fn lattice(&self, key: Key) -> Lattice {
        let voxel = self.config.voxel_m;
        let view = self.frame.view;
        let motion = &view.row_motion;
        let half = 0.5 * (EDGE - 1) as f64;
        let center = key.map(|k| (f64::from(k) * EDGE as f64 + half) * voxel);
        let at_pose = self.to_view(center);
        // Row of the center at its own exposure, by fixed-point iteration.
        let row_of = |x: [f64; 3]| view.focal_px[1] * x[1] / x[2] + view.center_px[1];
        let (mut x, mut row) = (at_pose, row_of(at_pose));
        for _ in 0..2 {
            x = motion.at_row(row, at_pose);
            row = row_of(x);
        }
        let r = &self.rotation;
        let speed = motion.speed_at(at_pose);
        let w = motion.angular_rate;
        let time = motion.time_s(row);
        let steps = [0, 1, 2].map(|axis| {
            let e = [r[axis], r[3 + axis], r[6 + axis]].map(|v| v * voxel);
            let rows = view.focal_px[1] * (e[1] - e[2] * x[1] / x[2]) / x[2];
            let turned = [
                w[1] * e[2] - w[2] * e[1],
                w[2] * e[0] - w[0] * e[2],
                w[0] * e[1] - w[1] * e[0],
            ];
            [0, 1, 2].map(|k| e[k] - motion.row_s * rows * speed[k] - time * turned[k])
        });
        let origin = [0, 1, 2].map(|k| x[k] - half * (steps[0][k] + steps[1][k] + steps[2][k]));
        Lattice {
            origin: origin.map(|v| v as f32),
            steps: steps.map(|step| step.map(|v| v as f32)),
        }
    }
}
