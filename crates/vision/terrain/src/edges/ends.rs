//! Straight edges where planes end, from the points where their depths end.

use super::edge::{Edge, EdgeKind};
use super::runs::Runs;
use crate::config::EdgeConfig;
use crate::planes::Plane;

/// Directions of lines that are tried: steps of 2 degrees.
const DIRECTIONS: usize = 90;
/// Lines per plane.
const MAX_LINES: usize = 12;

/// A line on a plane: its points have a product with the normal.
#[derive(Clone, Copy)]
struct Line {
    normal: [f64; 2],
    offset: f64,
}

impl Line {
    fn distance(&self, at: [f64; 2]) -> f64 {
        self.normal[0] * at[0] + self.normal[1] * at[1] - self.offset
    }

    fn along(&self, at: [f64; 2]) -> f64 {
        self.normal[0] * at[1] - self.normal[1] * at[0]
    }

    fn point(&self, along: f64) -> [f64; 2] {
        let n = self.normal;
        [
            n[0] * self.offset - n[1] * along,
            n[1] * self.offset + n[0] * along,
        ]
    }
}

/// Ends of a plane that none of the known edges explains.
pub(super) fn plane_ends(
    number: usize,
    plane: &Plane,
    known: &[Edge],
    config: &EdgeConfig,
) -> Vec<Edge> {
    let of_plane: Vec<&Edge> = known
        .iter()
        .filter(|edge| {
            let (a, b) = edge.planes;
            a as usize == number || b.is_some_and(|b| b as usize == number)
        })
        .collect();
    let mut points: Vec<([f64; 2], f64)> = Vec::new();
    for (at, count) in &plane.ends {
        let x: [f64; 3] = plane.frame.position(*at).into();
        if of_plane
            .iter()
            .all(|edge| edge.distance_m(x) > 2.0 * config.max_line_distance_m)
        {
            points.push((*at, f64::from(*count)));
        }
    }
    let mut edges = Vec::new();
    for _ in 0..MAX_LINES {
        let Some(line) = best_line(&points, config) else {
            break;
        };
        let line = refined(line, &points, config);
        let mut runs = Runs::default();
        let (mut weight, mut square) = (0.0, 0.0);
        points.retain(|(at, count)| {
            let distance = line.distance(*at);
            let is_on_line = distance.abs() <= config.max_line_distance_m;
            if is_on_line {
                runs.mark(line.along(*at));
                weight += count;
                square += count * distance * distance;
            }
            !is_on_line
        });
        for [from, to] in runs.intervals(config.min_end_length_m, config.max_gap_m) {
            if !is_border(plane, &line, [from, to]) {
                continue;
            }
            let [from, to] = [from, to].map(|t| plane.frame.position(line.point(t)));
            // Points of neighboring pixels are not independent: one in ten is.
            let scatter = (square / f64::max(weight, 1.0) / 10.0).sqrt();
            edges.push(Edge {
                kind: EdgeKind::End,
                from: from.into(),
                to: to.into(),
                sigma_m: scatter
                    .hypot(config.end_sigma_m)
                    .hypot(plane.end_pose_sigma_m),
                planes: (number as u32, None),
                step: None,
            });
        }
    }
    edges
}

/// The line with most points, by votes for directions and offsets (Hough transform).
fn best_line(points: &[([f64; 2], f64)], config: &EdgeConfig) -> Option<Line> {
    let min_points = config.min_length_m / super::runs::BIN_M / 2.0;
    if (points.len() as f64) < min_points {
        return None;
    }
    let bin = config.max_line_distance_m;
    let range = points
        .iter()
        .map(|(at, _)| at[0].hypot(at[1]))
        .fold(0.0, f64::max);
    let bins = 2 * (range / bin).ceil() as usize + 3;
    let mut best = (0u32, None);
    let mut votes = vec![0u32; bins];
    for direction in 0..DIRECTIONS {
        let angle = std::f64::consts::PI * direction as f64 / DIRECTIONS as f64;
        let normal = unit(angle);
        votes.fill(0);
        for (at, _) in points {
            let offset = normal[0] * at[0] + normal[1] * at[1];
            votes[(offset / bin + bins as f64 / 2.0) as usize] += 1;
        }
        for (i, pair) in votes.windows(2).enumerate() {
            if pair[0] + pair[1] > best.0 {
                let offset = (i as f64 + 1.0 - bins as f64 / 2.0) * bin;
                best = (pair[0] + pair[1], Some(Line { normal, offset }));
            }
        }
    }
    best.1.filter(|_| f64::from(best.0) >= min_points)
}

