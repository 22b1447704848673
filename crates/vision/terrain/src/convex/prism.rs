//! A piece of a plane with thickness.

use nalgebra::Vector3;

use crate::config::ConvexConfig;
use crate::edges::Edge;
use crate::hull::{convex_hull, with_at_most};
use crate::planes::Plane;

/// A convex part: the hull of its vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvexPart {
    /// The plane of its surface.
    pub plane: u32,
    /// Corners: those of the surface, then those of the other side in the same order, m.
    pub vertices: Vec<[f64; 3]>,
    /// Triangles of its faces, counterclockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Outline of the surface in coordinates of the plane.
    pub(super) outline: Vec<[f64; 2]>,
}

impl ConvexPart {
    /// Volume, m3.
    pub fn volume_m3(&self) -> f64 {
        let origin = Vector3::from(self.vertices[0]);
        let of = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|i| Vector3::from(self.vertices[i as usize]) - origin);
            a.dot(&b.cross(&c)) / 6.0
        };
        self.triangles.iter().map(of).sum()
    }
}

/// Line of an edge in coordinates of a plane, with its ends along it.
struct EdgeLine {
    point: [f64; 2],
    along: [f64; 2],
    length: f64,
    /// Side of the plane, as the sign of coordinates across the line; 0 if it is on both.
    side: f64,
    /// Whether the plane ends at the line also beyond the ends of the edge.
    is_whole_border: bool,
}

/// The prism of a piece, with its border on the edges near it.
pub(super) fn prism(
    number: usize,
    plane: &Plane,
    piece: &[[f64; 2]],
    edges: &[&Edge],
    config: &ConvexConfig,
) -> Option<ConvexPart> {
    let lines = edges.iter().filter_map(|edge| line(plane, edge, config));
    let lines: Vec<EdgeLine> = lines.collect();
    let mut corners = piece.to_vec();
    // Corners where an edge ends or meets the border of the piece.
    for line in &lines {
        corners.extend(border_points(piece, line, config.edge_reach_m));
    }
    let snapped: Vec<[f64; 2]> = corners
        .iter()
        .map(|corner| snapped(*corner, &lines, config.edge_reach_m))
        .collect();
    let mut outline = convex_hull(snapped);
    for line in &lines {
        outline = clipped(outline, line, config.edge_reach_m);
    }
    let outline = with_at_most(convex_hull(outline), config.max_corners);
    if outline.len() < 3 {
        return None;
    }
    let is_ground = plane.frame.normal.z >= config.min_ground_cos;
    let thickness = if is_ground {
        config.ground_thickness_m
    } else {
        config.wall_thickness_m
    };
    let count = outline.len();
    let middle = [0, 1].map(|k| outline.iter().map(|at| at[k]).sum::<f64>() / count as f64);
    let mut vertices: Vec<[f64; 3]> = outline
        .iter()
        .map(|at| plane.frame.position(*at).into())
        .collect();
    vertices.extend(outline.iter().map(|at| {
        let is_on_edge = lines.iter().any(|line| line.distance(*at) < 1e-6);
        let out = [at[0] - middle[0], at[1] - middle[1]];
        let norm = out[0].hypot(out[1]).max(1e-9);
        let overlap = if is_on_edge { 0.0 } else { config.overlap_m };
        let below = [0, 1].map(|k| at[k] + overlap * out[k] / norm);
        let x = plane.frame.position(below) - plane.frame.normal * thickness;
        <[f64; 3]>::from(x)
    }));
    let n = count as u32;
    let mut triangles = Vec::new();
    for i in 1..n - 1 {
        triangles.push([0, i, i + 1]);
        triangles.push([n, n + i + 1, n + i]);
    }
    for i in 0..n {
        let j = (i + 1) % n;
        triangles.push([i, n + i, n + j]);
        triangles.push([i, n + j, j]);
    }
    Some(ConvexPart {
        plane: number as u32,
        vertices,
        triangles,
        outline,
    })
}

impl EdgeLine {
    /// Coordinates along the line and across it.
    fn coordinates(&self, at: [f64; 2]) -> [f64; 2] {
        let d = [at[0] - self.point[0], at[1] - self.point[1]];
        let [x, y] = self.along;
        [d[0] * x + d[1] * y, d[1] * x - d[0] * y]
    }

    fn at(&self, along: f64) -> [f64; 2] {
        [0, 1].map(|k| self.point[k] + along * self.along[k])
    }

    fn distance(&self, at: [f64; 2]) -> f64 {
        self.coordinates(at)[1].abs()
    }
}

fn line(plane: &Plane, edge: &Edge, config: &ConvexConfig) -> Option<EdgeLine> {
    let [from, to] = [edge.from, edge.to].map(|x| {
        let [s, t, _] = plane.frame.coordinates(&Vector3::from(x));
        [s, t]
    });
    let along = [to[0] - from[0], to[1] - from[1]];
    let length = along[0].hypot(along[1]);
    let mut line = EdgeLine {
        point: from,
        along: along.map(|v| v / length),
        length,
        side: 0.0,
        is_whole_border: false,
    };
    line.side = side(plane, &line);
    line.is_whole_border = edge.step.is_some() && is_whole_border(plane, &line, config);
    (length > 1e-3).then_some(line)
}

