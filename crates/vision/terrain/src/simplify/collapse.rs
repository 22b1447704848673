//! Collapse of edges in the order of their error.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use nalgebra::Vector3;

use super::quadric::Quadric;
use crate::mesh::Mesh;

/// Minimum cosine between the normals of a triangle before and after a collapse.
const MIN_TURN_COS: f64 = 0.8;
/// Minimum ratio of the area of a triangle to its longest edge squared.
const MIN_SHAPE: f64 = 0.02;

/// An edge that may collapse. Ordered by error, then by its vertices.
type Candidate = Reverse<(u64, u32, u32, u32)>;

/// The mesh with edges collapsed up to a root mean square distance from the planes of its
/// triangles, m. Borders collapse along themselves only.
pub fn collapse(mesh: &Mesh, tolerance_m: f64) -> Mesh {
    let mut work = Work::new(mesh);
    let mut heap: BinaryHeap<Candidate> = BinaryHeap::new();
    let mut edges: Vec<(u32, u32)> = mesh
        .triangles
        .iter()
        .flat_map(|[a, b, c]| [(a, b), (b, c), (c, a)].map(|(a, b)| (*a.min(b), *a.max(b))))
        .collect();
    edges.sort_unstable();
    edges.dedup();
    for (a, b) in edges {
        heap.extend(work.candidate(a, b, tolerance_m));
    }
    while let Some(Reverse((_, a, b, stamp))) = heap.pop() {
        if work.stamp(a, b) != Some(stamp) || !work.collapse(a, b) {
            continue;
        }
        for other in work.neighbors(a) {
            heap.extend(work.candidate(a.min(other), a.max(other), tolerance_m));
        }
    }
    work.finish(mesh)
}

struct Work {
    positions: Vec<Vector3<f64>>,
    quadrics: Vec<Quadric>,
    /// Quadrics of the borders: apart, so that the area around does not hide their error.
    borders: Vec<Quadric>,
    is_border: Vec<bool>,
    /// Triangles of each vertex; empty for removed vertices.
    around: Vec<Vec<u32>>,
    triangles: Vec<[u32; 3]>,
    is_gone: Vec<bool>,
    /// Number of changes of each vertex.
    changes: Vec<u32>,
}

