//! Pieces of planes beside steps: ground reaches to the foot of the step, and risers end at the
//! ground above them.

use nalgebra::{Vector2, Vector3};

use crate::config::ConvexConfig;
use crate::edges::{Edge, Ramps};
use crate::hull::convex_hull;
use crate::planes::Plane;

/// Least cosine of the horizontal angle between the normal of a riser and the direction down its
/// step.
const FACING_COS: f64 = 0.7;

/// A piece of ground that also reaches to the feet of the steps whose ramps are on its plane.
pub(super) fn to_foot(
    ramps: &Ramps<'_>,
    number: usize,
    plane: &Plane,
    piece: Vec<[f64; 2]>,
    config: &ConvexConfig,
) -> Vec<[f64; 2]> {
    let own = ramps.strips().iter().filter(|strip| strip.below == number);
    let mut corners = piece.clone();
    for strip in own {
        let (extension, run) = (config.ramps.max_extension_m, config.ramps.max_run_m);
        for corner in &piece {
            let x = plane.frame.position(*corner);
            let [along, away] = strip.coordinates(&x.xy());
            let is_beside = (-extension..=strip.length_m + extension).contains(&along)
                && (0.0..=run).contains(&away)
                && ramps.is_step(strip, along);
            if is_beside {
                let foot = x.xy() - strip.direction * away;
                corners.extend(on_plane(plane, foot));
            }
        }
    }
    convex_hull(corners)
}

/// Coordinates on a plane of the point above or below a place.
fn on_plane(plane: &Plane, at: Vector2<f64>) -> Option<[f64; 2]> {
    let height = plane.height_at(at.x, at.y)?;
    let [s, t, _] = plane.frame.coordinates(&Vector3::new(at.x, at.y, height));
    Some([s, t])
}

/// A piece of a riser without what is above the edge of the ground at its top, if it reaches
/// hardly beyond.
pub(super) fn below_edges(
    edges: &[&Edge],
    plane: &Plane,
    piece: Vec<[f64; 2]>,
    config: &ConvexConfig,
) -> Vec<[f64; 2]> {
    let height = |corner: &[f64; 2]| plane.frame.position(*corner).z;
    let mut piece = piece;
    for edge in edges {
        let Some(step) = edge.step else {
            continue;
        };
        let direction = Vector2::from(step.direction);
        let horizontal = plane.frame.normal.xy();
        let from = Vector3::from(edge.from);
        let along = (Vector3::from(edge.to) - from).xy();
        let length = along.norm();
        let along = along / length;
        let places = piece.iter().map(|corner| {
            let d = plane.frame.position(*corner).xy() - from.xy();
            [along.dot(&d), direction.dot(&d)]
        });
        let range = |k: usize| {
            let values = places.clone().map(move |place| place[k]);
            let low = values.clone().fold(f64::INFINITY, f64::min);
            [low, values.fold(f64::NEG_INFINITY, f64::max)]
        };
        let ([first, last], [near, far]) = (range(0), range(1));
        let overlap = last.min(length) - first.max(0.0);
        let top = piece.iter().map(height).fold(f64::NEG_INFINITY, f64::max);
        let limit = edge.middle()[2] - config.layer_seam_m;
        let is_riser = horizontal.dot(&direction) >= FACING_COS * horizontal.norm()
            && 2.0 * overlap >= last - first
            && near >= -config.edge_reach_m - config.wall_thickness_m
            && far <= config.edge_reach_m + config.wall_thickness_m;
        if is_riser && top > limit && top <= limit + config.max_riser_top_m {
            piece = below(&piece, limit, &height);
        }
    }
    piece
}

/// The part of a convex polygon that is below a height.
fn below(polygon: &[[f64; 2]], limit: f64, height: &impl Fn(&[f64; 2]) -> f64) -> Vec<[f64; 2]> {
    let next = polygon.iter().cycle().skip(1);
    let mut kept = Vec::new();
    for (a, b) in polygon.iter().zip(next) {
        let [from, to] = [a, b].map(|corner| height(corner) - limit);
        if from <= 0.0 {
            kept.push(*a);
        }
        if (from <= 0.0) != (to <= 0.0) {
            let share = from / (from - to);
            kept.push([0, 1].map(|k| a[k] + share * (b[k] - a[k])));
        }
    }
    kept
}
