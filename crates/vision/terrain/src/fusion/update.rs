//! Update of the voxels of a block, in layers of 8 x 8 voxels.

use simd_dispatch::Kernel;

use super::block::{Block, COUNT, DISTANCE_STEPS, EDGE, WEIGHT_STEPS};
use super::frame::Frame;
use crate::config::FusionConfig;
use crate::instructions::{larger, smaller, truncated};

/// Nearest depth of a voxel that is updated, m.
const MIN_DEPTH_M: f32 = 0.05;
/// Maximum weight of a voxel, in steps.
pub(super) const MAX_WEIGHT: f32 = 65535.0;

/// Outward normal of a cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CellNormal {
    /// In the view, its products with a pixel to the right and downwards at a depth of 1.
    pub(crate) per_px: [f32; 2],
    pub(crate) in_world: [f32; 3],
}

/// Voxel positions of a block in the view: of the first voxel, and steps along the axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    pub(crate) origin: [f32; 3],
    pub(crate) steps: [[f32; 3]; 3],
}

/// How voxels change; all lengths in m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rules {
    pub(super) voxel_m: f32,
    pub(super) front_m: f32,
    pub(super) front_sigmas: f32,
    pub(super) max_front_m: f32,
    pub(super) back_m: f32,
    pub(super) back_sigmas: f32,
    pub(super) max_back_m: f32,
    /// Steps of a stored distance per metre.
    pub(super) steps_per_m: f32,
    pub(super) min_contradictions: u8,
}

impl Rules {
    pub(crate) fn new(config: &FusionConfig) -> Self {
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
            min_contradictions: config.min_contradictions,
        }
    }

    #[inline(always)]
    fn front(&self, sigma: f32) -> f32 {
        larger(
            smaller(self.front_sigmas * sigma, self.max_front_m),
            self.front_m,
        )
    }

    #[inline(always)]
    fn back(&self, sigma: f32) -> f32 {
        larger(
            smaller(self.back_sigmas * sigma, self.max_back_m),
            self.back_m,
        )
    }
}

/// A block and the view that changes it.
pub(crate) struct Update<'a> {
    pub(crate) frame: &'a Frame<'a>,
    pub(crate) normals: &'a [CellNormal],
    pub(crate) rules: &'a Rules,
    pub(crate) lattice: Lattice,
    pub(crate) block: &'a mut Block,
}

/// Voxels of a layer of a block. Loops over all of them, without branches, become vector
/// instructions.
pub(super) const LAYER: usize = EDGE * EDGE;

/// Values of the voxels of a layer.
pub(super) type Values = [f32; LAYER];

/// Places of the voxels of a layer.
const IN_LAYER: [Values; 2] = {
    let mut places = [[0.0; LAYER]; 2];
    let mut i = 0;
    while i < LAYER {
        places[0][i] = (i % EDGE) as f32;
        places[1][i] = (i / EDGE) as f32;
        i += 1;
    }
    places
};

/// Voxels of a layer with their pixels.
pub(super) struct Voxels {
    pub(super) depth: Values,
    /// Numbers of their pixels and cells; 0 beside the image.
    pub(super) pixel: [u32; LAYER],
    pub(super) cell: [u32; LAYER],
    /// From the center of the pixel, px.
    pub(super) off_center: [Values; 2],
    /// Of the pixels, see [`super::pixels::Pixel`]; the depth is 0 beside the image.
    pub(super) pixel_depth: Values,
    pub(super) cos: Values,
    pub(super) sigma: Values,
    pub(super) weight: Values,
    /// Distance along the normal, if the ray were that of the pixel's center, m.
    pub(super) along_ray: Values,
}

/// Observations of the voxels of a layer.
pub(super) struct LayerObservations {
    /// Share of the observation in the new value.
    pub(super) alpha: Values,
    /// 1 for voxels at the surface, 0 for others.
    pub(super) is_near: Values,
}

impl Kernel for Update<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        const ZEROS: Values = [0.0; LAYER];
        let mut voxels = Voxels {
            depth: ZEROS,
            pixel: [0; LAYER],
            cell: [0; LAYER],
            off_center: [ZEROS; 2],
            pixel_depth: ZEROS,
            cos: ZEROS,
            sigma: ZEROS,
            weight: ZEROS,
            along_ray: ZEROS,
        };
        for layer in 0..EDGE {
            if self.project(layer as f32, &mut voxels) {
                self.update_layer(layer * LAYER, &mut voxels);
            }
        }
    }
}

