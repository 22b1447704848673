//! The collision surface along a course against the true ground, by what is highest there.

use nalgebra::{Vector2, Vector3};
use scene_bundle::outputs::collision::{Collision, PartKind};
use serde_json::{Map, Value, json};
use terrain::convex::HeightLayer;

use super::course::Course;
use crate::terrain::scores::Quantiles;
use crate::terrain::truth::Truth;

/// Spacing of the places along a course, and of its parallels, m.
const ALONG_M: f64 = 0.01;
const ASIDE_M: f64 = 0.05;
/// Parallels on either side: the feet of the robot are 15 cm from its middle, which starts up to
/// 5 cm aside.
const PARALLELS: i32 = 4;
/// Within this distance of a step any height between both sides of it is right, m.
const STEP_REACH_M: f64 = 0.03;
/// Height difference of a step, m.
const STEP_M: f64 = 0.03;
/// Surfaces higher above the true ground are of another level, m.
const ABOVE_M: f64 = 0.4;
/// A foot that meets ground higher or lower by more than it expects stumbles, m.
const STUMBLE_M: f64 = 0.015;
/// Cosine of the steepest face that is looked at from above.
const MIN_UP: f64 = 1e-3;

/// A face seen from above.
struct Face {
    kind: PartKind,
    corners: [Vector3<f64>; 3],
    bounds: [Vector2<f64>; 2],
}

/// Names of what can be highest.
const KINDS: [&str; 4] = ["ground", "wall", "obstacle", "layer"];

/// Errors of the surface at places farther than 3 cm from steps.
pub(super) fn of_course(collision: &Collision, truth: &Truth<'_>, course: &Course) -> Value {
    let faces = faces(collision);
    let layers: Vec<HeightLayer> = collision
        .layers
        .iter()
        .map(|layer| HeightLayer {
            cell_m: layer.grid.cell_m,
            origin: layer.grid.origin_m,
            size: [layer.grid.columns, layer.grid.rows],
            heights: layer.heights_m.clone(),
        })
        .collect();
    let (mut errors, mut near_steps, mut holes) = (Vec::new(), 0_usize, 0_usize);
    for place in course.places(truth, ALONG_M, ASIDE_M, PARALLELS) {
        let Some(ground) = open_ground(truth, place) else {
            near_steps += 1;
            continue;
        };
        match highest(&faces, &layers, place.xy(), ground) {
            Some((height, kind)) => errors.push((height - ground, kind)),
            None => holes += 1,
        }
    }
    let count = errors.len().max(1) as f64;
    let of_kinds = |is: &dyn Fn(f64) -> bool| {
        let share = |kind: &str| {
            let own = errors
                .iter()
                .filter(|(error, own)| is(*error) && KINDS[*own] == kind);
            own.count() as f64 / count
        };
        let shares = KINDS.map(|kind| (kind.to_owned(), share(kind).into()));
        Map::from_iter(shares)
    };
    let share = |is: &dyn Fn(f64) -> bool| {
        let own = errors.iter().filter(|(error, _)| is(*error));
        own.count() as f64 / count
    };
    let (is_high, is_low) = (
        |error: f64| error >= STUMBLE_M,
        |error: f64| error <= -STUMBLE_M,
    );
    json!({
        "places": errors.len(),
        "near_steps": near_steps,
        "holes": holes,
        "height": Quantiles::of(errors.iter().map(|(error, _)| *error)),
        "share_high": share(&is_high),
        "share_low": share(&is_low),
        "high_by_kind": of_kinds(&is_high),
        "highest_by_kind": of_kinds(&|_| true),
    })
}

/// True height at a place that is farther than 3 cm from steps.
fn open_ground(truth: &Truth<'_>, place: Vector3<f64>) -> Option<f64> {
    let ground = |away: [f64; 2]| {
        let at = [place.x + away[0], place.y + away[1], place.z];
        truth.ground(at, ABOVE_M)
    };
    let own = ground([0.0; 2])?;
    let diagonal = STEP_REACH_M * std::f64::consts::FRAC_1_SQRT_2;
    let around = [
        [STEP_REACH_M, 0.0],
        [-STEP_REACH_M, 0.0],
        [0.0, STEP_REACH_M],
        [0.0, -STEP_REACH_M],
        [diagonal, diagonal],
        [diagonal, -diagonal],
        [-diagonal, diagonal],
        [-diagonal, -diagonal],
    ];
    let is_level = |away| ground(away).is_some_and(|height| (height - own).abs() < STEP_M);
    around.into_iter().all(is_level).then_some(own)
}