impl Work {
    fn new(mesh: &Mesh) -> Self {
        let count = mesh.positions.len();
        let positions: Vec<Vector3<f64>> = mesh
            .positions
            .iter()
            .map(|p| Vector3::from(p.map(f64::from)))
            .collect();
        let mut work = Self {
            quadrics: vec![Quadric::default(); count],
            borders: vec![Quadric::default(); count],
            is_border: vec![false; count],
            around: vec![Vec::new(); count],
            triangles: mesh.triangles.clone(),
            is_gone: vec![false; mesh.triangles.len()],
            changes: vec![0; count],
            positions,
        };
        let mut sides: BTreeMap<(u32, u32), i32> = BTreeMap::new();
        for (number, triangle) in mesh.triangles.iter().enumerate() {
            let doubled = Vector3::from(mesh.doubled_normal(*triangle));
            let area = doubled.norm();
            for i in triangle {
                work.around[*i as usize].push(number as u32);
                if area > 0.0 {
                    let normal = doubled / area;
                    let offset = normal.dot(&work.positions[triangle[0] as usize]);
                    let quadric = Quadric::of_plane(&normal, offset, area);
                    work.quadrics[*i as usize] = work.quadrics[*i as usize].sum(&quadric);
                }
            }
            let [a, b, c] = *triangle;
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *sides.entry((from.min(to), from.max(to))).or_default() += 1;
            }
        }
        for triangle in &mesh.triangles {
            let [a, b, c] = *triangle;
            for (from, to) in [(a, b), (b, c), (c, a)] {
                if sides[&(from.min(to), from.max(to))] != 2 {
                    work.add_border(from, to, &Vector3::from(mesh.doubled_normal(*triangle)));
                }
            }
        }
        work
    }

    /// A border is a wall across its triangle: moving it costs as moving the surface does.
    fn add_border(&mut self, from: u32, to: u32, normal: &Vector3<f64>) {
        let along = self.positions[to as usize] - self.positions[from as usize];
        let weight = along.norm_squared();
        if let Some(across) = along.cross(normal).try_normalize(1e-15) {
            let offset = across.dot(&self.positions[from as usize]);
            let quadric = Quadric::of_plane(&across, offset, weight);
            for i in [from, to] {
                self.borders[i as usize] = self.borders[i as usize].sum(&quadric);
            }
        }
        self.is_border[from as usize] = true;
        self.is_border[to as usize] = true;
    }

    /// Number of triangles at an edge.
    fn sides(&self, a: u32, b: u32) -> usize {
        let of_a = self.around[a as usize].iter();
        of_a.filter(|number| self.triangles[**number as usize].contains(&b))
            .count()
    }

    /// Sum of the changes of two vertices, `None` if one was removed.
    fn stamp(&self, a: u32, b: u32) -> Option<u32> {
        let is_there = |i: u32| !self.around[i as usize].is_empty();
        (is_there(a) && is_there(b)).then(|| self.changes[a as usize] + self.changes[b as usize])
    }

    fn neighbors(&self, of: u32) -> Vec<u32> {
        let triangles = self.around[of as usize].iter();
        let mut others: Vec<u32> = triangles
            .flat_map(|number| self.triangles[*number as usize])
            .filter(|other| *other != of)
            .collect();
        others.sort_unstable();
        others.dedup();
        others
    }

    /// Position of the vertex of a collapsed edge, and its mean squared error.
    fn target(&self, a: u32, b: u32) -> Option<(Vector3<f64>, f64)> {
        let quadric = self.quadrics[a as usize].sum(&self.quadrics[b as usize]);
        let border = self.borders[a as usize].sum(&self.borders[b as usize]);
        let [at_a, at_b] = [a, b].map(|i| self.positions[i as usize]);
        let places: Vec<Vector3<f64>> =
            match (self.is_border[a as usize], self.is_border[b as usize]) {
                (true, true) if self.sides(a, b) != 1 => return None,
                (true, true) => vec![at_a, at_b],
                (true, false) => vec![at_a],
                (false, true) => vec![at_b],
                (false, false) => {
                    let length = (at_a - at_b).norm();
                    let best = quadric
                        .minimum()
                        .filter(|x| (x - at_a).norm() <= length && (x - at_b).norm() <= length);
                    [Some(0.5 * (at_a + at_b)), best, Some(at_a), Some(at_b)]
                        .into_iter()
                        .flatten()
                        .collect()
                }
            };
        let of = |x: &Vector3<f64>| {
            let [surface, border] = [&quadric, &border].map(|q| q.error(x) / q.weight.max(1e-12));
            surface.max(border)
        };
        places
            .into_iter()
            .map(|x| (x, of(&x)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    fn candidate(&self, a: u32, b: u32, tolerance_m: f64) -> Option<Candidate> {
        let stamp = self.stamp(a, b)?;
        let (_, error) = self.target(a, b)?;
        // Bits of positive numbers have their order. Flat surroundings: the shortest edge first.
        let length = (self.positions[a as usize] - self.positions[b as usize]).norm_squared();
        let order = error + 1e-9 * length;
        (error <= tolerance_m * tolerance_m).then(|| Reverse((order.to_bits(), a, b, stamp)))
    }

    /// Collapses an edge into its first vertex, unless that would fold the surface.
    fn collapse(&mut self, a: u32, b: u32) -> bool {
        let Some((target, _)) = self.target(a, b) else {
            return false;
        };
        let (of_a, of_b) = (self.neighbors(a), self.neighbors(b));
        // A surface without folds shares the vertices opposite to the edge only.
        let shared = || of_a.iter().filter(|i| of_b.binary_search(i).is_ok());
        if shared().count() != self.sides(a, b) || shared().any(|c| !self.remains(*c, a, b)) {
            return false;
        }
        for i in [a, b] {
            for number in &self.around[i as usize] {
                let triangle = self.triangles[*number as usize];
                if triangle.contains(&a) && triangle.contains(&b) {
                    continue;
                }
                if !self.keeps_shape(triangle, i, &target) {
                    return false;
                }
            }
        }
        let of_b = std::mem::take(&mut self.around[b as usize]);
        for number in of_b {
            let triangle = &mut self.triangles[number as usize];
            if triangle.contains(&a) {
                self.is_gone[number as usize] = true;
                for i in *triangle {
                    self.around[i as usize].retain(|other| *other != number);
                }
            } else {
                *triangle = triangle.map(|i| if i == b { a } else { i });
                self.around[a as usize].push(number);
            }
        }
        self.around[a as usize].sort_unstable();
        self.positions[a as usize] = target;
        self.quadrics[a as usize] = self.quadrics[a as usize].sum(&self.quadrics[b as usize]);
        self.borders[a as usize] = self.borders[a as usize].sum(&self.borders[b as usize]);
        self.is_border[a as usize] |= self.is_border[b as usize];
        self.changes[a as usize] += self.changes[b as usize] + 1;
        true
    }

    /// Whether a vertex opposite to an edge has a triangle with one end of it only.
    fn remains(&self, opposite: u32, a: u32, b: u32) -> bool {
        self.around[opposite as usize].iter().any(|number| {
            let triangle = self.triangles[*number as usize];
            triangle.contains(&a) != triangle.contains(&b)
        })
    }

    fn keeps_shape(&self, triangle: [u32; 3], moved: u32, target: &Vector3<f64>) -> bool {
        let before = triangle.map(|i| self.positions[i as usize]);
        let after = triangle.map(|i| {
            if i == moved {
                *target
            } else {
                self.positions[i as usize]
            }
        });
        let doubled = |[a, b, c]: [Vector3<f64>; 3]| (b - a).cross(&(c - a));
        let shape = |corners: [Vector3<f64>; 3]| {
            let [a, b, c] = corners;
            let sides = [b - a, c - b, a - c].map(|side| side.norm_squared());
            let longest = sides.into_iter().fold(0.0, f64::max);
            0.5 * doubled(corners).norm() / longest.max(1e-18)
        };
        let [n, m] = [doubled(before), doubled(after)];
        // Vertices that were snapped to an edge have triangles without area beside them.
        shape(after) >= MIN_SHAPE.min(shape(before))
            && n.dot(&m) >= MIN_TURN_COS * n.norm() * m.norm()
    }

    fn finish(self, mesh: &Mesh) -> Mesh {
        let mut simplified = mesh.clone();
        for (position, moved) in simplified.positions.iter_mut().zip(&self.positions) {
            *position = [moved.x, moved.y, moved.z].map(|v| v as f32);
        }
        simplified.triangles = self.triangles;
        let vertices: Vec<bool> = self
            .around
            .iter()
            .map(|around| !around.is_empty())
            .collect();
        let triangles: Vec<bool> = self.is_gone.iter().map(|is_gone| !is_gone).collect();
        simplified.retain(&vertices, &triangles);
        simplified
    }
}
