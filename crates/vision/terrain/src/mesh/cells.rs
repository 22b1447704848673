//! Voxels of a block with those that its cells share with the blocks after it.

use super::vertex::{Crossing, Vertex};
use crate::config::MeshConfig;
use crate::fusion::Volume;
use crate::fusion::block::{COUNT, EDGE, SurfaceVoxel};
use crate::fusion::grid::Key;

/// Voxels along an edge.
const SIDE: usize = EDGE + 1;

/// Voxels of a block and the first ones of its neighbors.
pub(super) struct Neighborhood {
    key: Key,
    /// Distances in voxels; NaN where unknown.
    distance: [f32; SIDE * SIDE * SIDE],
    weight: [u16; SIDE * SIDE * SIDE],
    surface: [SurfaceVoxel; SIDE * SIDE * SIDE],
    best_sigma_m: f64,
}

impl Neighborhood {
    /// `None` if no surface crosses the cells of a block.
    pub(super) fn of(volume: &Volume, key: Key) -> Option<Self> {
        let blocks: [_; 8] = std::array::from_fn(|corner| {
            volume
                .grid()
                .get([0, 1, 2].map(|k| key[k] + (corner >> k & 1) as i32))
        });
        if blocks.iter().flatten().all(|block| block.surface.is_none()) {
            return None;
        }
        let mut around = Self {
            key,
            distance: [f32::NAN; SIDE * SIDE * SIDE],
            weight: [0; SIDE * SIDE * SIDE],
            surface: [SurfaceVoxel::default(); SIDE * SIDE * SIDE],
            best_sigma_m: f64::INFINITY,
        };
        let scale = (volume.m_per_step() / volume.config().voxel_m) as f32;
        let (mut has_inside, mut has_outside) = (false, false);
        for i in 0..SIDE * SIDE * SIDE {
            let at = [i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE];
            let corner = (0..3).map(|k| (at[k] / EDGE) << k).sum::<usize>();
            let Some(block) = blocks[corner] else {
                continue;
            };
            let voxel = (at[2] % EDGE * EDGE + at[1] % EDGE) * EDGE + at[0] % EDGE;
            if block.weight[voxel] == 0 {
                continue;
            }
            around.distance[i] = f32::from(block.distance[voxel]) * scale;
            around.weight[i] = block.weight[voxel];
            if let Some(surface) = &block.surface {
                around.surface[i] = surface.at(voxel);
            }
            has_inside |= block.distance[voxel] < 0;
            has_outside |= block.distance[voxel] >= 0;
        }
        for block in blocks.into_iter().flatten() {
            around.best_sigma_m = around.best_sigma_m.min(f64::from(block.best_sigma_m));
        }
        (has_inside && has_outside).then_some(around)
    }

    /// Edges from voxels of the block to the next voxel along an axis that a surface crosses, and
    /// whether it faces along the axis.
    pub(super) fn crossed_edges(
        &self,
        max_jump: f64,
    ) -> impl Iterator<Item = ([usize; 3], usize, bool)> + '_ {
        (0..COUNT * 3).filter_map(move |i| {
            let (voxel, axis) = (i / 3, i % 3);
            let at = [voxel % EDGE, voxel / EDGE % EDGE, voxel / EDGE / EDGE];
            let from = self.distance[index(at)];
            let to = self.distance[index(step(at, axis))];
            is_crossed(from, to, max_jump).then_some((at, axis, from < 0.0))
        })
    }

    /// Vertices of the cells of the block, with the number of their cell.
    pub(super) fn vertices(&self, volume: &Volume, config: &MeshConfig) -> Vec<(u16, Vertex)> {
        let mut vertices = Vec::new();
        for cell in 0..COUNT {
            let at = [cell % EDGE, cell / EDGE % EDGE, cell / EDGE / EDGE];
            let corners: [usize; 8] =
                std::array::from_fn(|corner| index([0, 1, 2].map(|k| at[k] + (corner >> k & 1))));
            let inside = corners.iter().filter(|i| self.distance[**i] < 0.0).count();
            if inside == 0 || inside == 8 || corners.iter().any(|i| self.weight[*i] == 0) {
                continue;
            }
            if let Some(vertex) = self.vertex(volume, config, at, &corners) {
                vertices.push((cell as u16, vertex));
            }
        }
        vertices
    }

    fn vertex(
        &self,
        volume: &Volume,
        config: &MeshConfig,
        at: [usize; 3],
        corners: &[usize; 8],
    ) -> Option<Vertex> {
        let (mut crossings, mut count) = ([Crossing::default(); 12], 0);
        let (mut weight, mut views) = (0.0, 0);
        let mut color: (u8, [u8; 3]) = (0, [0; 3]);
        for from in 0..8usize {
            for axis in 0..3 {
                let to = from | 1 << axis;
                let (a, b) = (corners[from], corners[to]);
                if to == from
                    || !is_crossed(self.distance[a], self.distance[b], config.max_jump_voxels)
                {
                    continue;
                }
                let share = f64::from(self.distance[a] / (self.distance[a] - self.distance[b]));
                let mut position = [0, 1, 2].map(|k| (from >> k & 1) as f64);
                position[axis] = share;
                let nearest = if share < 0.5 { a } else { b };
                let surface = &self.surface[nearest];
                let normal = match surface.views {
                    0 => self.gradient(corners),
                    _ => surface.normal.map(f64::from),
                };
                crossings[count] = Crossing { position, normal };
                count += 1;
                weight += f64::from(self.weight[nearest]);
                views = surface.views.max(views);
                for surface in [&self.surface[a], &self.surface[b]] {
                    if surface.color_rank > color.0 {
                        color = (surface.color_rank, surface.color);
                    }
                }
            }
        }
        if count == 0 || views < config.min_views {
            return None;
        }
        let (in_cell, normal) = Crossing::meeting(&crossings[..count], config.min_feature_ratio);
        let voxel = volume.config().voxel_m;
        let position = [0, 1, 2].map(|k| {
            let first = f64::from(self.key[k]) * EDGE as f64 + at[k] as f64;
            ((first + in_cell[k]) * voxel) as f32
        });
        let random = volume.sigma_m((weight / count as f64) as u16);
        let common = volume.config().common_ratio * self.best_sigma_m;
        Some(Vertex {
            position,
            normal: normal.map(|v| v as f32),
            color: color.1,
            sigma_m: random.hypot(common) as f32,
            views,
        })
    }

    /// Gradient of the distance in a cell.
    fn gradient(&self, corners: &[usize; 8]) -> [f64; 3] {
        [0, 1, 2].map(|k| {
            let sign = |corner: usize| if corner >> k & 1 == 1 { 1.0 } else { -1.0 };
            let of = |(corner, i): (usize, &usize)| sign(corner) * f64::from(self.distance[*i]);
            corners.iter().enumerate().map(of).sum()
        })
    }
}

fn index([x, y, z]: [usize; 3]) -> usize {
    (z * SIDE + y) * SIDE + x
}

fn step(mut at: [usize; 3], axis: usize) -> [usize; 3] {
    at[axis] += 1;
    at
}

/// Whether a surface crosses between two distances, in voxels. False for NaN.
fn is_crossed(from: f32, to: f32, max_jump: f64) -> bool {
    (from < 0.0) != (to < 0.0) && f64::from((from - to).abs()) <= max_jump
}
