//! Vertices of a mesh on planes and edges.

use nalgebra::Vector3;

use super::edge::{Edge, EdgeKind};
use crate::mesh::Mesh;
use crate::planes::Planes;

/// Moves vertices of planes onto them, and vertices of no plane within a radius of an edge where
/// two planes meet onto it. Others, those of rough ground for one, remain.
///
/// The planes must be those of the mesh.
pub fn snap(mesh: &mut Mesh, planes: &Planes, edges: &[Edge], radius_m: f64) {
    let meetings: Vec<&Edge> = edges
        .iter()
        .filter(|edge| edge.kind != EdgeKind::End)
        .collect();
    for i in 0..mesh.positions.len() {
        let x = mesh.positions[i].map(f64::from);
        let of_plane = planes.of_vertex.get(i).copied().flatten();
        // A vertex of a plane is at an edge if it is nearer than vertices are apart.
        let radius = if of_plane.is_some() {
            0.4 * radius_m
        } else {
            radius_m
        };
        let nearest = meetings
            .iter()
            .map(|edge| (edge.distance_m(x), edge))
            .filter(|(distance, _)| *distance <= radius)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, edge)) = nearest {
            let [from, to] = [edge.from, edge.to].map(Vector3::from);
            let along = to - from;
            let share = along.dot(&(Vector3::from(x) - from)) / along.norm_squared().max(1e-12);
            let on_edge = from + along * share.clamp(0.0, 1.0);
            mesh.positions[i] = [on_edge.x, on_edge.y, on_edge.z].map(|v| v as f32);
            mesh.sigma_m[i] = edge.sigma_m as f32;
            continue;
        }
        let Some(plane) = of_plane.map(|number| &planes.planes[number as usize]) else {
            continue;
        };
        let n = Vector3::from(plane.normal);
        let height = n.dot(&(Vector3::from(x) - Vector3::from(plane.center)));
        mesh.positions[i] = [0, 1, 2].map(|k| (x[k] - height * n[k]) as f32);
        mesh.normals[i] = plane.normal.map(|v| v as f32);
        mesh.sigma_m[i] = plane.sigma_at(x) as f32;
    }
}
