//! A fence along the route: thin bars that repeat.
//!
//! Contract: two sides of equal bars at equal distances, [`ASIDE_M`] beside the path on its ground,
//! with two rails; no bar is nearer to any part of the path. The fence is lit like other static
//! geometry, but casts no shadow and is no obstacle to the walker.

use nalgebra::Vector3;

use super::mesh::{Mesh, Stuff};
use super::route::Route;
use crate::walker::path::Path;
use cad_transforms::so3;

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

/// The mesh of a fence with a bar at every `spacing_m` of the path. `ground(x, y, below)` is the
/// height of the highest ground that is not above `below`, m.
pub(super) fn mesh(
    route: &Route,
    ground: impl Fn(f64, f64, f64) -> Option<f64>,
    spacing_m: f64,
    stuff: Stuff,
) -> Mesh {
    let path = Path::closed(&route.points);
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
        let (mut below, mut last) = (route.start_below, None);
        for k in 0..steps(spacing_m) {
            let ([x, y], [dx, dy]) = path.at(spacing_m * k as f64);
            let at = [x - side * ASIDE_M * dy, y + side * ASIDE_M * dx];
            let height = ground(x, y, below);
            below = height.map_or(below, |height| height + STEP_UP_M);
            let (Some(height), true) = (height, is_clear(at)) else {
                last = None;
                continue;
            };
            let foot = Vector3::new(at[0], at[1], height);
            let turn = so3::exp(Vector3::z() * libm::atan2(dy, dx));
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