/// Height of the collision surface near a true height, and what it is.
fn highest(
    faces: &[Face],
    layers: &[HeightLayer],
    at: Vector2<f64>,
    ground: f64,
) -> Option<(f64, usize)> {
    let kind = |kind: PartKind| PartKind::ALL.iter().position(|own| *own == kind);
    let of_faces = faces
        .iter()
        .filter_map(|face| Some((face.height(at)?, kind(face.kind)?)));
    let of_layers = layers
        .iter()
        .filter_map(|layer| Some((layer.height_at(at.x, at.y)?, PartKind::ALL.len())));
    of_faces
        .chain(of_layers)
        .filter(|(height, _)| (height - ground).abs() < ABOVE_M)
        .max_by(|a, b| a.0.total_cmp(&b.0))
}

/// Faces that point upwards.
fn faces(collision: &Collision) -> Vec<Face> {
    let of_part = |part: &scene_bundle::outputs::collision::ConvexPart| {
        let corners = part
            .triangles
            .iter()
            .map(|triangle| triangle.map(|index| Vector3::from(part.vertices_m[index as usize])));
        let upward = corners.filter(|[a, b, c]| {
            let normal = (b - a).cross(&(c - a));
            normal.z > MIN_UP * normal.norm() && normal.z > 1e-9
        });
        let face = |corners: [Vector3<f64>; 3]| {
            let [a, b, c] = corners.map(|corner| corner.xy());
            Face {
                kind: part.kind,
                corners,
                bounds: [a.inf(&b).inf(&c), a.sup(&b).sup(&c)],
            }
        };
        upward.map(face).collect::<Vec<_>>()
    };
    collision.parts.iter().flat_map(of_part).collect()
}

impl Face {
    /// Height at a place below or above it, m.
    fn height(&self, at: Vector2<f64>) -> Option<f64> {
        let [low, high] = self.bounds;
        if at.x < low.x || at.x > high.x || at.y < low.y || at.y > high.y {
            return None;
        }
        let [a, b, c] = self.corners;
        let (u, v, d) = ((b - a).xy(), (c - a).xy(), at - a.xy());
        let area = u.perp(&v);
        let (of_b, of_c) = (d.perp(&v) / area, u.perp(&d) / area);
        let is_inside = of_b >= -1e-9 && of_c >= -1e-9 && of_b + of_c <= 1.0 + 1e-9;
        is_inside.then(|| a.z + of_b * (b.z - a.z) + of_c * (c.z - a.z))
    }
}

#[cfg(test)]
mod tests {
    use scene_bundle::outputs::collision::ConvexPart;

    use super::*;

    #[test]
    fn the_highest_of_parts_and_layers_is_found() {
        let part = |kind, z: f64| ConvexPart {
            kind,
            plane: None,
            vertices_m: vec![
                [0.0, 0.0, z],
                [1.0, 0.0, z],
                [0.0, 1.0, z],
                [0.2, 0.2, z - 0.1],
            ],
            triangles: vec![[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]],
        };
        let collision = Collision {
            parts: vec![part(PartKind::Ground, 0.0), part(PartKind::Obstacle, 0.02)],
            ..Collision::default()
        };
        let faces = faces(&collision);
        assert_eq!(faces.len(), 2, "lower faces are left out");
        let layer = HeightLayer {
            cell_m: 1.0,
            origin: [0.0, 0.0],
            size: [2, 2],
            heights: vec![0.01; 4],
        };
        let layers = [layer];
        let found = |x, y, ground| highest(&faces, &layers, Vector2::new(x, y), ground);
        assert_eq!(found(0.2, 0.3, 0.0), Some((0.02, 2)));
        let (height, kind) = found(0.9, 0.9, 0.0).expect("the layer");
        assert!((height - 0.01).abs() < 1e-6 && KINDS[kind] == "layer");
        assert_eq!(found(0.2, 0.3, 1.0), None, "another level");
        assert_eq!(found(1.2, 0.3, 0.0), None);
    }
}
