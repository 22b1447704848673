//! Edges where two planes meet.

use nalgebra::Vector3;

use super::edge::{Edge, EdgeKind};
use super::runs::Runs;
use crate::config::EdgeConfig;
use crate::planes::Plane;

/// Support of a plane beside a line.
struct Beside {
    runs: Runs,
    /// Direction on the plane from the line to most of the support.
    inward: Vector3<f64>,
}

/// All edges where two planes meet.
pub(super) fn intersections(planes: &[Plane], config: &EdgeConfig) -> Vec<Edge> {
    let bounds: Vec<[Vector3<f64>; 2]> = planes
        .iter()
        .map(|plane| bounds(plane, config.max_support_gap_m))
        .collect();
    let mut edges = Vec::new();
    for i in 0..planes.len() {
        for j in i + 1..planes.len() {
            let touches = (0..3)
                .all(|k| bounds[i][0][k] <= bounds[j][1][k] && bounds[j][0][k] <= bounds[i][1][k]);
            if touches {
                add_edges(planes, [i, j], config, &mut edges);
            }
        }
    }
    edges
}

fn add_edges(planes: &[Plane], [i, j]: [usize; 2], config: &EdgeConfig, edges: &mut Vec<Edge>) {
    // The more level plane is first.
    let level = |i: usize| planes[i].frame.normal.z.abs();
    let (i, j) = if level(i) >= level(j) { (i, j) } else { (j, i) };
    let (a, b) = (&planes[i].frame, &planes[j].frame);
    let cross = a.normal.cross(&b.normal);
    let sin = cross.norm();
    // Planes that face each other or away from each other are sides of something thin.
    let min_sin = config.min_angle_rad - config.min_angle_rad.powi(3) / 6.0;
    if sin < min_sin {
        return;
    }
    let along = cross / sin;
    let middle = 0.5 * (a.origin + b.origin);
    // The point of the line nearest to the middle.
    let [to_a, to_b] = [a, b].map(|f| f.normal.dot(&(f.origin - middle)));
    let cos = a.normal.dot(&b.normal);
    let shares = [to_a - cos * to_b, to_b - cos * to_a].map(|v| v / (sin * sin));
    let origin = middle + a.normal * shares[0] + b.normal * shares[1];
    let gap = config.max_support_gap_m;
    let [Some(of_a), Some(of_b)] = [i, j].map(|k| beside(&planes[k], &origin, &along, gap)) else {
        return;
    };
    let kind = match of_a.inward.dot(&b.normal) < 0.0 {
        true => EdgeKind::Convex,
        false => EdgeKind::Concave,
    };
    let runs = of_a.runs.both(&of_b.runs);
    for [from, to] in runs.intervals(config.min_length_m, config.max_gap_m) {
        let [from, to] = [from, to].map(|t| origin + along * t);
        let x = (0.5 * (from + to)).into();
        let sigma = planes[i].sigma_at(x) * cos.abs();
        edges.push(Edge {
            kind,
            from: from.into(),
            to: to.into(),
            sigma_m: planes[j].sigma_at(x).hypot(sigma) / sin,
            planes: (i as u32, Some(j as u32)),
            step: None,
        });
    }
}

/// Observed cells of a plane within a gap of a line on it.
fn beside(plane: &Plane, origin: &Vector3<f64>, along: &Vector3<f64>, gap: f64) -> Option<Beside> {
    let across = plane.frame.normal.cross(along);
    let (mut runs, mut balance) = (Runs::default(), 0i64);
    for (index, _) in plane.observed.iter().enumerate().filter(|(_, is)| **is) {
        let d = plane.frame.position(plane.support.center(index)) - origin;
        let side = across.dot(&d);
        if side.abs() <= gap {
            runs.mark(along.dot(&d));
        }
        if side.abs() <= 2.5 * gap {
            balance += if side > 0.0 { 1 } else { -1 };
        }
    }
    (balance != 0).then(|| Beside {
        runs,
        inward: if balance > 0 { across } else { -across },
    })
}

/// Box around the observed cells of a plane, with a margin.
pub(super) fn bounds(plane: &Plane, margin: f64) -> [Vector3<f64>; 2] {
    let (mut low, mut high) = (
        Vector3::repeat(f64::INFINITY),
        Vector3::repeat(f64::NEG_INFINITY),
    );
    let corners = plane.polygons.iter().flat_map(|polygon| &polygon.outline);
    for corner in corners {
        let x = plane.frame.position(*corner);
        (low, high) = (low.inf(&x), high.sup(&x));
    }
    [low.add_scalar(-margin), high.add_scalar(margin)]
}
