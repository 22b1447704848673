//! Convex parts for physics: prisms of planes, and a height layer for ground that is not plane.
//!
//! Contract: the surface of a prism is its plane, exact in height, with borders on the edges of the
//! plane. The height layer runs on below their borders, by `layer_seam_m` of [`ConvexConfig`], so
//! that no ditch is where one ends, and deeper where prisms are everywhere around; beside a step it
//! drops to the lower ground there. Ramps by which matchers join both sides of a step
//! are no surface. Where nothing was seen there is neither. The collision surface at a place is the
//! higher one of the prisms and the triangles of the layer ([`HeightLayer::height_at`]).
//! [`CollisionReport`] compares it with the maps. Things that are not plane and not ground have
//! parts with the feature `obstacles` only.

use crate::config::ConvexConfig;
use crate::edges::{Edge, Ramps};
use crate::maps::Level;
use crate::planes::Planes;

mod faces;
mod layer;
mod layer_heights;
#[cfg(feature = "obstacles")]
mod obstacles;
mod pieces;
mod prism;
mod report;
mod steps;

pub use self::{layer::HeightLayer, prism::ConvexPart, report::CollisionReport};
#[cfg(feature = "obstacles")]
pub use obstacles::{Obstacle, obstacle_parts};

use faces::Faces;
use layer_heights::height_layer;

/// Parts for physics.
#[derive(Clone, Debug, PartialEq)]
pub struct Collision {
    /// Prisms of planes.
    pub parts: Vec<ConvexPart>,
    /// One layer per level.
    pub layers: Vec<HeightLayer>,
    /// See [`CollisionReport`].
    pub report: CollisionReport,
}

/// Parts of planes and levels.
pub fn collision_parts(
    planes: &Planes,
    edges: &[Edge],
    levels: &[Level],
    config: &ConvexConfig,
) -> Collision {
    let ramps = Ramps::new(planes, edges, &config.ramps);
    let is_ramp = |edge: &Edge| edge.plane_numbers().any(|number| ramps.is_ramp(number));
    let all = edges;
    let edges: Vec<&Edge> = all.iter().filter(|edge| !is_ramp(edge)).collect();
    let mut parts = Vec::new();
    for (number, plane) in planes.planes.iter().enumerate() {
        if ramps.is_ramp(number) {
            continue;
        }
        let of_plane: Vec<&Edge> = edges
            .iter()
            .copied()
            .filter(|edge| edge.plane_numbers().any(|own| own == number))
            .collect();
        let is_alone = !all
            .iter()
            .any(|edge| edge.plane_numbers().any(|own| own == number));
        if is_alone && plane.area_m2 < config.min_plane_m2 {
            continue;
        }
        for piece in pieces::pieces(plane, config) {
            let piece = match plane.normal[2] >= config.min_ground_cos {
                true => steps::to_foot(&ramps, number, plane, piece, config),
                false => steps::below_edges(&edges, plane, piece, config),
            };
            parts.extend(prism::prism(number, plane, &piece, &of_plane, config));
        }
    }
    let faces = Faces::new(&parts, planes);
    let layers: Vec<HeightLayer> = levels
        .iter()
        .map(|level| height_layer(&faces, level, config))
        .collect();
    let report = report::report(parts.len(), &faces, levels, &layers);
    Collision {
        parts,
        layers,
        report,
    }
}