/// The line of least squares through the points near it.
fn refined(mut line: Line, points: &[([f64; 2], f64)], config: &EdgeConfig) -> Line {
    for round in 0..4 {
        // The direction of the first line is a degree off.
        let max_distance = if round == 0 { 2.0 } else { 1.0 } * config.max_line_distance_m;
        let near = points
            .iter()
            .filter(|(at, _)| line.distance(*at).abs() <= max_distance);
        let mut sums = [0.0; 5];
        let mut count = 0.0;
        for (at, weight) in near {
            // Cells with many points lie on slow parts of the walk: they count by their root.
            let weight = weight.sqrt();
            let (along, across) = (line.along(*at), line.distance(*at));
            count += weight;
            let of = [
                along,
                across,
                along * along,
                along * across,
                across * across,
            ];
            for (sum, of) in sums.iter_mut().zip(of) {
                *sum += weight * of;
            }
        }
        if count == 0.0 {
            break;
        }
        let [along, across, square, product, _] = sums.map(|sum| sum / count);
        let spread = square - along * along;
        if spread < 1e-6 {
            break;
        }
        let slope = (product - along * across) / spread;
        let at = line.point(along);
        let shifted = [0, 1].map(|k| at[k] + line.normal[k] * across);
        // The direction of the line is (-n1, n0).
        let [n0, n1] = line.normal;
        let normal = [n0 + slope * n1, n1 - slope * n0];
        let norm = normal[0].hypot(normal[1]);
        let normal = normal.map(|n| n / norm);
        line = Line {
            normal,
            offset: normal[0] * shifted[0] + normal[1] * shifted[1],
        };
    }
    line
}

/// Whether the plane was observed on one side of a part of a line, and hardly on the other.
fn is_border(plane: &Plane, line: &Line, [from, to]: [f64; 2]) -> bool {
    let steps = ((to - from) / 0.02) as usize + 1;
    let mut counts = [0, 0];
    for step in 0..steps {
        let at = line.point(from + (step as f64 + 0.5) * (to - from) / steps as f64);
        for (side, count) in [-1.0, 1.0].into_iter().zip(&mut counts) {
            let beside = [0, 1].map(|k| at[k] + side * 0.03 * line.normal[k]);
            let index = plane.support.index(beside);
            *count += usize::from(index.is_some_and(|index| plane.observed[index]));
        }
    }
    let (less, more) = (counts[0].min(counts[1]), counts[0].max(counts[1]));
    2 * more > steps && 4 * less < more
}

/// Cosine and sine of an angle from 0 to pi, by rotations of one step: the same on every machine.
fn unit(angle: f64) -> [f64; 2] {
    // Series around a right angle, where the argument is at most pi / 2.
    let x = angle - std::f64::consts::FRAC_PI_2;
    let square = x * x;
    let (mut sine, mut cosine, mut term) = (0.0, 0.0, 1.0);
    for k in 0..12 {
        cosine += term;
        sine += term * x / f64::from(2 * k + 1);
        term *= -square / f64::from((2 * k + 1) * (2 * k + 2));
    }
    // cos(x + pi / 2) is -sin(x), sin(x + pi / 2) is cos(x).
    [-sine, cosine]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_cosines_and_sines() {
        for i in 0..=20 {
            let angle = std::f64::consts::PI * f64::from(i) / 20.0;
            let [cos, sin] = unit(angle);
            assert!((cos - angle.cos()).abs() < 1e-12 && (sin - angle.sin()).abs() < 1e-12);
        }
    }

    #[test]
    fn lines_pass_through_their_points() {
        let mut points: Vec<([f64; 2], f64)> = (0..200)
            .map(|i| {
                let along = 0.005 * i as f64;
                let noise = 0.003 * counter_random::bell(2, 0, i);
                (
                    [
                        0.3 + 0.8 * along - 0.6 * noise,
                        -0.2 + 0.6 * along + 0.8 * noise,
                    ],
                    1.0,
                )
            })
            .collect();
        points.extend((0..40).map(|i| ([0, 1].map(|k| counter_random::uniform(3, k, i)), 1.0)));
        let config = EdgeConfig::default();
        let line = refined(best_line(&points, &config).unwrap(), &points, &config);
        for along in [0.0, 0.5, 1.0] {
            let distance = line.distance([0.3 + 0.8 * along, -0.2 + 0.6 * along]);
            assert!(distance.abs() < 0.002, "{distance}");
        }
    }
}
