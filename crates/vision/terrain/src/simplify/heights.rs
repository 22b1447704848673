//! Heights of a mesh at places.

use std::collections::HashMap;
use std::hash::BuildHasherDefault;

use crate::fusion::grid::KeyHasher;
use crate::mesh::Mesh;

/// Tolerance of a place outside of a triangle, as a share of it.
const OUTSIDE: f64 = 1e-4;

/// Triangles by the columns that they touch.
pub(crate) struct HeightIndex<'a> {
    mesh: &'a Mesh,
    cell_m: f64,
    columns: HashMap<u64, Vec<u32>, BuildHasherDefault<KeyHasher>>,
}

impl<'a> HeightIndex<'a> {
    pub(crate) fn new(mesh: &'a Mesh, cell_m: f64) -> Self {
        let mut index = Self {
            mesh,
            cell_m,
            columns: HashMap::default(),
        };
        for (number, triangle) in mesh.triangles.iter().enumerate() {
            let corners = triangle.map(|i| mesh.positions[i as usize].map(f64::from));
            let range = |k: usize| {
                let low = corners.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
                let high = corners
                    .iter()
                    .map(|p| p[k])
                    .fold(f64::NEG_INFINITY, f64::max);
                index.cell(low - 1e-3)..=index.cell(high + 1e-3)
            };
            let (columns, rows) = (range(0), range(1));
            for row in rows {
                for column in columns.clone() {
                    index
                        .columns
                        .entry(key(column, row))
                        .or_default()
                        .push(number as u32);
                }
            }
        }
        index
    }

    fn cell(&self, x: f64) -> i32 {
        (x / self.cell_m).floor() as i32
    }

    /// Height of the surface above or below a point, the nearest one.
    pub(crate) fn nearest_height(&self, [x, y, z]: [f64; 3]) -> Option<f64> {
        let triangles = self.columns.get(&key(self.cell(x), self.cell(y)))?;
        let heights = triangles.iter().filter_map(|number| {
            let triangle = self.mesh.triangles[*number as usize];
            height(
                triangle.map(|i| self.mesh.positions[i as usize].map(f64::from)),
                [x, y],
            )
        });
        heights.min_by(|a, b| (a - z).abs().total_cmp(&(b - z).abs()))
    }
}

fn key(column: i32, row: i32) -> u64 {
    u64::from(column as u32) << 32 | u64::from(row as u32)
}

/// Height of a triangle at a place inside of it.
fn height([a, b, c]: [[f64; 3]; 3], [x, y]: [f64; 2]) -> Option<f64> {
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    if area.abs() < 1e-12 {
        return None;
    }
    let of_b = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area;
    let of_c = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area;
    let of_a = 1.0 - of_b - of_c;
    let is_inside = [of_a, of_b, of_c].iter().all(|share| *share >= -OUTSIDE);
    is_inside.then(|| of_a * a[2] + of_b * b[2] + of_c * c[2])
}
