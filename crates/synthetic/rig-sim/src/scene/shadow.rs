//! Shadows of the sun with sharp outlines: triangles are cut where sunlight on them is not linear.
//!
//! Contract: only the ground and walls are cut, finer near the path, and a cut moves no surface. An
//! edge is cut in its middle for both triangles that share it, so no crack opens.

use std::collections::{HashMap, HashSet};

use nalgebra::Vector3;

use super::bvh::Bvh;
use super::light::{Light, Lit, RAY_OFFSET_M};
use super::mesh::{Corner, Mesh, Triangle};
use super::route::Route;
use super::surface::{Class, Material};
use crate::walker::path::Path;

/// Minimum edge length near the path, m; farther away it grows in proportion to the distance.
const MIN_EDGE_M: f64 = 0.06;
const FULL_DETAIL_M: f64 = 1.6;
/// Maximum distance from the path at which edges are cut, m.
const MAX_DISTANCE_M: f64 = 10.0;
/// Distance between sunlight samples along an edge, m.
const SAMPLE_SPACING_M: f64 = 0.07;
const MAX_SAMPLES: usize = 8;
/// Maximum deviation from linear, as a fraction of the light.
const TOLERANCE: f32 = 0.12;
/// Maximum number of bisections of an edge.
const MAX_ROUNDS: usize = 5;
/// Maximum number of triangles.
const MAX_TRIANGLES: usize = 150_000;

/// A triangle during subdivision.
#[derive(Clone, Copy)]
struct Piece {
    triangle: Triangle,
    lit: [Lit; 3],
    /// Whether it may still be cut.
    is_open: bool,
}

type Edge = [[u64; 3]; 2];

/// Sunlight at a point by the surface's smoothed and flat normals.
type Sunlight<'a> = dyn Fn(&Vector3<f64>, &Vector3<f64>, &Vector3<f64>) -> f32 + 'a;

fn edge(a: &Corner, b: &Corner) -> Edge {
    let [a, b] = [a, b].map(|c| [c.position.x, c.position.y, c.position.z].map(f64::to_bits));
    if a < b { [a, b] } else { [b, a] }
}

/// The subdivided mesh, and the irradiance at the corners of each triangle.
pub(super) fn baked(
    mesh: &Mesh,
    materials: &[Material],
    light: &Light,
    solid: &Bvh,
    route: &Route,
) -> (Mesh, Vec<[f32; 3]>) {
    let path = Path::closed(&route.points);
    let places: Vec<[f64; 2]> = (0..(2.0 * path.length_m()) as u32)
        .map(|i| path.at(0.5 * f64::from(i)).0)
        .collect();
    let away = |p: &Vector3<f64>| {
        let square = |q: &[f64; 2]| (q[0] - p.x) * (q[0] - p.x) + (q[1] - p.y) * (q[1] - p.y);
        places.iter().map(square).fold(f64::MAX, f64::min).sqrt()
    };
    let lit = light.lit(mesh, solid);
    let mut pieces: Vec<Piece> = mesh
        .triangles
        .iter()
        .zip(lit)
        .map(|(triangle, lit)| Piece {
            triangle: *triangle,
            lit,
            is_open: matches!(
                materials[usize::from(triangle.material)].class,
                Class::Pavement
                    | Class::Road
                    | Class::Crosswalk
                    | Class::Grass
                    | Class::Stair
                    | Class::Wall
            ),
        })
        .collect();
    let sunlight = |p: &Vector3<f64>, normal: &Vector3<f64>, flat: &Vector3<f64>| {
        let start = p + flat * RAY_OFFSET_M;
        light.sunlight(normal, |d, reach| solid.is_hidden(&start, d, reach)) as f32
    };
    // Without sun nothing is cut.
    let rounds = if light.sun.is_some() { MAX_ROUNDS } else { 0 };
    for _ in 0..rounds {
        let mut to_cut: Vec<(u64, Edge)> = Vec::new();
        // Two triangles share an edge: it is sampled once.
        let mut judged: HashMap<Edge, bool> = HashMap::new();
        for piece in pieces.iter_mut().filter(|p| p.is_open) {
            let corners = &piece.triangle.corners;
            let distance = away(&corners[0].position);
            let finest = MIN_EDGE_M * (distance / FULL_DETAIL_M).max(1.0);
            // A triangle without edges to cut has none later.
            piece.is_open = false;
            if distance > MAX_DISTANCE_M {
                continue;
            }
            let flat = piece.triangle.normal();
            for k in 0..3 {
                let (i, j) = (k, (k + 1) % 3);
                let (a, b) = (&corners[i], &corners[j]);
                let length = (b.position - a.position).norm();
                if length < 2.0 * finest {
                    continue;
                }
                let name = edge(a, b);
                if let Some(&is_uneven) = judged.get(&name) {
                    piece.is_open |= is_uneven;
                    continue;
                }
                let is_uneven = is_uneven(piece, [i, j], length, &flat, &sunlight);
                judged.insert(name, is_uneven);
                piece.is_open |= is_uneven;
                if is_uneven {
                    to_cut.push((distance.to_bits(), name));
                }
            }
        }
        // The nearest ones, if there are too many: each adds at most two triangles.
        to_cut.sort_unstable();
        to_cut.truncate(MAX_TRIANGLES.saturating_sub(pieces.len()) / 2);
        if to_cut.is_empty() {
            break;
        }
        let cut: HashSet<Edge> = to_cut.into_iter().map(|(_, edge)| edge).collect();
        pieces = pieces
            .iter()
            .flat_map(|piece| divided(piece, &cut, &sunlight))
            .collect();
    }
    let light = pieces
        .iter()
        .map(|p| p.lit.map(|l| l.soft + l.sun))
        .collect();
    let triangles = pieces.into_iter().map(|p| p.triangle).collect();
    (Mesh { triangles }, light)
}

