//! Vertices of a mesh on planes and edges.

use nalgebra::Vector3;

use super::edge::{Edge, EdgeKind};
use crate::fusion::grid::{KeyMap, pack};
use crate::mesh::Mesh;
use crate::planes::Planes;

/// Moves vertices of planes onto them, and vertices of no plane within a radius of an edge where
/// two planes meet onto it. Others remain; so do those of small planes without edges, which are
/// facets of rough ground.
///
/// The planes must be those of the mesh.
pub fn snap(mesh: &mut Mesh, planes: &Planes, edges: &[Edge], radius_m: f64) {
    let meetings = EdgeTable::new(edges, radius_m);
    let is_facet = facets(planes, edges);
    for i in 0..mesh.positions.len() {
        let x = mesh.positions[i].map(f64::from);
        let of_plane = planes.of_vertex.get(i).copied().flatten();
        let of_plane = of_plane.filter(|number| !is_facet[*number as usize]);
        // A vertex of a plane is at an edge if it is nearer than vertices are apart.
        let radius = if of_plane.is_some() {
            0.4 * radius_m
        } else {
            radius_m
        };
        let nearest = meetings
            .near(x)
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

/// Which planes have no edge and are small: facets of rough ground.
fn facets(planes: &Planes, edges: &[Edge]) -> Vec<bool> {
    let min_alone_m2 = planes.config.min_alone_m2;
    let mut is_facet: Vec<bool> = planes
        .planes
        .iter()
        .map(|plane| plane.area_m2 < min_alone_m2)
        .collect();
    for edge in edges {
        for number in edge.plane_numbers() {
            is_facet[number] = false;
        }
    }
    is_facet
}

/// Edge of a cell of the table, m.
const CELL_M: f64 = 0.25;

/// Edges where planes meet, by their place.
struct EdgeTable<'a>(KeyMap<Vec<&'a Edge>>);

impl<'a> EdgeTable<'a> {
    fn new(edges: &'a [Edge], radius_m: f64) -> Self {
        let mut table: KeyMap<Vec<&Edge>> = KeyMap::default();
        for edge in edges.iter().filter(|edge| edge.kind != EdgeKind::End) {
            // Cells around points of the edge; the last edge of a cell may be this one already.
            let steps = (edge.length_m() / (0.5 * CELL_M)).ceil().max(1.0) as usize;
            for step in 0..=steps {
                let share = step as f64 / steps as f64;
                let x = [0, 1, 2].map(|k| edge.from[k] + share * (edge.to[k] - edge.from[k]));
                let reach = radius_m + 0.25 * CELL_M;
                let [from, to] = [-reach, reach].map(|r| cell(x.map(|v| v + r)));
                for z in from[2]..=to[2] {
                    for y in from[1]..=to[1] {
                        for x in from[0]..=to[0] {
                            let edges = table.entry(pack([x, y, z])).or_default();
                            if edges.last().is_none_or(|last| !std::ptr::eq(*last, edge)) {
                                edges.push(edge);
                            }
                        }
                    }
                }
            }
        }
        Self(table)
    }

    fn near(&self, x: [f64; 3]) -> impl Iterator<Item = &'a Edge> + '_ {
        self.0.get(&pack(cell(x))).into_iter().flatten().copied()
    }
}

fn cell(x: [f64; 3]) -> [i32; 3] {
    x.map(|v| (v / CELL_M).floor() as i32)
}
