//! Step edges: where planes meet or end.
//!
//! Contract: an edge of a tread is where it meets its riser, if views saw the riser; else where its
//! depths end, with the larger sigma of such ends. Heights of steps come from views that saw the
//! planes on both sides together, if there are some. Ground without planes, and planes that meet at
//! a shallow angle, have no edges. Edges are in the order of their planes.

use crate::config::EdgeConfig;
use crate::planes::Planes;

mod edge;
mod ends;
mod intersection;
mod runs;
mod snapping;
mod steps;

pub use edge::{Edge, EdgeKind, Step};
pub use snapping::snap;

/// The edges of planes.
pub fn find_edges(planes: &Planes, config: &EdgeConfig) -> Vec<Edge> {
    let mut edges = intersection::intersections(&planes.planes, config);
    let of_ends: Vec<Edge> = planes
        .planes
        .iter()
        .enumerate()
        .flat_map(|(number, plane)| ends::plane_ends(number, plane, &edges, config))
        .collect();
    edges.extend(of_ends);
    let ground: Vec<_> = planes
        .planes
        .iter()
        .enumerate()
        .filter(|(_, plane)| plane.frame.normal.z >= config.min_ground_cos)
        .map(|(number, plane)| (number, intersection::bounds(plane, 0.0)))
        .collect();
    for edge in &mut edges {
        edge.step = steps::step(planes, &ground, edge, config);
    }
    edges
}
