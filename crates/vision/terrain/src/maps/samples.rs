//! Samples of a mesh in the columns of a grid.

use rayon::prelude::*;

use crate::mesh::Mesh;

/// Samples along an edge of a cell; the one in the middle is its center.
const ACROSS: i64 = 3;
/// Place of the center among the samples of a cell.
const CENTER: u8 = 4;
/// Place of a vertex, which is on no sample point.
const VERTEX: u8 = u8::MAX;

/// A point of the surface above or below a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) z: f32,
    pub(super) sigma: f32,
    pub(super) normal: [f32; 3],
    place: u8,
    pub(super) views: u8,
}

impl Sample {
    pub(super) fn is_center(&self) -> bool {
        self.place == CENTER
    }
}

/// A cell by its row and column, from the origin of the world.
pub(super) type Cell = (i32, i32);

/// All cells with samples, in order, with their samples by height.
pub(super) fn columns(mesh: &Mesh, cell_m: f64) -> Vec<(Cell, Vec<Sample>)> {
    let triangles: Vec<Vec<(Cell, Sample)>> = mesh
        .triangles
        .par_iter()
        .map(|triangle| rasterize(mesh, *triangle, cell_m))
        .collect();
    let mut all: Vec<(Cell, Sample)> = triangles.into_iter().flatten().collect();
    // Walls have no area seen from above: their vertices stand for them.
    all.extend((0..mesh.positions.len()).map(|i| {
        let [x, y, z] = mesh.positions[i];
        let cell = [y, x].map(|v| (f64::from(v) / cell_m).floor() as i32);
        let sample = Sample {
            z,
            sigma: mesh.sigma_m[i],
            normal: mesh.normals[i],
            place: VERTEX,
            views: mesh.views[i],
        };
        ((cell[0], cell[1]), sample)
    }));
    all.par_sort_by(|a, b| {
        a.0.cmp(&b.0)
            .then(a.1.z.total_cmp(&b.1.z))
            .then(a.1.place.cmp(&b.1.place))
    });
    let mut columns: Vec<(Cell, Vec<Sample>)> = Vec::new();
    for (cell, sample) in all {
        match columns.last_mut().filter(|(last, _)| *last == cell) {
            Some((_, samples)) => samples.push(sample),
            None => columns.push((cell, vec![sample])),
        }
    }
    columns
}

/// Samples of a triangle at the sample points of cells below it.
fn rasterize(mesh: &Mesh, triangle: [u32; 3], cell_m: f64) -> Vec<(Cell, Sample)> {
    let corners = triangle.map(|i| mesh.positions[i as usize].map(f64::from));
    let [a, b, c] = corners;
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let mut found = Vec::new();
    if area.abs() < 1e-12 {
        return found;
    }
    let normal = mesh.doubled_normal(triangle);
    let norm = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
    let normal = normal.map(|v| (v / norm) as f32);
    let spacing = cell_m / ACROSS as f64;
    let range = |k: usize| {
        let low = corners.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
        let high = corners
            .iter()
            .map(|p| p[k])
            .fold(f64::NEG_INFINITY, f64::max);
        (low / spacing - 0.5).ceil() as i64..=(high / spacing - 0.5).floor() as i64
    };
    let of = |i: u32| (mesh.sigma_m[i as usize], mesh.views[i as usize]);
    let [of_a, of_b, of_c] = triangle.map(of);
    let (sigma, views) = (
        of_a.0.max(of_b.0).max(of_c.0),
        of_a.1.max(of_b.1).max(of_c.1),
    );
    for row in range(1) {
        for column in range(0) {
            let [x, y] = [column, row].map(|k| (k as f64 + 0.5) * spacing);
            // Barycentric coordinates.
            let of_b = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area;
            let of_c = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area;
            let of_a = 1.0 - of_b - of_c;
            if of_a < 0.0 || of_b < 0.0 || of_c < 0.0 {
                continue;
            }
            let place = row.rem_euclid(ACROSS) * ACROSS + column.rem_euclid(ACROSS);
            let sample = Sample {
                z: (of_a * a[2] + of_b * b[2] + of_c * c[2]) as f32,
                sigma,
                normal,
                place: place as u8,
                views,
            };
            let cell = [row, column].map(|k| k.div_euclid(ACROSS) as i32);
            found.push(((cell[0], cell[1]), sample));
        }
    }
    found
}
