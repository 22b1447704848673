//! Ground truth of the terrain that people walk on: planes, and the edges of steps.
//!
//! A plane is a connected part of the walkable surface that is flat and large enough for a foot. A
//! step edge is the upper edge of a sudden change of height: kerbs, stairs, and the ends of what
//! one steps onto. Both follow from the triangles that are rendered, not from how a scene was
//! designed, and only near the route.

use std::collections::HashMap;

use nalgebra::Vector3;

use super::Scene;
use crate::walker::path::Path;

/// Triangles of one plane deviate from it by less than this angle, rad, and distance, m.
const FLAT_RAD: f64 = 0.01;
const FLAT_M: f64 = 0.003;
/// Minimum area of a plane, m²: half the tread of a stair.
const LEAST_AREA_M2: f64 = 0.25;
/// Distance from the route up to which there is terrain, m.
const NEAR_M: f64 = 4.0;
/// Minimum vertical component of the normals of what one stands on.
const LEAST_UP: f64 = 0.5;
/// Heights of steps, m. Lower ones are roughness, higher ones nobody steps over.
const STEP_M: std::ops::Range<f64> = 0.03..0.6;
/// Distance of the ground beside an edge from it, m.
const BESIDE_M: f64 = 0.004;
/// Distance between samples of an edge, m.
const SAMPLE_M: f64 = 0.02;
/// Pieces are one edge if their ends, and their heights, differ by less, m: leaves may lie on it.
const GAP_M: f64 = 0.1;
const JOINT_M: f64 = 0.012;
/// Minimum cosine of the angle between pieces of one edge.
const LEAST_COSINE: f64 = 0.9995;
/// Minimum length of a step edge, m.
const LEAST_EDGE_M: f64 = 0.05;

/// A flat part of the terrain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Middle of its area, in the world, m.
    pub middle: Vector3<f64>,
    /// Upward unit normal.
    pub normal: Vector3<f64>,
    /// Area, m².
    pub area_m2: f64,
}

/// Planes of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Planes {
    /// The largest one first.
    pub planes: Vec<Plane>,
    /// For each triangle of [`Scene::fixed`] the index of its plane.
    pub of_triangle: Vec<Option<u32>>,
}

/// The upper edge of a step; the lower side is on its right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepEdge {
    /// Ends in the world, m.
    pub ends: [Vector3<f64>; 2],
    /// Height of the ground below each end, m.
    pub lower_m: [f64; 2],
}

/// An edge by the bits of its ends: triangles that share an edge have equal corners.
type EdgeKey = [[u64; 3]; 2];

fn edge_key(ends: &[Vector3<f64>; 2]) -> EdgeKey {
    let mut key = ends.map(|p| [p.x, p.y, p.z].map(f64::to_bits));
    key.sort_unstable();
    key
}

impl Scene {
    /// Corners of a walkable triangle.
    fn corners(&self, triangle: u32) -> [Vector3<f64>; 3] {
        self.fixed.triangles[triangle as usize]
            .corners
            .map(|c| c.position)
    }

    /// Unit normal of a triangle.
    fn normal(&self, triangle: u32) -> Vector3<f64> {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(&(c - a)).normalize()
    }

    /// Walkable triangles near the route that face upwards.
    fn floor(&self) -> Vec<u32> {
        let path = Path::closed(&self.route.points);
        let count = (path.length_m() / (0.5 * NEAR_M)).ceil() as usize;
        let stations: Vec<[f64; 2]> = (0..count)
            .map(|k| path.at(path.length_m() * k as f64 / count as f64).0)
            .collect();
        let is_near = |triangle: u32| {
            let [a, b, c] = self.corners(triangle);
            let p = (a + b + c) / 3.0;
            (stations.iter()).any(|[x, y]| libm::hypot(p.x - x, p.y - y) < NEAR_M)
        };
        let triangles = self.walkable_triangles.iter().copied();
        triangles
            .filter(|&t| self.normal(t).z > LEAST_UP && is_near(t))
            .collect()
    }

    /// Edges of a triangle, counter-clockwise.
    fn edges_of(&self, triangle: u32) -> [[Vector3<f64>; 2]; 3] {
        let [a, b, c] = self.corners(triangle);
        [[a, b], [b, c], [c, a]]
    }

    /// The triangles at every edge of the floor.
    fn edges(&self, floor: &[u32]) -> HashMap<EdgeKey, Vec<u32>> {
        let mut edges: HashMap<EdgeKey, Vec<u32>> = HashMap::new();
        for &triangle in floor {
            for ends in self.edges_of(triangle) {
                edges.entry(edge_key(&ends)).or_default().push(triangle);
            }
        }
        edges
    }

