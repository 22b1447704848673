//! The surface of a volume as triangles.
//!
//! Contract: dual contouring (Ju et al. 2002) of voxels that views saw: one vertex per cell of
//! eight known voxels that the surface crosses, placed by the mean normals of the depths, so that
//! edges stay sharp. Where no view saw the surface there is a hole. Vertices are in the order of
//! their places, whatever the order of the views was.

use rayon::prelude::*;

use crate::config::MeshConfig;
use crate::fusion::Volume;
use crate::fusion::block::{COUNT, EDGE};
use crate::fusion::grid::Key;

mod cells;
mod components;
mod triangles;
mod vertex;

#[cfg(feature = "obstacles")]
pub(crate) use components::connected;
pub use triangles::Mesh;

use cells::Neighborhood;
use vertex::Vertex;

/// Mark of a cell without vertex.
const NONE: u32 = u32::MAX;

impl Mesh {
    /// The surface of a volume.
    pub fn of(volume: &Volume, config: &MeshConfig) -> Self {
        let numbers = volume.grid().sorted();
        let cells: Vec<Vec<(u16, Vertex)>> = numbers
            .par_iter()
            .map(|number| {
                let (_, key) = volume.grid().at(*number);
                let around = Neighborhood::of(volume, key);
                around.map_or_else(Vec::new, |around| around.vertices(volume, config))
            })
            .collect();
        // Index of the vertex of every cell, by the number of its block.
        let mut index: Vec<Option<Box<[u32; COUNT]>>> = vec![None; volume.grid().len()];
        let mut mesh = Self::default();
        for (number, cells) in numbers.iter().zip(&cells) {
            if cells.is_empty() {
                continue;
            }
            let mut of_block = Box::new([NONE; COUNT]);
            for (cell, vertex) in cells {
                of_block[usize::from(*cell)] = mesh.positions.len() as u32;
                mesh.push(vertex);
            }
            index[*number] = Some(of_block);
        }
        let triangles: Vec<Vec<[u32; 3]>> = numbers
            .par_iter()
            .map(|number| {
                let (_, key) = volume.grid().at(*number);
                mesh.triangles_of(volume, config, &index, key)
            })
            .collect();
        mesh.triangles = triangles.into_iter().flatten().collect();
        components::remove_small(&mut mesh, config.min_component_m2);
        mesh
    }

    fn push(&mut self, vertex: &Vertex) {
        self.positions.push(vertex.position);
        self.normals.push(vertex.normal);
        self.colors.push(vertex.color);
        self.sigma_m.push(vertex.sigma_m);
        self.views.push(vertex.views);
    }

    fn triangles_of(
        &self,
        volume: &Volume,
        config: &MeshConfig,
        index: &[Option<Box<[u32; COUNT]>>],
        key: Key,
    ) -> Vec<[u32; 3]> {
        let mut triangles = Vec::new();
        let Some(around) = Neighborhood::of(volume, key) else {
            return triangles;
        };
        // Tables of the block and of those before it, along each axis.
        let tables: [Option<&[u32; COUNT]>; 8] = std::array::from_fn(|corner| {
            let before = [0, 1, 2].map(|k| key[k] - (corner >> k & 1) as i32);
            index[volume.grid().position(before)?].as_deref()
        });
        let vertex = |at: [i32; 3]| {
            let mut corner = 0;
            let mut cell = 0;
            for k in [2, 1, 0] {
                corner |= usize::from(at[k] < 0) << k;
                cell = cell * EDGE + at[k].rem_euclid(EDGE as i32) as usize;
            }
            tables[corner].map_or(NONE, |table| table[cell])
        };
        for (at, axis, is_outward) in around.crossed_edges(config.max_jump_voxels) {
            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
            let cell = |from_b: i32, from_c: i32| {
                let mut at = at.map(|k| k as i32);
                at[b] -= from_b;
                at[c] -= from_c;
                vertex(at)
            };
            let mut quad = [cell(1, 1), cell(0, 1), cell(0, 0), cell(1, 0)];
            if quad.contains(&NONE) {
                continue;
            }
            if !is_outward {
                quad.reverse();
            }
            triangles.extend(self.split(quad));
        }
        triangles
    }

    /// A quadrilateral as two triangles, along its shorter diagonal.
    fn split(&self, [a, b, c, d]: [u32; 4]) -> [[u32; 3]; 2] {
        let length = |from: u32, to: u32| {
            let [from, to] = [from, to].map(|i| self.positions[i as usize]);
            (0..3)
                .map(|k| (from[k] - to[k]) * (from[k] - to[k]))
                .sum::<f32>()
        };
        match length(a, c) <= length(b, d) {
            true => [[a, b, c], [a, c, d]],
            false => [[a, b, d], [b, c, d]],
        }
    }
}
