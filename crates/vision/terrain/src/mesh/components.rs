//! Connected parts of a mesh.

use super::triangles::Mesh;

/// Sets of connected vertices (union-find with path halving).
struct Sets(Vec<u32>);

impl Sets {
    fn root(&mut self, of: u32) -> u32 {
        let mut at = of;
        while self.0[at as usize] != at {
            let above = self.0[self.0[at as usize] as usize];
            self.0[at as usize] = above;
            at = above;
        }
        at
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        // The lower number is the root, so the result does not depend on the order.
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// Triangles by the connected part that they belong to; parts in the order of their first triangle.
#[cfg(feature = "obstacles")]
pub(crate) fn connected(triangles: &[[u32; 3]]) -> Vec<Vec<[u32; 3]>> {
    let mut numbers: Vec<u32> = triangles.iter().flatten().copied().collect();
    numbers.sort_unstable();
    numbers.dedup();
    let number = |vertex: u32| numbers.binary_search(&vertex).unwrap_or(0) as u32;
    let mut sets = Sets((0..numbers.len() as u32).collect());
    for [a, b, c] in triangles.iter().map(|own| own.map(number)) {
        sets.join(a, b);
        sets.join(b, c);
    }
    let mut part_of_root = vec![usize::MAX; numbers.len()];
    let mut parts: Vec<Vec<[u32; 3]>> = Vec::new();
    for triangle in triangles {
        let part = &mut part_of_root[sets.root(number(triangle[0])) as usize];
        if *part == usize::MAX {
            *part = parts.len();
            parts.push(Vec::new());
        }
        parts[*part].push(*triangle);
    }
    parts
}

/// Removes connected parts of less than an area, and vertices of no triangle.
pub(super) fn remove_small(mesh: &mut Mesh, min_m2: f64) {
    let count = mesh.positions.len();
    let mut sets = Sets((0..count as u32).collect());
    for [a, b, c] in &mesh.triangles {
        sets.join(*a, *b);
        sets.join(*b, *c);
    }
    let mut areas = vec![0.0; count];
    for triangle in &mesh.triangles {
        areas[sets.root(triangle[0]) as usize] += mesh.area_m2(*triangle);
    }
    let mut keep_vertex = vec![false; count];
    let mut keep_triangle = Vec::with_capacity(mesh.triangles.len());
    for triangle in &mesh.triangles {
        let keep = areas[sets.root(triangle[0]) as usize] >= min_m2;
        keep_triangle.push(keep);
        for i in triangle {
            keep_vertex[*i as usize] |= keep;
        }
    }
    mesh.retain(&keep_vertex, &keep_triangle);
}