    /// Planes of the terrain.
    pub fn planes(&self) -> Planes {
        let floor = self.floor();
        let edges = self.edges(&floor);
        let area = |triangle: u32| {
            let [a, b, c] = self.corners(triangle);
            0.5 * (b - a).cross(&(c - a)).norm()
        };
        let mut region_of: Vec<Option<u32>> = vec![None; self.fixed.triangles.len()];
        let mut regions: Vec<Vec<u32>> = Vec::new();
        for &seed in &floor {
            if region_of[seed as usize].is_some() {
                continue;
            }
            let up = self.normal(seed);
            let number = regions.len() as u32;
            let origin = self.corners(seed)[0];
            let is_flat = |triangle: u32| {
                let distance = |p: Vector3<f64>| (p - origin).dot(&up).abs();
                self.normal(triangle).cross(&up).norm() < FLAT_RAD
                    && self
                        .corners(triangle)
                        .map(distance)
                        .iter()
                        .all(|d| *d < FLAT_M)
            };
            let mut region = vec![seed];
            region_of[seed as usize] = Some(number);
            let mut next = 0;
            while let Some(&triangle) = region.get(next) {
                next += 1;
                for ends in self.edges_of(triangle) {
                    for &other in &edges[&edge_key(&ends)] {
                        if region_of[other as usize].is_none() && is_flat(other) {
                            region_of[other as usize] = Some(number);
                            region.push(other);
                        }
                    }
                }
            }
            regions.push(region);
        }
        let mut found: Vec<(Plane, usize)> = Vec::new();
        for (number, region) in regions.iter().enumerate() {
            let area_m2: f64 = region.iter().map(|&t| area(t)).sum();
            if area_m2 < LEAST_AREA_M2 {
                continue;
            }
            let moment = |t: u32| {
                let [a, b, c] = self.corners(t);
                (a + b + c) * (area(t) / 3.0)
            };
            let middle = region.iter().map(|&t| moment(t)).sum::<Vector3<f64>>() / area_m2;
            let sum: Vector3<f64> = region.iter().map(|&t| self.normal(t) * area(t)).sum();
            let plane = Plane {
                middle,
                normal: sum.normalize(),
                area_m2,
            };
            found.push((plane, number));
        }
        found.sort_by(|(a, i), (b, j)| b.area_m2.total_cmp(&a.area_m2).then(i.cmp(j)));
        let mut rank: Vec<Option<u32>> = vec![None; regions.len()];
        for (k, (_, number)) in found.iter().enumerate() {
            rank[*number] = Some(k as u32);
        }
        Planes {
            planes: found.into_iter().map(|(plane, _)| plane).collect(),
            of_triangle: region_of
                .into_iter()
                .map(|region| region.and_then(|number| rank[number as usize]))
                .collect(),
        }
    }

    /// Step edges of the terrain.
    pub fn step_edges(&self) -> Vec<StepEdge> {
        let floor = self.floor();
        let edges = self.edges(&floor);
        let mut is_floor = vec![false; self.fixed.triangles.len()];
        floor.iter().for_each(|&t| is_floor[t as usize] = true);
        let mut found = Vec::new();
        for &triangle in &floor {
            for ends in self.edges_of(triangle) {
                if edges[&edge_key(&ends)].len() == 1 {
                    self.sample(&ends, &is_floor, &mut found);
                }
            }
        }
        joined(found)
    }

    /// Adds the parts of an edge of the floor at which the ground falls to its right.
    fn sample(&self, [from, to]: &[Vector3<f64>; 2], is_floor: &[bool], found: &mut Vec<StepEdge>) {
        let along = to - from;
        let length = along.xy().norm();
        if length < 1e-6 {
            return;
        }
        let outward = Vector3::new(along.y, -along.x, 0.0) / length;
        let count = (length / SAMPLE_M).ceil().max(1.0) as usize;
        let at = |t: f64| from + along * t;
        // Height below the edge in the middle of each piece of it; `None` where there is no step.
        let lower = |i: usize| {
            let p = at((i as f64 + 0.5) / count as f64);
            // Floors end inside walls, where the ground that carries the scene is not near.
            let height = |beside: f64| {
                let q = p + outward * beside;
                let ground = self.ground(q.x, q.y, p.z + STEP_M.end)?;
                is_floor[ground.triangle as usize].then_some(ground.height)
            };
            let (inside, outside) = (height(-BESIDE_M)?, height(BESIDE_M)?);
            let is_top = (inside - p.z).abs() < 0.5 * STEP_M.start;
            (is_top && STEP_M.contains(&(p.z - outside))).then_some(outside)
        };
        let mut begin: Option<(usize, f64, f64)> = None;
        for i in 0..=count {
            let here = if i < count { lower(i) } else { None };
            let continues = |last: f64, z: f64| (last - z).abs() < JOINT_M;
            begin = match (begin, here) {
                (Some((first, at_first, last)), Some(z)) if continues(last, z) => {
                    Some((first, at_first, z))
                }
                (open, here) => {
                    if let Some((first, at_first, last)) = open {
                        let ends = [first, i].map(|k| at(k as f64 / count as f64));
                        found.push(StepEdge {
                            ends,
                            lower_m: [at_first, last],
                        });
                    }
                    here.map(|z| (i, z, z))
                }
            };
        }
    }
}

