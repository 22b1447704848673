//! Update of the voxels of blocks by an image.
//!
//! A voxel near the surface of its pixel takes the weighted mean of its distances. A voxel far in
//! front of it is free; that changes nothing, unless a surface was there: then views that see
//! through it are counted, and from some number on it loses weight. So free space cannot pull on a
//! neighboring surface, and space that was not seen has no surface.

use rayon::prelude::*;

use super::block::{Block, COUNT, DISTANCE_STEPS, EDGE, SurfaceVoxel, WEIGHT_STEPS};
use super::block::{decode_normal, encode_normal};
use super::frame::Frame;
use super::grid::{Grid, Key};
use super::pyramid::DepthPyramid;
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
    /// Outward normals of the cells in the view and in the world.
    normals: Vec<[[f32; 3]; 2]>,
    /// The edge of a cell as a power of 2.
    cell_shift: u32,
}

/// Voxel positions of a block in the view: of the first voxel, and steps along the axes.
struct Lattice {
    origin: [f32; 3],
    steps: [[f32; 3]; 3],
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
        let turn = |n: &[f32; 3]| frame.pose.rotate(n.map(f64::from)).map(|v| v as f32);
        Self {
            frame,
            config: *config,
            pyramid: DepthPyramid::new(frame.cells_size, &frame.cells),
            rotation: inverse.rotation_rows(),
            translation: inverse.translation_m(),
            motion_margin: time * speed,
            normals: frame
                .cells
                .iter()
                .map(|cell| [cell.normal, turn(&cell.normal)])
                .collect(),
            cell_shift: frame.cell_px.ilog2(),
        }
    }

    /// Updates all blocks of a grid that the view can change.
    pub(crate) fn run(&self, grid: &mut Grid) {
        let block_m = self.config.voxel_m * EDGE as f64;
        let position = self.frame.view.world_from_view.translation_m();
        let reach = self.config.max_depth_m + block_m;
        let from = position.map(|x| ((x - reach) / block_m).floor() as i32);
        let to = position.map(|x| ((x + reach) / block_m).floor() as i32);
        let mut numbers = grid.near(from, to);
        numbers.retain(|number| self.can_change(grid.key(*number), grid.has_surface(*number)));
        let blocks = grid.select(&numbers);
        blocks
            .into_par_iter()
            .with_min_len(8)
            .for_each(|(key, block)| self.update(key, block));
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
            let last = self.frame.cells_size[k] - 1;
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

    fn update(&self, key: Key, block: &mut Block) {
        let lattice = self.lattice(key);
        let view = self.frame.view;
        let focal = view.focal_px.map(|f| f as f32);
        let inverse_focal = view.focal_px.map(|f| (1.0 / f) as f32);
        let corner = view.center_px.map(|c| c as f32 + 0.5);
        let size = view.size.map(|s| s as f32);
        let width = view.size[0];
        let rules = Rules::new(&self.config);
        let [ex, ey, ez] = lattice.steps;
        for i in 0..COUNT / EDGE {
            let (y, z) = ((i % EDGE) as f32, (i / EDGE) as f32);
            let start = [0, 1, 2].map(|k| lattice.origin[k] + y * ey[k] + z * ez[k]);
            // The projections of a row of voxels, without branches.
            let mut depths = [0.0f32; EDGE];
            let mut at = [[0.0f32; EDGE]; 2];
            for x in 0..EDGE {
                let step = x as f32;
                let depth = start[2] + step * ex[2];
                let inverse = 1.0 / depth;
                depths[x] = depth;
                at[0][x] = (start[0] + step * ex[0]) * inverse * focal[0] + corner[0];
                at[1][x] = (start[1] + step * ex[1]) * inverse * focal[1] + corner[1];
            }
            for x in 0..EDGE {
                let (u, v) = (at[0][x], at[1][x]);
                if !(u >= 0.0 && v >= 0.0 && u < size[0] && v < size[1] && depths[x] > 0.05) {
                    continue;
                }
                let (u, v) = (u as usize, v as usize);
                let pixel = &self.frame.pixels[v * width + u];
                if pixel.depth == 0.0 {
                    continue;
                }
                let along_ray = (pixel.depth - depths[x]) * pixel.cos;
                let voxel = i * EDGE + x;
                let front = rules.front(pixel.sigma);
                let back = rules.back(pixel.sigma);
                if along_ray > front {
                    rules.see_through(block, voxel, pixel.weight);
                } else if pixel.weight > 0.0 && along_ray > -back {
                    let normals = &self.normals[self.cell_at(u, v)];
                    // The ray of the voxel is not quite that of the pixel's center.
                    let n = normals[0];
                    let to_center = [at[0][x] - u as f32 - 0.5, at[1][x] - v as f32 - 0.5];
                    let across = [0, 1].map(|k| to_center[k] * inverse_focal[k]);
                    let shift = (n[0] * across[0] + n[1] * across[1]) * depths[x];
                    let distance = along_ray + shift;
                    let weight = pixel.weight * rules.share(distance, pixel.sigma);
                    if weight <= 0.0 {
                        continue;
                    }
                    let alpha = rules.fuse(block, voxel, distance, weight);
                    if distance.abs() < rules.voxel_m {
                        let sighting = Sighting {
                            normal: normals[1],
                            color: view.color.map(|color| color[v * width + u]),
                            depth: pixel.depth,
                            sigma: pixel.sigma,
                        };
                        observe(block, voxel, alpha, &sighting);
                    }
                }
            }
        }
    }

    fn cell_at(&self, column: usize, row: usize) -> usize {
        (row >> self.cell_shift) * self.frame.cells_size[0] + (column >> self.cell_shift)
    }
}

