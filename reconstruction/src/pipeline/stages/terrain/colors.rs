//! Colors of the vertices of a mesh: those of the nearest points of the cloud.

use std::collections::HashMap;

use rayon::prelude::*;
use scene_bundle::outputs::cloud::CloudPoint;
use terrain::mesh::Mesh;

/// Edge of a cell, m: twice the spacing of the cloud's points. Points within half of it are found.
const CELL_M: f32 = 0.1;

/// Points of the cloud by their place.
pub(super) struct CloudColors<'a> {
    points: &'a [CloudPoint],
    cells: HashMap<[i32; 3], Vec<u32>>,
}

impl<'a> CloudColors<'a> {
    pub(super) fn new(points: &'a [CloudPoint]) -> Self {
        let mut cells: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
        for (number, point) in (0..).zip(points) {
            let cell = point.x_in_world.map(|v| (v / CELL_M).floor() as i32);
            cells.entry(cell).or_default().push(number);
        }
        Self { points, cells }
    }

    /// Gives each vertex the color of the nearest point, black where none is within half a cell.
    pub(super) fn paint(&self, mesh: &mut Mesh) {
        let colors = mesh.positions.par_iter().map(|x| self.nearest(x));
        mesh.colors = colors.map(Option::unwrap_or_default).collect();
    }

    fn nearest(&self, x: &[f32; 3]) -> Option<[u8; 3]> {
        // Of the eight cells around the corner that is nearest to the vertex.
        let corner = x.map(|v| (v / CELL_M).round() as i32);
        let max_square = (0.5 * CELL_M) * (0.5 * CELL_M);
        let mut nearest: Option<(f32, u32)> = None;
        for k in 0..8 {
            let cell = [0, 1, 2].map(|axis| corner[axis] - (k >> axis & 1));
            for number in self.cells.get(&cell).into_iter().flatten() {
                let point = self.points[*number as usize].x_in_world;
                let square: f32 = (0..3).map(|k| (point[k] - x[k]) * (point[k] - x[k])).sum();
                if square <= nearest.map_or(max_square, |(least, _)| least) {
                    nearest = Some((square, *number));
                }
            }
        }
        let (_, number) = nearest?;
        Some(self.points[number as usize].color)
    }
}