/// Joins pieces that continue each other in a straight line.
fn joined(pieces: Vec<StepEdge>) -> Vec<StepEdge> {
    let cell = |p: &Vector3<f64>| [p.x, p.y, p.z].map(|v| (v / GAP_M).floor() as i64);
    let mut begins: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
    for (i, piece) in pieces.iter().enumerate() {
        begins.entry(cell(&piece.ends[0])).or_default().push(i);
    }
    let successor = |piece: &StepEdge| {
        let [x, y, z] = cell(&piece.ends[1]);
        let near = (0..27).map(|n| [x + n % 3 - 1, y + n / 3 % 3 - 1, z + n / 9 - 1]);
        let mut near = near.filter_map(|cell| begins.get(&cell)).flatten().copied();
        near.find(|&n| piece.is_continued_by(&pieces[n]))
    };
    let after: Vec<Option<usize>> = pieces.iter().map(successor).collect();
    let mut is_first = vec![true; pieces.len()];
    after.iter().flatten().for_each(|&n| is_first[n] = false);
    // A straight line has a first piece.
    let mut edges = Vec::new();
    for first in (0..pieces.len()).filter(|&i| is_first[i]) {
        let mut edge = pieces[first];
        let mut last = first;
        while let Some(next) = after[last] {
            last = next;
            edge.ends[1] = pieces[next].ends[1];
            edge.lower_m[1] = pieces[next].lower_m[1];
        }
        if (edge.ends[1] - edge.ends[0]).norm() > LEAST_EDGE_M {
            edges.push(edge);
        }
    }
    edges
}

impl StepEdge {
    /// Whether another piece begins where this one ends, in the same direction and height.
    fn is_continued_by(&self, next: &Self) -> bool {
        let [from, to] = self.ends;
        let along = (to - from).normalize();
        let gap = next.ends[0] - to;
        let ahead = gap.dot(&along);
        (-1e-9..GAP_M).contains(&ahead)
            && (gap - along * ahead).norm() < 1e-3
            && (next.lower_m[0] - self.lower_m[1]).abs() < JOINT_M
            && (next.ends[1] - next.ends[0]).normalize().dot(&along) > LEAST_COSINE
    }

    /// Heights at both ends, m.
    pub fn heights_m(&self) -> [f64; 2] {
        [0, 1].map(|k| self.ends[k].z - self.lower_m[k])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Kind, by_day};

    #[test]
    fn stairs_have_their_treads_and_edges() {
        let scene = by_day(Kind::Stairs, 1);
        let Planes {
            planes,
            of_triangle,
        } = scene.planes();
        let treads = planes.iter().filter(|p| {
            (p.area_m2 - 0.58).abs() < 1e-6
                && (p.middle.z / 0.17 - (p.middle.z / 0.17).round()).abs() < 1e-6
        });
        assert_eq!(treads.clone().count(), 20);
        assert!(treads.clone().all(|p| p.normal.z > 1.0 - 1e-12));
        for (triangle, plane) in of_triangle.iter().enumerate() {
            let Some(plane) = plane else { continue };
            let plane = planes[*plane as usize];
            for corner in scene.corners(triangle as u32) {
                let distance = (corner - plane.middle).dot(&plane.normal);
                assert!(distance.abs() < 2.0 * FLAT_M, "{corner} {plane:?}");
            }
        }

        let edges = scene.step_edges();
        let length = |e: &StepEdge| (e.ends[1] - e.ends[0]).norm();
        let risers = edges.iter().filter(|e| (length(e) - 2.0).abs() < 1e-6);
        assert_eq!(risers.clone().count(), 22);
        for riser in risers {
            for height in riser.heights_m() {
                // The yard is uneven by some millimetres.
                assert!((height - 0.17).abs() < 0.005, "{riser:?}");
            }
        }
    }

    #[test]
    fn floors_end_at_walls_without_edges() {
        for kind in [Kind::Corridor, Kind::Room] {
            assert_eq!(by_day(kind, 1).step_edges(), []);
        }
    }

    #[test]
    fn ground_is_lower_on_the_right_of_an_edge() {
        for kind in [Kind::Pavement, Kind::Stairs, Kind::Trail] {
            let scene = by_day(kind, 1);
            let edges = scene.step_edges();
            assert!(!edges.is_empty(), "{kind:?}");
            for edge in &edges {
                let along = (edge.ends[1] - edge.ends[0]).normalize();
                let right = Vector3::new(along.y, -along.x, 0.0).normalize();
                let middle = 0.5 * (edge.ends[0] + edge.ends[1]);
                let height = |beside: f64| {
                    let p = middle + right * beside;
                    scene.ground(p.x, p.y, p.z + 0.5).expect("ground").height
                };
                let [left, right] = [height(-BESIDE_M), height(BESIDE_M)];
                let stated = 0.5 * (edge.heights_m()[0] + edge.heights_m()[1]);
                assert!(STEP_M.start < left - right + 0.01, "{kind:?} {edge:?}");
                assert!(
                    (left - right - stated).abs() < 2.0 * JOINT_M,
                    "{kind:?} {edge:?}"
                );
            }
        }
    }
}
