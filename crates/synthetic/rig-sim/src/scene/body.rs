//! Rigid geometry, laid out for rasterization.

use std::collections::HashMap;

use nalgebra::Vector3;

use super::mesh::{Mesh, Triangle};

/// Edge of the cells by which triangles are grouped, m.
const CELL_M: f64 = 2.0;

/// A group of nearby triangles with shared corners.
#[derive(Clone, Debug)]
pub struct Chunk {
    /// Middle of the corners, m.
    pub center: [f32; 3],
    /// Distance of the farthest corner from it, m.
    pub radius: f32,
    /// m.
    pub corners: Vec<[f32; 3]>,
    /// Three corners each.
    pub triangles: Vec<[u32; 3]>,
    /// Number of the first triangle in the body; the others follow.
    pub first: u32,
}

/// Surface of a triangle: linear functions of the position in the body's frame.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Outward unit normal `n`; points `x` of the triangle have `n·x = offset`.
    pub normal: [f32; 3],
    /// See `normal`, m.
    pub offset: f32,
    /// Along the texture, m: gradient and constant.
    pub u: [f32; 4],
    /// Across it.
    pub v: [f32; 4],
    /// Irradiance relative to a level white surface in daylight.
    pub light: [f32; 4],
    /// Index into the scene's materials.
    pub material: u16,
    /// Instance.
    pub instance: u16,
}

/// Rigid geometry.
#[derive(Clone, Debug, Default)]
pub struct Body {
    /// In the order of the triangles' numbers.
    pub chunks: Vec<Chunk>,
    /// Surfaces by triangle number.
    pub surfaces: Vec<Surface>,
    /// The triangles, by number.
    pub triangles: Vec<Triangle>,
}

impl Body {
    /// Builds a body from a mesh and the irradiance at the corners of each triangle.
    pub fn new(mesh: &Mesh, light: &[[f32; 3]]) -> Self {
        let cell = |t: &Triangle| {
            let middle = t.corners.iter().map(|c| c.position).sum::<Vector3<f64>>() / 3.0;
            // Cells are centered at the origin, so a small body there is one chunk.
            let index = middle.map(|v| (v / CELL_M + 0.5).floor() as i64);
            [index.x, index.y, index.z]
        };
        let mut order: Vec<usize> = (0..mesh.triangles.len()).collect();
        order.sort_by_key(|&i| cell(&mesh.triangles[i]));
        let mut body = Self::default();
        for group in order.chunk_by(|&a, &b| cell(&mesh.triangles[a]) == cell(&mesh.triangles[b])) {
            let first = body.triangles.len() as u32;
            let members = group.iter().map(|&i| &mesh.triangles[i]);
            body.chunks.push(chunk(members, first));
            for &i in group {
                body.triangles.push(mesh.triangles[i]);
                body.surfaces.push(surface(&mesh.triangles[i], &light[i]));
            }
        }
        body
    }
}

fn chunk<'a>(members: impl Iterator<Item = &'a Triangle>, first: u32) -> Chunk {
    let mut corners: Vec<[f32; 3]> = Vec::new();
    let mut known: HashMap<[u32; 3], u32> = HashMap::new();
    let mut index = |p: Vector3<f64>| {
        let p = [p.x as f32, p.y as f32, p.z as f32];
        *known.entry(p.map(f32::to_bits)).or_insert_with(|| {
            corners.push(p);
            corners.len() as u32 - 1
        })
    };
    let triangles = members
        .map(|t| t.corners.map(|c| index(c.position)))
        .collect();
    let sum = corners.iter().fold([0.0; 3], |sum: [f32; 3], c| {
        [0, 1, 2].map(|i| sum[i] + c[i])
    });
    let center = sum.map(|s| s / corners.len() as f32);
    let distance = |c: &[f32; 3]| {
        let d = [0, 1, 2].map(|i| c[i] - center[i]);
        (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
    };
    Chunk {
        center,
        radius: 1e-4 + corners.iter().map(distance).fold(0.0, f32::max),
        corners,
        triangles,
        first,
    }
}

fn surface(t: &Triangle, light: &[f32; 3]) -> Surface {
    let [a, b, c] = t.corners.map(|c| c.position);
    let (ab, ac) = (b - a, c - a);
    let normal = ab.cross(&ac);
    let square = normal.norm_squared();
    let linear = |values: [f64; 3]| {
        let (db, dc) = (values[1] - values[0], values[2] - values[0]);
        let gradient = (ac.cross(&normal) * db + normal.cross(&ab) * dc) / square;
        let constant = values[0] - gradient.dot(&a);
        [gradient.x, gradient.y, gradient.z, constant].map(|v| v as f32)
    };
    let unit = normal / square.sqrt();
    Surface {
        normal: [unit.x as f32, unit.y as f32, unit.z as f32],
        offset: unit.dot(&a) as f32,
        u: linear(t.corners.map(|c| c.uv[0])),
        v: linear(t.corners.map(|c| c.uv[1])),
        light: linear(light.map(f64::from)),
        material: t.material,
        instance: t.instance,
    }
}