/// Sum of values; above 0 if one is.
#[inline(always)]
pub(super) fn sum(values: &Values) -> f32 {
    let mut sums = [0.0f32; EDGE];
    for row in values.chunks_exact(EDGE) {
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += *value;
        }
    }
    sums.iter().sum()
}

impl Update<'_> {
    /// Projects a layer of voxels; false if none has a pixel with depth.
    #[inline(always)]
    fn project(&self, layer: f32, voxels: &mut Voxels) -> bool {
        let view = self.frame.view;
        let [focal_x, focal_y] = [view.focal_px[0] as f32, view.focal_px[1] as f32];
        let [corner_x, corner_y] = [
            view.center_px[0] as f32 + 0.5,
            view.center_px[1] as f32 + 0.5,
        ];
        let [last_x, last_y] = [view.size[0] as f32, view.size[1] as f32];
        let width = view.size[0] as i32;
        let columns = self.frame.images.cells.size[0] as i32;
        let shift = self.frame.cell_px.trailing_zeros();
        let [ex, ey, ez] = self.lattice.steps;
        let mut start = self.lattice.origin;
        for k in 0..3 {
            start[k] += layer * ez[k];
        }
        let mut inside = [0.0f32; LAYER];
        let Voxels {
            depth: depths,
            pixel,
            cell,
            off_center: [off_x, off_y],
            ..
        } = voxels;
        for i in 0..LAYER {
            let [x, y] = [IN_LAYER[0][i], IN_LAYER[1][i]];
            let depth = start[2] + x * ex[2] + y * ey[2];
            let inverse = 1.0 / depth;
            let u = (start[0] + x * ex[0] + y * ey[0]) * inverse * focal_x + corner_x;
            let v = (start[1] + x * ex[1] + y * ey[1]) * inverse * focal_y + corner_y;
            let is_inside =
                (u >= 0.0) & (v >= 0.0) & (u < last_x) & (v < last_y) & (depth > MIN_DEPTH_M);
            let u = if is_inside { u } else { 0.5 };
            let v = if is_inside { v } else { 0.5 };
            let (column, row) = (truncated(u), truncated(v));
            depths[i] = depth;
            // Checks of overflow would prevent vector instructions.
            pixel[i] = row.wrapping_mul(width).wrapping_add(column) as u32;
            let [cell_x, cell_y] = [column.wrapping_shr(shift), row.wrapping_shr(shift)];
            cell[i] = cell_y.wrapping_mul(columns).wrapping_add(cell_x) as u32;
            off_x[i] = u - column as f32 - 0.5;
            off_y[i] = v - row as f32 - 0.5;
            inside[i] = if is_inside { 1.0 } else { 0.0 };
        }
        if sum(&inside) == 0.0 {
            return false;
        }
        let pixels = &self.frame.images.pixels[..];
        for i in 0..LAYER {
            let pixel = &pixels[voxels.pixel[i] as usize];
            voxels.pixel_depth[i] = pixel.depth;
            voxels.cos[i] = pixel.cos;
            voxels.sigma[i] = pixel.sigma;
            voxels.weight[i] = pixel.weight;
        }
        for (depth, inside) in voxels.pixel_depth.iter_mut().zip(&inside) {
            *depth *= inside;
        }
        sum(&voxels.pixel_depth) > 0.0
    }

    /// Updates the voxels of a layer from a number on.
    #[inline(always)]
    fn update_layer(&mut self, first: usize, voxels: &mut Voxels) {
        let rules = *self.rules;
        let (mut is_free, mut is_fused) = ([0.0f32; LAYER], [0.0f32; LAYER]);
        for i in 0..LAYER {
            let along = (voxels.pixel_depth[i] - voxels.depth[i]) * voxels.cos[i];
            let has_depth = voxels.pixel_depth[i] > 0.0;
            let front = rules.front(voxels.sigma[i]);
            let back = rules.back(voxels.sigma[i]);
            let frees = has_depth & (along > front);
            let fuses = has_depth & (along <= front) & (along > -back) & (voxels.weight[i] > 0.0);
            voxels.along_ray[i] = along;
            is_free[i] = if frees { 1.0 } else { 0.0 };
            is_fused[i] = if fuses { 1.0 } else { 0.0 };
        }
        if self.block.surface.is_some() && sum(&is_free) > 0.0 {
            self.see_through(first, &is_free, &voxels.weight);
        }
        if sum(&is_fused) > 0.0 {
            let fused = self.fuse(first, voxels, &is_fused);
            if sum(&fused.is_near) > 0.0 {
                self.observe(first, voxels, &fused);
            }
        }
    }

    /// Weighted means with the distances along the normals.
    #[inline(always)]
    fn fuse(&mut self, first: usize, voxels: &Voxels, is_fused: &Values) -> LayerObservations {
        let rules = *self.rules;
        let (mut right, mut down) = ([0.0f32; LAYER], [0.0f32; LAYER]);
        for i in 0..LAYER {
            [right[i], down[i]] = self.normals[voxels.cell[i] as usize].per_px;
        }
        let mut fused = LayerObservations {
            alpha: [0.0; LAYER],
            is_near: [0.0; LAYER],
        };
        let distances: &mut [i16; LAYER] = layer_mut(&mut self.block.distance, first);
        let weights: &mut [u16; LAYER] = layer_mut(&mut self.block.weight, first);
        // Loops over integers of 16 bits apart from the others become vector instructions.
        let (mut stored, mut before) = ([0.0f32; LAYER], [0.0f32; LAYER]);
        for i in 0..LAYER {
            stored[i] = f32::from(distances[i]);
        }
        for i in 0..LAYER {
            before[i] = f32::from(weights[i]);
        }
        let (mut rounded, mut steps) = ([0i32; LAYER], [0i32; LAYER]);
        for i in 0..LAYER {
            // The ray of the voxel is not quite that of the pixel's center.
            let across = right[i] * voxels.off_center[0][i] + down[i] * voxels.off_center[1][i];
            let distance = voxels.along_ray[i] + across * voxels.depth[i];
            // The share of the weight behind a surface: 1 up to a voxel, 0 at the end.
            let back = rules.back(voxels.sigma[i]);
            let falling = (back + distance) / (back - rules.voxel_m);
            let falling = smaller(larger(falling, 0.0), 1.0);
            let share = if distance >= -rules.voxel_m {
                1.0
            } else {
                falling
            };
            let added = voxels.weight[i] * share * is_fused[i] * WEIGHT_STEPS;
            let sum = before[i] + added;
            let alpha = added / larger(sum, 1e-9);
            let mean = stored[i] + alpha * (distance * rules.steps_per_m - stored[i]);
            // Adding a half and truncating rounds; `round` is a call on older processors.
            let mean = smaller(larger(mean, -DISTANCE_STEPS), DISTANCE_STEPS);
            rounded[i] = truncated(mean + 0.5f32.copysign(mean));
            let least = if added > 0.0 { 1.0 } else { 0.0 };
            steps[i] = truncated(smaller(larger(sum + 0.5, least), MAX_WEIGHT));
            let is_near = (added > 0.0) & (distance.abs() < rules.voxel_m);
            fused.alpha[i] = alpha;
            fused.is_near[i] = if is_near { 1.0 } else { 0.0 };
        }
        for i in 0..LAYER {
            distances[i] = rounded[i] as i16;
        }
        for i in 0..LAYER {
            weights[i] = steps[i] as u16;
        }
        fused
    }
}

/// A layer from a number on.
#[inline(always)]
pub(super) fn layer_mut<T>(of: &mut [T; COUNT], first: usize) -> &mut [T; LAYER] {
    let layer = of[first..].first_chunk_mut::<LAYER>();
    layer.expect("layers are within a block")
}

/// Greatest distance that a voxel stores, m.
pub(crate) fn stored_range(config: &FusionConfig) -> f64 {
    let front = config.max_front_m.max(config.front_voxels * config.voxel_m);
    front
        .max(config.max_back_m)
        .max(config.back_voxels * config.voxel_m)
}
