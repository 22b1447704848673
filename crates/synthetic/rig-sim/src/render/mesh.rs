//! The static scene as a mesh: PLY (Turk 1994), binary, little-endian.
//!
//! Vertices are in the world frame, m, f32. Faces carry the number of their [`Class`], whether
//! people walk on them, and the number of their plane (see `planes.csv`), -1 for none. Panes are
//! included; people, the wearer and everything else that moves are not.
//!
//! [`Class`]: crate::scene::surface::Class

use crate::scene::Scene;
use crate::scene::terrain::Planes;

/// The whole file.
pub(super) fn ply(scene: &Scene, planes: &Planes) -> Vec<u8> {
    let bodies = [&scene.fixed, &scene.glass];
    let chunks = || {
        bodies
            .into_iter()
            .flat_map(|body| body.chunks.iter().map(move |c| (body, c)))
    };
    let vertices: usize = chunks().map(|(_, chunk)| chunk.corners.len()).sum();
    let faces: usize = chunks().map(|(_, chunk)| chunk.triangles.len()).sum();
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\ncomment {}, {}: world frame, m\n\
         element vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {faces}\nproperty list uchar uint vertex_indices\n\
         property uchar class\nproperty uchar walkable\nproperty int plane\nend_header\n",
        scene.kind.name(),
        scene.lighting.name(),
    )
    .into_bytes();
    for (_, chunk) in chunks() {
        for corner in &chunk.corners {
            bytes.extend(corner.iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    let mut first_vertex = 0;
    for (body, chunk) in chunks() {
        for (triangle, number) in chunk.triangles.iter().zip(chunk.first..) {
            let surface = &body.surfaces[number as usize];
            let material = &scene.materials[surface.material as usize];
            bytes.push(3);
            bytes.extend(
                triangle
                    .iter()
                    .flat_map(|k| (first_vertex + k).to_le_bytes()),
            );
            bytes.extend([material.class as u8, u8::from(material.walkable)]);
            let is_fixed = std::ptr::eq(body, &raw const scene.fixed);
            let plane = is_fixed
                .then(|| planes.of_triangle[number as usize])
                .flatten();
            bytes.extend(plane.map_or(-1, |plane| plane as i32).to_le_bytes());
        }
        first_vertex += chunk.corners.len() as u32;
    }
    bytes
}