/// Side of a line on which a plane was observed, if it is hardly on the other one; near it matchers
/// make the plane wider.
fn side(plane: &Plane, line: &EdgeLine) -> f64 {
    const NEAR_M: [[f64; 3]; 2] = [[0.03, 0.05, 0.07], [0.09, 0.12, 0.15]];
    let sides = NEAR_M.map(|across_m| side_at(plane, line, across_m));
    sides.into_iter().find(|side| *side != 0.0).unwrap_or(0.0)
}

/// The same at distances from the line, m.
fn side_at(plane: &Plane, line: &EdgeLine, across_m: [f64; 3]) -> f64 {
    let samples = (line.length / 0.02).ceil().max(1.0);
    let count = |sign: f64| {
        let observed = (0..samples as usize).flat_map(|k| across_m.map(|across| (k, across)));
        let at = |(k, across): (usize, f64)| {
            let at = line.at((k as f64 + 0.5) / samples * line.length);
            let [x, y] = line.along;
            [at[0] - sign * across * y, at[1] + sign * across * x]
        };
        let is_observed = |at: [f64; 2]| {
            let index = plane.support.index(at);
            index.is_some_and(|index| plane.observed[index])
        };
        observed.map(at).filter(|at| is_observed(*at)).count()
    };
    match (count(1.0), count(-1.0)) {
        (left, right) if left > 3 * right => 1.0,
        (left, right) if right > 3 * left => -1.0,
        _ => 0.0,
    }
}

/// Whether hardly anything of a plane was observed farther beyond a line than matchers make it
/// wider.
fn is_whole_border(plane: &Plane, line: &EdgeLine, config: &ConvexConfig) -> bool {
    let observed = plane.observed.iter().enumerate().filter(|(_, is)| **is);
    let is_beyond = |index: usize| {
        let [_, across] = line.coordinates(plane.support.center(index));
        line.side * across < -config.max_overhang_m
    };
    let (mut count, mut beyond) = (0_usize, 0_usize);
    for (index, _) in observed {
        count += 1;
        beyond += usize::from(is_beyond(index));
    }
    beyond as f64 <= config.max_beyond_share * count as f64
}

/// An outline without what is beyond an edge of its plane.
fn clipped(outline: Vec<[f64; 2]>, line: &EdgeLine, reach: f64) -> Vec<[f64; 2]> {
    let inside = |at: [f64; 2]| line.side * line.coordinates(at)[1] >= -1e-9;
    let beyond = outline.iter().filter(|at| !inside(**at));
    let (low, high) = beyond
        .map(|at| line.coordinates(*at)[0])
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), along| {
            (low.min(along), high.max(along))
        });
    let overlap = (high.min(line.length) - low.max(0.0)).max(0.0) + 2.0 * reach;
    // What is beyond the line has to be mostly beside the edge, or little everywhere.
    let is_beside = line.is_whole_border || 2.0 * overlap >= high - low;
    if line.side == 0.0 || low > high || !is_beside {
        return outline;
    }
    let next = outline.iter().cycle().skip(1);
    let mut kept = Vec::new();
    for (a, b) in outline.iter().zip(next) {
        if inside(*a) {
            kept.push(*a);
        }
        if inside(*a) != inside(*b) {
            let [from, to] = [a, b].map(|at| line.coordinates(*at));
            let share = from[1] / (from[1] - to[1]);
            kept.push(line.at(from[0] + share * (to[0] - from[0])));
        }
    }
    kept
}

/// A corner moved to the nearest edges within reach: to their meeting if there are two.
fn snapped(corner: [f64; 2], lines: &[EdgeLine], reach: f64) -> [f64; 2] {
    let mut at = corner;
    for _ in 0..3 {
        for line in lines {
            let [along, across] = line.coordinates(at);
            let is_beside = along >= -reach && along <= line.length + reach;
            if is_beside && across.abs() <= reach {
                at = line.at(along);
            }
        }
    }
    at
}

/// Points of the border of a piece at the ends of an edge along it: the piece may be wider.
fn border_points(piece: &[[f64; 2]], line: &EdgeLine, reach: f64) -> Vec<[f64; 2]> {
    let range = piece
        .iter()
        .map(|at| line.coordinates(*at))
        .filter(|[_, across]| across.abs() <= reach);
    let (low, high) = range.fold(
        (f64::INFINITY, f64::NEG_INFINITY),
        |(low, high), [along, _]| (low.min(along), high.max(along)),
    );
    // Only where the piece has a border along the edge.
    match high - low > reach {
        true => vec![line.at(low.max(0.0)), line.at(high.min(line.length))],
        false => Vec::new(),
    }
}
