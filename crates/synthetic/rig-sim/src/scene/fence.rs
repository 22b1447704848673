//! A fence along the route: thin bars that repeat.
//!
//! Contract: two sides of equal bars at equal distances, [`ASIDE_M`] beside the path on its ground,
//! with two rails; no bar is nearer to any part of the path. The fence is lit like other static
//! geometry, but casts no shadow and is no obstacle to the walker.

use nalgebra::Vector3;

use super::Scene;
use super::build::Builder;
use super::mesh::{Mesh, Stuff};
use crate::walker::path::Path;

/// Distance from the path, m.
const ASIDE_M: f64 = 1.2;
/// Height, m.
const HEIGHT_M: f64 = 1.1;
/// Width of a bar, m.
const BAR_M: f64 = 0.02;
/// Heights of the rails, m.
const RAILS_M: [f64; 2] = [0.12, 1.05];
/// Height of a rail, m.
const RAIL_M: f64 = 0.03;
/// Distance of the positions on the path that are kept free, m.
const CLEARANCE_STEP_M: f64 = 0.1;
/// Height above the last ground within which the next is searched, m.
const STEP_UP_M: f64 = 0.5;

/// The mesh of a fence with a bar at every `spacing_m` of the path.
pub(super) fn mesh(scene: &Scene, spacing_m: f64, stuff: Stuff) -> Mesh {
    let path = Path::closed(&scene.route.points);
    let steps = |step_m: f64| (path.length_m() / step_m).floor() as usize;
    let free: Vec<[f64; 2]> = (0..steps(CLEARANCE_STEP_M))
        .map(|k| path.at(CLEARANCE_STEP_M * k as f64).0)
        .collect();
    let is_clear = |[x, y]: [f64; 2]| {
        let square = |p: &[f64; 2]| (p[0] - x).powi(2) + (p[1] - y).powi(2);
        // The nearest position of the path is that of the bar, up to its steps.
        free.iter().all(|p| square(p) > (0.95 * ASIDE_M).powi(2))
    };
    let mut mesh = Mesh::default();
    for side in [-1.0, 1.0] {
        let (mut below, mut last) = (scene.route.start_below, None);
        for k in 0..steps(spacing_m) {
            let ([x, y], [dx, dy]) = path.at(spacing_m * k as f64);
            let at = [x - side * ASIDE_M * dy, y + side * ASIDE_M * dx];
            let ground = scene.ground(x, y, below);
            below = ground.map_or(below, |ground| ground.height + STEP_UP_M);
            let (Some(ground), true) = (ground, is_clear(at)) else {
                last = None;
                continue;
            };
            let foot = Vector3::new(at[0], at[1], ground.height);
            let turn = Builder::yaw(libm::atan2(dy, dx));
            let size = Vector3::new(BAR_M, BAR_M, HEIGHT_M);
            let center = foot + Vector3::z() * (0.5 * HEIGHT_M);
            mesh.cuboid(center, size, turn, HEIGHT_M, stuff);
            if let Some(before) = last.replace(foot) {
                rails(&mut mesh, before, foot, stuff);
            }
        }
    }
    mesh
}

/// The rails between two bars.
fn rails(mesh: &mut Mesh, from: Vector3<f64>, to: Vector3<f64>, stuff: Stuff) {
    let across = Vector3::z().cross(&(to - from));
    let half = across.normalize() * (0.5 * BAR_M);
    // Counter-clockwise from above.
    let outline = |up: f64| {
        let up = Vector3::z() * up;
        [from - half, to - half, to + half, from + half].map(|corner| corner + up)
    };
    for height in RAILS_M {
        mesh.prism(outline(height), outline(height + RAIL_M), 1.0, stuff);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::placed;
    use crate::scene::{Kind, Scenery, by_day};

    fn fenced(kind: Kind, fence_spacing_m: f64) -> Scene {
        let mut scene = (*by_day(kind, 1)).clone();
        scene.furnish(&Scenery {
            fence_spacing_m,
            ..Scenery::default()
        });
        scene
    }

    #[test]
    fn bars_are_beside_the_path_on_its_ground() {
        for kind in [Kind::Pavement, Kind::Stairs] {
            let scene = fenced(kind, 0.12);
            let path = Path::closed(&scene.route.points);
            let near = |p: &Vector3<f64>| {
                let steps = 0..(path.length_m() / 0.1) as usize;
                let of = |k: usize| {
                    let ([x, y], _) = path.at(0.1 * k as f64);
                    libm::hypot(p.x - x, p.y - y)
                };
                steps.map(of).fold(f64::MAX, f64::min)
            };
            let corners = scene.fence.triangles.iter().flat_map(|t| &t.corners);
            let corners: Vec<_> = corners.step_by(37).map(|c| c.position).collect();
            assert!(corners.len() > 100, "{kind:?}: {}", corners.len());
            for corner in &corners {
                let distance = near(corner);
                assert!((1.1..1.3).contains(&distance), "{kind:?}: {distance}");
            }
        }
    }

    #[test]
    fn no_spacing_is_no_fence() {
        let (with, without) = (fenced(Kind::Pavement, 0.2), fenced(Kind::Pavement, 0.0));
        assert!(without.fence.triangles.is_empty());
        let (with, without) = (placed(&with), placed(&without));
        assert_eq!(with.len(), without.len() + 1);
        assert_eq!(with[1].first, with[0].next());
    }
}
