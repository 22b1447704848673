//! Ray casting: for baking light, for the height of the ground, and as reference implementation of
//! the rasterizer.

use nalgebra::Vector3;

/// Triangles per leaf.
const LEAF: usize = 4;

/// Bounding volume hierarchy over triangles.
#[derive(Clone, Debug)]
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    /// Corners, in the order of the leaves, and each triangle's number as given.
    triangles: Vec<([Vector3<f64>; 3], u32)>,
}

#[derive(Clone, Debug)]
struct Node {
    low: Vector3<f64>,
    high: Vector3<f64>,
    /// A leaf's first triangle, an inner node's second child (the first one follows it).
    start: u32,
    /// 0 for an inner node.
    count: u32,
}

/// Intersection of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in lengths of the direction.
    pub distance: f64,
    /// Number of the triangle.
    pub triangle: u32,
}

impl Bvh {
    /// Builds the tree; triangles are numbered from 0.
    pub(crate) fn new(corners: impl Iterator<Item = [Vector3<f64>; 3]>) -> Self {
        let mut triangles: Vec<_> = corners.zip(0..).collect();
        let mut nodes = Vec::with_capacity(triangles.len());
        if !triangles.is_empty() {
            let count = triangles.len();
            split(&mut nodes, &mut triangles, 0, count);
        }
        Self { nodes, triangles }
    }

    /// The nearest hit between `from` and `to` lengths of `direction`. Both sides of a triangle
    /// count.
    pub(crate) fn hit(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        from: f64,
        to: f64,
    ) -> Option<Hit> {
        self.nearest(origin, direction, from, to, false)
    }

    /// Whether any triangle is between the origin and `to` lengths.
    pub(crate) fn is_hidden(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        to: f64,
    ) -> bool {
        self.nearest(origin, direction, 1e-3, to, true).is_some()
    }

    fn nearest(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        from: f64,
        to: f64,
        any: bool,
    ) -> Option<Hit> {
        let inverse = direction.map(|d| 1.0 / d);
        let mut best: Option<Hit> = None;
        let mut stack = [0_u32; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let index = stack[depth];
            let node = &self.nodes[index as usize];
            let limit = best.map_or(to, |hit| hit.distance);
            if !node.is_crossed(origin, &inverse, from, limit) {
                continue;
            }
            if node.count == 0 {
                // Visiting the nearer child first does not pay here: the boxes are small and the
                // tree is shallow.
                stack[depth] = node.start;
                stack[depth + 1] = index + 1;
                depth += 2;
                continue;
            }
            let range = node.start as usize..(node.start + node.count) as usize;
            for (corners, number) in &self.triangles[range] {
                if let Some(distance) = crossing(corners, origin, direction)
                    && distance > from
                    && distance < best.map_or(to, |hit| hit.distance)
                {
                    best = Some(Hit {
                        distance,
                        triangle: *number,
                    });
                    if any {
                        return best;
                    }
                }
            }
        }
        best
    }
}

impl Node {
    fn is_crossed(
        &self,
        origin: &Vector3<f64>,
        inverse: &Vector3<f64>,
        from: f64,
        to: f64,
    ) -> bool {
        let (mut near, mut far) = (from, to);
        for axis in 0..3 {
            let a = (self.low[axis] - origin[axis]) * inverse[axis];
            let b = (self.high[axis] - origin[axis]) * inverse[axis];
            // A ray that runs in the plane of a face gives NaN, and is between the two faces.
            if a.is_nan() || b.is_nan() {
                continue;
            }
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        near <= far
    }
}

/// Möller and Trumbore 1997.
fn crossing(
    [a, b, c]: &[Vector3<f64>; 3],
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
) -> Option<f64> {
    let (ab, ac) = (b - a, c - a);
    let p = direction.cross(&ac);
    let determinant = ab.dot(&p);
    if determinant.abs() < 1e-14 {
        return None;
    }
    let arm = origin - a;
    let u = arm.dot(&p) / determinant;
    let q = arm.cross(&ab);
    let v = direction.dot(&q) / determinant;
    // Slight overlap, so that no ray slips through a shared edge.
    let slack = -1e-9;
    (u >= slack && v >= slack && u + v <= 1.0 - slack).then(|| ac.dot(&q) / determinant)
}

fn split(
    nodes: &mut Vec<Node>,
    triangles: &mut [([Vector3<f64>; 3], u32)],
    first: usize,
    end: usize,
) {
    let part = &mut triangles[first..end];
    let corners = part.iter().flat_map(|(corners, _)| corners);
    let (low, high) = corners.fold(
        (
            Vector3::repeat(f64::INFINITY),
            Vector3::repeat(f64::NEG_INFINITY),
        ),
        |(low, high): (Vector3<f64>, Vector3<f64>), c| (low.inf(c), high.sup(c)),
    );
    let index = nodes.len();
    nodes.push(Node {
        low,
        high,
        start: first as u32,
        count: part.len() as u32,
    });
    if part.len() <= LEAF {
        return;
    }
    let middle = cut(part);
    split(nodes, triangles, first, first + middle);
    nodes[index].start = nodes.len() as u32;
    nodes[index].count = 0;
    split(nodes, triangles, first + middle, end);
}

/// Bounding box of triangles.
#[derive(Clone, Copy)]
struct Bounds {
    low: Vector3<f64>,
    high: Vector3<f64>,
    count: usize,
}

impl Bounds {
    fn nothing() -> Self {
        let far = Vector3::repeat(f64::INFINITY);
        Self {
            low: far,
            high: -far,
            count: 0,
        }
    }

