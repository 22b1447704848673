//! What a view shows of surfaces: their normals and colors, and which of them it sees through.

use super::block::{Block, EDGE, NORMAL_STEPS, SurfaceLayer, WEIGHT_STEPS};
use super::update::{
    LAYER, LayerObservations, MAX_WEIGHT, Rules, Update, Values, Voxels, layer_mut, sum,
};
use crate::instructions::{smaller, truncated};

impl Update<'_> {
    /// Mean normals, counts and colors at a surface.
    #[inline(always)]
    pub(super) fn observe(&mut self, first: usize, voxels: &Voxels, fused: &LayerObservations) {
        let mut normals = [[0.0f32; LAYER]; 3];
        let [x, y, z] = &mut normals;
        for i in 0..LAYER {
            [x[i], y[i], z[i]] = self.normals[voxels.cell[i] as usize].in_world;
        }
        let block = &mut *self.block;
        let mut least = [block.best_sigma_m; EDGE];
        for i in 0..LAYER {
            let sigma = if fused.is_near[i] > 0.0 {
                voxels.sigma[i]
            } else {
                f32::INFINITY
            };
            least[i % EDGE] = smaller(sigma, least[i % EDGE]);
        }
        block.best_sigma_m = least.iter().fold(f32::INFINITY, |a, b| a.min(*b));
        let surface = block.surface.get_or_insert_with(SurfaceLayer::new);
        let views: &mut [u8; LAYER] = layer_mut(&mut surface.views, first);
        let mut alpha = fused.alpha;
        for i in 0..LAYER {
            alpha[i] = if views[i] == 0 { 1.0 } else { alpha[i] };
        }
        let mut before = [[0.0f32; LAYER]; 3];
        let mut mean = [[0.0f32; LAYER]; 3];
        for k in 0..3 {
            let stored: &[i16; LAYER] = layer_mut(&mut surface.normal[k], first);
            for i in 0..LAYER {
                before[k][i] = f32::from(stored[i]);
            }
            for i in 0..LAYER {
                let difference = NORMAL_STEPS * normals[k][i] - before[k][i];
                mean[k][i] = before[k][i] + alpha[i] * difference;
            }
        }
        // Opposite normals have no mean: two sides of a thin thing.
        let (mut changes, mut scale) = ([0.0f32; LAYER], [0.0f32; LAYER]);
        for i in 0..LAYER {
            let [x, y, z] = [mean[0][i], mean[1][i], mean[2][i]];
            let length = (x * x + y * y + z * z).sqrt();
            let has_mean = length > 1e-3 * NORMAL_STEPS;
            changes[i] = if has_mean { fused.is_near[i] } else { 0.0 };
            scale[i] = NORMAL_STEPS / if has_mean { length } else { 1.0 };
        }
        for k in 0..3 {
            let mut steps = [0i32; LAYER];
            for i in 0..LAYER {
                steps[i] = truncated(if changes[i] > 0.0 {
                    mean[k][i] * scale[i]
                } else {
                    before[k][i]
                });
            }
            let stored: &mut [i16; LAYER] = layer_mut(&mut surface.normal[k], first);
            for i in 0..LAYER {
                stored[i] = steps[i] as i16;
            }
        }
        let views: &mut [u8; LAYER] = layer_mut(&mut surface.views, first);
        let contradictions: &mut [u8; LAYER] = layer_mut(&mut surface.contradictions, first);
        for i in 0..LAYER {
            let one = truncated(fused.is_near[i]) as u8;
            views[i] = views[i].saturating_add(one);
            contradictions[i] = contradictions[i].saturating_sub(one);
        }
        let Some(color) = self.frame.view.color else {
            return;
        };
        for i in 0..LAYER {
            // Rank 255 at 0.3 m.
            let rank = (0.3 * 255.0 / voxels.pixel_depth[i]).clamp(1.0, 255.0) as u8;
            if fused.is_near[i] > 0.0 && rank > surface.color_rank[first + i] {
                surface.color[first + i] = color[voxels.pixel[i] as usize];
                surface.color_rank[first + i] = rank;
            }
        }
    }

    /// A view sees through voxels.
    #[inline(always)]
    pub(super) fn see_through(&mut self, first: usize, is_free: &Values, weights: &Values) {
        let rules = *self.rules;
        let block = &mut *self.block;
        // In front of a surface, voxels are free in agreement with the view.
        let limit = 0.5 * rules.front_m * rules.steps_per_m;
        let distances: &[i16; LAYER] = layer_mut(&mut block.distance, first);
        let known: &[u16; LAYER] = layer_mut(&mut block.weight, first);
        let mut contradicts = [0.0f32; LAYER];
        for i in 0..LAYER {
            let is_surface = (known[i] > 0) & ((distances[i] as i32 as f32) < limit);
            contradicts[i] = if is_surface { is_free[i] } else { 0.0 };
        }
        if sum(&contradicts) > 0.0 {
            for i in 0..LAYER {
                if contradicts[i] > 0.0 {
                    carve(block, &rules, first + i, weights[i]);
                }
            }
        }
    }
}

/// Counts a view that sees through a surface; from some number on the surface loses weight.
fn carve(block: &mut Block, rules: &Rules, voxel: usize, pixel_weight: f32) {
    let Some(surface) = &mut block.surface else {
        return;
    };
    let contradictions = &mut surface.contradictions[voxel];
    *contradictions = contradictions.saturating_add(1);
    if *contradictions < rules.min_contradictions {
        return;
    }
    block.carved += 1;
    let weight = block.weight[voxel] / 2;
    block.weight[voxel] = weight;
    if weight == 0 {
        surface.clear(voxel);
        block.distance[voxel] = 0;
    } else if pixel_weight > 0.0 {
        let added = pixel_weight * WEIGHT_STEPS;
        let sum = f32::from(weight) + added;
        let stored = f32::from(block.distance[voxel]);
        let mean = stored + added / sum * (rules.front_m * rules.steps_per_m - stored);
        block.distance[voxel] = (mean + 0.5f32.copysign(mean)) as i16;
        block.weight[voxel] = (sum + 0.5).clamp(1.0, MAX_WEIGHT) as u16;
    }
}
