//! The ground at a place: height, normal and sigma of a mesh.

use std::collections::HashMap;
use std::hash::BuildHasherDefault;

use crate::fusion::grid::KeyHasher;
use crate::mesh::Mesh;

/// Edge of a cell of the table, m.
const CELL_M: f64 = 0.1;
/// Tolerance of a place outside of a triangle, as a share of it.
const OUTSIDE: f64 = 1e-4;

/// A point of the surface of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundPoint {
    /// Height in the world, m.
    pub height_m: f64,
    /// Normal of the triangle, upwards, of length 1.
    pub normal: [f64; 3],
    /// One standard deviation of the height, m: the largest one of the corners.
    pub sigma_m: f64,
}

/// A mesh that answers where its surface is.
///
/// ```
/// use terrain::ground::Ground;
/// use terrain::mesh::Mesh;
///
/// // A slope of 45 degrees.
/// let mesh = Mesh {
///     positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
///     normals: vec![[-0.7071, 0.0, 0.7071]; 3],
///     colors: vec![[0; 3]; 3],
///     sigma_m: vec![0.004; 3],
///     views: vec![5; 3],
///     triangles: vec![[0, 1, 2]],
/// };
/// let ground = Ground::new(&mesh);
/// let point = ground.nearest([0.25, 0.25, 0.0]).expect("on the triangle");
/// assert_eq!((point.height_m, point.sigma_m as f32), (0.25, 0.004));
/// assert!((point.normal[2] - 0.7071).abs() < 1e-4);
/// assert_eq!(ground.nearest([2.0, 0.0, 0.0]), None);
/// ```
pub struct Ground<'a> {
    mesh: &'a Mesh,
    columns: HashMap<u64, Vec<u32>, BuildHasherDefault<KeyHasher>>,
}

impl<'a> Ground<'a> {
    /// Sorts the triangles of a mesh by their place.
    pub fn new(mesh: &'a Mesh) -> Self {
        let mut index = Self {
            mesh,
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
                cell(low - 1e-3)..=cell(high + 1e-3)
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

    /// The surface nearest to a point among those above and below it.
    pub fn nearest(&self, [x, y, z]: [f64; 3]) -> Option<GroundPoint> {
        let triangles = self.columns.get(&key(cell(x), cell(y)))?;
        let heights = triangles.iter().filter_map(|number| {
            let triangle = self.mesh.triangles[*number as usize];
            let corners = triangle.map(|i| self.mesh.positions[i as usize].map(f64::from));
            Some((height(corners, [x, y])?, triangle))
        });
        let (height_m, triangle) =
            heights.min_by(|a, b| (a.0 - z).abs().total_cmp(&(b.0 - z).abs()))?;
        let doubled = self.mesh.doubled_normal(triangle);
        let norm = doubled.iter().map(|v| v * v).sum::<f64>().sqrt();
        let up = if doubled[2] < 0.0 { -norm } else { norm };
        let sigma = triangle.map(|i| self.mesh.sigma_m[i as usize]);
        Some(GroundPoint {
            height_m,
            normal: doubled.map(|v| v / up),
            sigma_m: f64::from(sigma.into_iter().fold(0.0, f32::max)),
        })
    }
}

fn cell(x: f64) -> i32 {
    (x / CELL_M).floor() as i32
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
