//! Upper faces of parts by their place.

use std::collections::BTreeMap;

use super::prism::ConvexPart;
use crate::hull::contains;
use crate::planes::Planes;

/// Edge of a cell of the table, m.
const CELL_M: f64 = 0.25;
/// Faces farther from the ground of a level belong to another one, m.
const OTHER_LEVEL_M: f64 = 0.4;
/// Least vertical part of the normal of a face that something can stand on.
const MIN_UP: f64 = 0.1;
/// Twice the area of the smallest triangle that counts, m2.
const MIN_AREA_M2: f64 = 1e-9;

/// A face that points upwards, seen from above.
pub(super) struct Face {
    /// Corners, counterclockwise, m.
    corners: Vec<[f64; 2]>,
    /// Least and greatest coordinates of the corners, m.
    bounds: [[f64; 2]; 2],
    /// A point of its plane, m.
    point: [f64; 3],
    /// Rise of its plane along x and y.
    slope: [f64; 2],
    /// Whether it is the surface of a plane, rather than the side of a part.
    pub(super) is_surface: bool,
}

impl Face {
    fn new(corners: &[[f64; 3]], normal: [f64; 3], is_surface: bool) -> Self {
        let bound = |pick: fn(f64, f64) -> f64| {
            let of = |k: usize| corners.iter().map(|x| x[k]).reduce(pick);
            [0, 1].map(|k| of(k).unwrap_or(f64::NAN))
        };
        Self {
            corners: corners.iter().map(|x| [x[0], x[1]]).collect(),
            bounds: [bound(f64::min), bound(f64::max)],
            point: corners[0],
            slope: [0, 1].map(|k| -normal[k] / normal[2]),
            is_surface,
        }
    }

    /// Height of its plane at a place, m.
    pub(super) fn height(&self, at: [f64; 2]) -> f64 {
        let along = |k: usize| (at[k] - self.point[k]) * self.slope[k];
        self.point[2] + along(0) + along(1)
    }

    pub(super) fn contains(&self, at: [f64; 2]) -> bool {
        let [low, high] = self.bounds;
        let is_near = (0..2).all(|k| at[k] >= low[k] && at[k] <= high[k]);
        is_near && contains(&self.corners, at)
    }
}

/// Faces of all parts, and which are in each cell of a table.
pub(super) struct Faces {
    faces: Vec<Face>,
    cells: BTreeMap<(i32, i32), Vec<u32>>,
}

impl Faces {
    pub(super) fn new(parts: &[ConvexPart], planes: &Planes) -> Self {
        let mut faces = Vec::new();
        for part in parts {
            let count = part.outline.len();
            let normal = planes.planes[part.plane as usize].normal;
            let has_surface = normal[2] > MIN_UP;
            if has_surface {
                faces.push(Face::new(&part.vertices[..count], normal, true));
            }
            for triangle in &part.triangles {
                let is_of_surface = triangle.iter().all(|i| (*i as usize) < count);
                let corners = triangle.map(|i| part.vertices[i as usize]);
                let normal = doubled_normal(corners);
                let length = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
                if !(has_surface && is_of_surface) && normal[2] > MIN_AREA_M2.max(MIN_UP * length) {
                    faces.push(Face::new(&corners, normal, false));
                }
            }
        }
        let mut cells: BTreeMap<(i32, i32), Vec<u32>> = BTreeMap::new();
        for (number, face) in faces.iter().enumerate() {
            let [low, high] = face
                .bounds
                .map(|at| at.map(|v| (v / CELL_M).floor() as i32));
            let range = |k: usize| low[k]..=high[k];
            for row in range(1) {
                for column in range(0) {
                    cells.entry((row, column)).or_default().push(number as u32);
                }
            }
        }
        Self { faces, cells }
    }

    /// Faces above or below a place.
    pub(super) fn at(&self, at: [f64; 2]) -> impl Iterator<Item = &Face> + '_ {
        let [column, row] = at.map(|v| (v / CELL_M).floor() as i32);
        let near = self
            .cells
            .get(&(row, column))
            .map_or(&[][..], Vec::as_slice);
        let faces = near.iter().map(|number| &self.faces[*number as usize]);
        faces.filter(move |face| face.contains(at))
    }

    /// Height of the highest face at a place that is of the level of a height there, m.
    pub(super) fn top(&self, at: [f64; 2], near: f64) -> Option<f64> {
        self.at(at)
            .map(|face| face.height(at))
            .filter(|height| (height - near).abs() < OTHER_LEVEL_M)
            .reduce(f64::max)
    }
}

fn doubled_normal([a, b, c]: [[f64; 3]; 3]) -> [f64; 3] {
    let u = [0, 1, 2].map(|k| b[k] - a[k]);
    let v = [0, 1, 2].map(|k| c[k] - a[k]);
    [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ]
}