    fn with(&self, other: &Self) -> Self {
        Self {
            low: self.low.inf(&other.low),
            high: self.high.sup(&other.high),
            count: self.count + other.count,
        }
    }

    /// Surface area heuristic, proportional to the expected ray tests.
    fn cost(&self) -> f64 {
        let size = self.high - self.low;
        match self.count {
            0 => 0.0,
            n => n as f64 * (size.x * size.y + size.y * size.z + size.z * size.x),
        }
    }
}

/// Partitions triangles into two groups with a low expected ray cost, and returns the size of the
/// first: minimum cost over planes between evenly spaced bins (Wald 2007).
fn cut(part: &mut [([Vector3<f64>; 3], u32)]) -> usize {
    const BINS: usize = 12;
    let center = |t: &([Vector3<f64>; 3], u32)| (t.0[0] + t.0[1] + t.0[2]) / 3.0;
    let mut centers = Bounds::nothing();
    for t in part.iter() {
        let at = center(t);
        centers = centers.with(&Bounds {
            low: at,
            high: at,
            count: 1,
        });
    }
    let axis = (centers.high - centers.low).imax();
    let from = centers.low[axis];
    let step = (centers.high[axis] - from) / BINS as f64;
    if step <= 0.0 {
        return part.len() / 2;
    }
    let bin =
        |t: &([Vector3<f64>; 3], u32)| (((center(t)[axis] - from) / step) as usize).min(BINS - 1);
    let mut bins = [Bounds::nothing(); BINS];
    for t in part.iter() {
        let [a, b, c] = &t.0;
        let own = Bounds {
            low: a.inf(b).inf(c),
            high: a.sup(b).sup(c),
            count: 1,
        };
        bins[bin(t)] = bins[bin(t)].with(&own);
    }
    let mut above = [0.0; BINS];
    let mut sum = Bounds::nothing();
    for k in (1..BINS).rev() {
        sum = sum.with(&bins[k]);
        above[k] = sum.cost();
    }
    // The first and the last bin hold a triangle each, so no group is empty.
    let (mut best, mut least) = (1, f64::INFINITY);
    let mut sum = Bounds::nothing();
    for k in 1..BINS {
        sum = sum.with(&bins[k - 1]);
        let cost = sum.cost() + above[k];
        if cost < least {
            (best, least) = (k, cost);
        }
    }
    // Stable, so that the same triangles give the same tree.
    part.sort_by_key(|t| bin(t) >= best);
    part.partition_point(|t| bin(t) < best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random;

    /// Agreement with the reference implementation: every triangle.
    #[test]
    fn bvh_agrees_with_testing_every_triangle() {
        let draw = |i: u64| random::uniform(5, 0, i) * 2.0 - 1.0;
        let point = |i: u64, scale: f64| {
            Vector3::new(draw(3 * i), draw(3 * i + 1), draw(3 * i + 2)) * scale
        };
        let triangles: Vec<[Vector3<f64>; 3]> = (0..500)
            .map(|i| {
                let at = point(4 * i, 5.0);
                [1, 2, 3].map(|k| at + point(4 * i + k, 0.6))
            })
            .collect();
        let bvh = Bvh::new(triangles.iter().copied());
        let mut hits = 0;
        for i in 0..500 {
            let (origin, direction) = (point(9000 + i, 6.0), point(20_000 + i, 1.0));
            let expected = triangles
                .iter()
                .zip(0..)
                .filter_map(|(t, n)| Some((crossing(t, &origin, &direction)?, n)))
                .filter(|(distance, _)| *distance > 1e-6)
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let found = bvh.hit(&origin, &direction, 1e-6, f64::INFINITY);
            assert_eq!(found.map(|h| (h.distance, h.triangle)), expected);
            assert_eq!(
                bvh.is_hidden(&origin, &direction, 1e9),
                expected.is_some_and(|(distance, _)| distance > 1e-3)
            );
            hits += usize::from(found.is_some());
        }
        assert!((20..480).contains(&hits), "{hits}");
    }

    /// Rays along the edges of boxes and triangles, as the grid of a level ground has them.
    #[test]
    fn ray_in_the_plane_of_a_face_hits() {
        let triangles = (0..64).flat_map(|i| {
            let at =
                |dx: i32, dy: i32| Vector3::new(f64::from(i % 8 + dx), f64::from(i / 8 + dy), 0.0);
            [
                [at(0, 0), at(1, 0), at(1, 1)],
                [at(0, 0), at(1, 1), at(0, 1)],
            ]
        });
        let bvh = Bvh::new(triangles);
        for (x, y) in [(4.0, 2.3), (2.3, 4.0), (4.0, 4.0), (0.0, 8.0), (3.5, 3.5)] {
            let hit = bvh.hit(&Vector3::new(x, y, 1.0), &-Vector3::z(), 0.0, 10.0);
            assert_eq!(hit.map(|h| h.distance), Some(1.0), "{x} {y}");
        }
    }
}