/// Whether the sunlight along an edge of this length differs from the interpolation between its
/// corners.
fn is_uneven(
    piece: &Piece,
    [i, j]: [usize; 2],
    length: f64,
    flat: &Vector3<f64>,
    sunlight: &Sunlight<'_>,
) -> bool {
    let (a, b) = (&piece.triangle.corners[i], &piece.triangle.corners[j]);
    let (la, lb) = (&piece.lit[i], &piece.lit[j]);
    let samples = ((length / SAMPLE_SPACING_M) as usize).clamp(1, MAX_SAMPLES);
    (1..=samples).any(|n| {
        let t = n as f64 / (samples + 1) as f64;
        let p = a.position + (b.position - a.position) * t;
        let normal = (la.normal * (1.0 - t) + lb.normal * t).normalize();
        let found = sunlight(&p, &normal, flat);
        let expected = la.sun + (lb.sun - la.sun) * t as f32;
        let level = found.max(expected) + la.soft;
        (found - expected).abs() > TOLERANCE * level
    })
}

/// A triangle, cut along the lines between the middles of its cut edges.
fn divided(piece: &Piece, cut: &HashSet<Edge>, sunlight: &Sunlight<'_>) -> Vec<Piece> {
    let corners = &piece.triangle.corners;
    let is_cut = [0, 1, 2].map(|k| cut.contains(&edge(&corners[k], &corners[(k + 1) % 3])));
    let flat = piece.triangle.normal();
    let middle = |k: usize| {
        let (i, j) = (k, (k + 1) % 3);
        let (a, b) = (&corners[i], &corners[j]);
        let (la, lb) = (&piece.lit[i], &piece.lit[j]);
        // A sum does not depend on the order of two.
        let position = (a.position + b.position) * 0.5;
        let normal = (la.normal + lb.normal).normalize();
        let corner = Corner {
            position,
            uv: [0, 1].map(|n| 0.5 * (a.uv[n] + b.uv[n])),
        };
        let lit = Lit {
            normal,
            soft: 0.5 * (la.soft + lb.soft),
            sun: sunlight(&position, &normal, &flat),
        };
        (corner, lit)
    };
    let corner = |k: usize| (corners[k % 3], piece.lit[k % 3]);
    let part = |part: [(Corner, Lit); 3]| Piece {
        triangle: Triangle {
            corners: part.map(|(c, _)| c),
            ..piece.triangle
        },
        lit: part.map(|(_, l)| l),
        is_open: piece.is_open,
    };
    match is_cut.iter().filter(|&&c| c).count() {
        0 => vec![*piece],
        1 => {
            // From the middle of the cut edge to the corner across.
            let k = is_cut.iter().position(|&c| c).unwrap_or(0);
            let m = middle(k);
            let across = corner(k + 2);
            vec![
                part([corner(k), m, across]),
                part([m, corner(k + 1), across]),
            ]
        }
        2 => {
            // A tip between the two cut edges, and a quadrilateral.
            let whole = is_cut.iter().position(|&c| !c).unwrap_or(0);
            let (m, n) = (middle((whole + 1) % 3), middle((whole + 2) % 3));
            let (a, b, tip) = (corner(whole), corner(whole + 1), corner(whole + 2));
            vec![part([m, tip, n]), part([a, b, m]), part([a, m, n])]
        }
        _ => {
            let m = [0, 1, 2].map(middle);
            let mut parts: Vec<Piece> = (0..3)
                .map(|k| part([corner(k), m[k], m[(k + 2) % 3]]))
                .collect();
            parts.push(part(m));
            parts
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::mesh::Stuff;

    /// A wall's shadow across a ground of large cells, under a sun 45 degrees high.
    #[test]
    fn shadow_edge_is_correct_and_the_mesh_has_no_cracks() {
        let stuff = Stuff {
            material: 0,
            instance: 0,
        };
        let material = Material {
            class: Class::Pavement,
            walkable: true,
            texture: 0,
            texel_m: 0.001,
            albedo: [0.3; 3],
            other_albedo: [0.3; 3],
            glow: 0.0,
        };
        let light = Light {
            sun: Some((Vector3::new(-1.0, 0.0, 1.0).normalize(), 1.0)),
            sky: 0.1,
            lamps: Vec::new(),
            tint: [1.0; 3],
            flicker: None,
        };
        let mut mesh = Mesh::default();
        mesh.ground([-3.0, -3.0], [3.0, 3.0], 1.0, |_, _| 0.0, |_, _| stuff);
        let wall = [(-0.5, -0.2), (-0.5, 0.7), (-0.5, 0.7), (-0.5, -0.2)];
        let heights = [0.0, 0.0, 1.0, 1.0];
        let corners = [0, 1, 2, 3].map(|k: usize| Vector3::new(wall[k].0, wall[k].1, heights[k]));
        mesh.quad(corners, [0.0; 2], stuff);
        let solid = Bvh::new(mesh.triangles.iter().map(|t| t.corners.map(|c| c.position)));
        let route = Route {
            points: vec![[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]],
            start_below: 1.0,
            legs: Vec::new(),
        };
        let (cut, lit) = baked(&mesh, &[material], &light, &solid, &route);
        let (before, after) = (mesh.triangles.len(), cut.triangles.len());
        assert!(after > 2 * before, "{before} {after}");

        // The area of the ground is unchanged, and its lit part is the part that the wall does not
        // occlude.
        let (mut all, mut dark) = (0.0, 0.0);
        let mut ends = std::collections::HashMap::new();
        for (triangle, lit) in cut.triangles.iter().zip(&lit) {
            let [a, b, c] = triangle.corners.map(|c| c.position);
            if a.z + b.z + c.z > 0.0 {
                continue;
            }
            let area = 0.5 * (b - a).cross(&(c - a)).norm();
            all += area;
            let bright = 0.5_f64.sqrt();
            let mean = lit.iter().map(|&l| f64::from(l)).sum::<f64>() / 3.0;
            dark += area * ((0.1 + bright - mean) / bright).clamp(0.0, 1.0);
            for k in 0..3 {
                let (a, b) = (&triangle.corners[k], &triangle.corners[(k + 1) % 3]);
                *ends.entry(edge(a, b)).or_insert(0) += 1;
            }
        }
        assert!((all - 36.0).abs() < 1e-9, "{all}");
        // 0.9 m wide and 1 m long; the sky's part is slightly reduced beside the wall.
        assert!((dark - 0.9).abs() < 0.12, "{dark}");
        // Every edge belongs to two triangles but those at the rim, 24 m of it.
        let rim = ends.values().filter(|&&n| n == 1).count();
        let more = ends.values().filter(|&&n| n > 2).count();
        assert!(more == 0 && rim >= 24, "{rim} {more}");
        let alone: f64 = ends
            .iter()
            .filter(|(_, n)| **n == 1)
            .map(|(edge, _)| {
                let [a, b] = edge.map(|p| Vector3::from(p.map(f64::from_bits)));
                (b - a).norm()
            })
            .sum();
        assert!((alone - 24.0).abs() < 1e-9, "{alone}");
    }
}
