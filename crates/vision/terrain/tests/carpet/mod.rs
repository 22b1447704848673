//! Meshes of functions.

#![allow(unreachable_pub, reason = "a module of several tests")]

use terrain::mesh::Mesh;

/// Squares of 2 cm where a function has a height, seen from above.
pub fn carpet(size: [usize; 2], height: impl Fn(f64, f64) -> Option<f64>) -> Mesh {
    let mut mesh = Mesh::default();
    let mut index = std::collections::BTreeMap::new();
    for row in 0..size[1] {
        for column in 0..size[0] {
            let [x, y] = [column, row].map(|k| 0.02 * k as f64);
            let Some(z) = height(x, y) else {
                continue;
            };
            index.insert((row, column), mesh.positions.len() as u32);
            mesh.positions.push([x as f32, y as f32, z as f32]);
            mesh.normals.push([0.0, 0.0, 1.0]);
            mesh.colors.push([100; 3]);
            mesh.sigma_m.push(0.003);
            mesh.views.push(4);
        }
    }
    for ((row, column), a) in &index {
        let at = |down, right| index.get(&(row + down, column + right)).copied();
        if let (Some(b), Some(c), Some(d)) = (at(0, 1), at(1, 1), at(1, 0)) {
            mesh.triangles.extend([[*a, b, c], [*a, c, d]]);
        }
    }
    mesh
}