/// How voxels change; all lengths in m.
struct Rules {
    voxel_m: f32,
    front_m: f32,
    front_sigmas: f32,
    max_front_m: f32,
    back_m: f32,
    back_sigmas: f32,
    max_back_m: f32,
    /// Steps of a stored distance per metre, and back.
    steps_per_m: f32,
    m_per_step: f32,
    min_contradictions: u8,
}

impl Rules {
    fn new(config: &FusionConfig) -> Self {
        let range = stored_range(config) as f32;
        Self {
            voxel_m: config.voxel_m as f32,
            front_m: (config.front_voxels * config.voxel_m) as f32,
            front_sigmas: config.front_sigmas as f32,
            max_front_m: config.max_front_m as f32,
            back_m: (config.back_voxels * config.voxel_m) as f32,
            back_sigmas: config.back_sigmas as f32,
            max_back_m: config.max_back_m as f32,
            steps_per_m: DISTANCE_STEPS / range,
            m_per_step: range / DISTANCE_STEPS,
            min_contradictions: config.min_contradictions,
        }
    }

    fn front(&self, sigma: f32) -> f32 {
        (self.front_sigmas * sigma)
            .min(self.max_front_m)
            .max(self.front_m)
    }

    fn back(&self, sigma: f32) -> f32 {
        (self.back_sigmas * sigma)
            .min(self.max_back_m)
            .max(self.back_m)
    }

    /// Share of the weight behind a surface: 1 up to a voxel, 0 at the end of the truncation.
    fn share(&self, distance: f32, sigma: f32) -> f32 {
        if distance >= -self.voxel_m {
            return 1.0;
        }
        let back = self.back(sigma);
        ((back + distance) / (back - self.voxel_m)).clamp(0.0, 1.0)
    }

    /// Returns the share of the observation in the new value.
    fn fuse(&self, block: &mut Block, voxel: usize, distance: f32, weight: f32) -> f32 {
        let before = f32::from(block.weight[voxel]);
        let added = weight * WEIGHT_STEPS;
        let sum = before + added;
        let alpha = added / sum;
        let stored = f32::from(block.distance[voxel]);
        let mean = stored + alpha * (distance * self.steps_per_m - stored);
        // Adding a half and truncating rounds; `round` is a call on older processors.
        block.distance[voxel] = (mean + 0.5f32.copysign(mean)) as i16;
        block.weight[voxel] = (sum + 0.5).clamp(1.0, f32::from(u16::MAX)) as u16;
        alpha
    }

    /// A view sees through a voxel.
    fn see_through(&self, block: &mut Block, voxel: usize, pixel_weight: f32) {
        if block.weight[voxel] == 0 {
            return;
        }
        let Some(surface) = &mut block.surface else {
            return;
        };
        // In front of a surface, voxels are free in agreement with the view.
        let distance = f32::from(block.distance[voxel]) * self.m_per_step;
        if distance >= 0.5 * self.front_m {
            return;
        }
        let surface = &mut surface[voxel];
        surface.contradictions = surface.contradictions.saturating_add(1);
        if surface.contradictions < self.min_contradictions {
            return;
        }
        block.carved += 1;
        block.weight[voxel] /= 2;
        if block.weight[voxel] == 0 {
            *surface = SurfaceVoxel::default();
            block.distance[voxel] = 0;
        } else if pixel_weight > 0.0 {
            self.fuse(block, voxel, self.front_m, pixel_weight);
        }
    }
}

/// What a view shows of the surface at a voxel.
struct Sighting {
    normal: [f32; 3],
    color: Option<[u8; 3]>,
    depth: f32,
    sigma: f32,
}

fn observe(block: &mut Block, voxel: usize, alpha: f32, sighting: &Sighting) {
    block.best_sigma_m = block.best_sigma_m.min(sighting.sigma);
    let surface = block
        .surface
        .get_or_insert_with(|| Box::new([SurfaceVoxel::default(); COUNT]));
    let surface = &mut surface[voxel];
    surface.contradictions = surface.contradictions.saturating_sub(1);
    let normal = match surface.views {
        0 => sighting.normal,
        _ => {
            let before = decode_normal(surface.normal);
            let mean = [0, 1, 2].map(|k| before[k] + alpha * (sighting.normal[k] - before[k]));
            // Opposite normals have no mean: two sides of a thin thing.
            match mean.iter().any(|v| v.abs() > 1e-3) {
                true => mean,
                false => before,
            }
        }
    };
    surface.normal = encode_normal(normal);
    surface.views = surface.views.saturating_add(1);
    if let Some(color) = sighting.color {
        // Rank 255 at 0.3 m.
        let rank = (0.3 * 255.0 / sighting.depth).clamp(1.0, 255.0) as u8;
        if rank > surface.color_rank {
            (surface.color, surface.color_rank) = (color, rank);
        }
    }
}

/// Greatest distance that a voxel stores, m.
pub(crate) fn stored_range(config: &FusionConfig) -> f64 {
    let front = config.max_front_m.max(config.front_voxels * config.voxel_m);
    front
        .max(config.max_back_m)
        .max(config.back_voxels * config.voxel_m)
}
