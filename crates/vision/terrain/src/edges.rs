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
mod ramps;
mod runs;
mod snapping;
mod steps;

pub(crate) use ramps::{Ramps, Strip};

pub use self::{
    edge::{Edge, EdgeKind, Step},
    ramps::without_ramps,
    snapping::snap,
};

/// The edges of planes.
pub fn find_edges(planes: &Planes, config: &EdgeConfig) -> Vec<Edge> {
    let meetings = intersection::intersections(&planes.planes, config);
    let (leaning, mut edges): (Vec<Edge>, Vec<Edge>) = meetings
        .into_iter()
        .partition(|edge| is_leaning(planes, edge, config));
    let of_ends: Vec<Edge> = planes
        .planes
        .iter()
        .enumerate()
        .flat_map(|(number, plane)| ends::plane_ends(number, plane, &edges, config))
        .collect();
    let is_ramp = |edge: &Edge| of_ends.iter().any(|end| contradicts(end, edge, config));
    edges.extend(leaning.into_iter().filter(|edge| !is_ramp(edge)));
    edges.extend(of_ends);
    edges.sort_by_key(|edge| (edge.kind == EdgeKind::End, edge.planes));
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

/// Whether an edge is that of ground and of a riser that leans: depths that a matcher has joined
/// across a step look like that.
fn is_leaning(planes: &Planes, edge: &Edge, config: &EdgeConfig) -> bool {
    let up = |number: u32| planes.planes[number as usize].frame.normal.z;
    let (upper, riser) = edge.planes;
    edge.kind == EdgeKind::Convex
        && up(upper) >= config.min_ground_cos
        && riser.is_some_and(|riser| {
            (config.max_upright_cos..config.min_ground_cos).contains(&up(riser))
        })
}

/// Whether the depths of a plane end beside its edge with a leaning riser: at a riser that views
/// saw, they do not.
fn contradicts(end: &Edge, edge: &Edge, config: &EdgeConfig) -> bool {
    const MIN_COS: f64 = 0.97;
    if end.planes.0 != edge.planes.0 {
        return false;
    }
    let [a, b, c, d] = [edge.from, edge.to, end.from, end.to].map(nalgebra::Vector3::from);
    let (along, other) = ((b - a).normalize(), (d - c).normalize());
    let [from, to] = [c, d].map(|x| along.dot(&(x - a)));
    let overlap = from.max(to).min(edge.length_m()) - from.min(to).max(0.0);
    let away = 0.5 * (c + d) - a;
    let across = (away - along * along.dot(&away)).norm();
    along.dot(&other).abs() >= MIN_COS
        && across <= config.max_ramp_m
        && 3.0 * overlap >= edge.length_m()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edge(kind: EdgeKind, plane: u32, from: [f64; 3], to: [f64; 3]) -> Edge {
        Edge {
            kind,
            from,
            to,
            sigma_m: 0.005,
            planes: (plane, None),
            step: None,
        }
    }

    #[test]
    fn ends_of_depths_beside_a_leaning_riser_contradict_it() {
        let config = EdgeConfig::default();
        let riser = edge(EdgeKind::Convex, 3, [0.0; 3], [1.0, 0.0, 0.0]);
        let is_contradicted =
            |plane, from, to| contradicts(&edge(EdgeKind::End, plane, from, to), &riser, &config);
        assert!(is_contradicted(3, [0.1, 0.03, 0.0], [0.9, 0.02, 0.0]));
        assert!(is_contradicted(3, [0.9, 0.03, 0.0], [0.1, 0.02, 0.0]));
        assert!(
            !is_contradicted(4, [0.1, 0.03, 0.0], [0.9, 0.02, 0.0]),
            "another plane"
        );
        assert!(
            !is_contradicted(3, [0.1, 0.1, 0.0], [0.9, 0.1, 0.0]),
            "too far"
        );
        assert!(
            !is_contradicted(3, [0.9, 0.03, 0.0], [1.9, 0.03, 0.0]),
            "beside it"
        );
        assert!(
            !is_contradicted(3, [0.5, -0.03, 0.0], [0.55, 0.5, 0.0]),
            "across"
        );
    }
}
