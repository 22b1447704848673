//! Triangles with shared vertices.

/// A triangle mesh, in the world. Triangles are counterclockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Positions of the vertices, m.
    pub positions: Vec<[f32; 3]>,
    /// Outward normals of the vertices, of length 1.
    pub normals: Vec<[f32; 3]>,
    /// Colors, RGB; black where no view had one.
    pub colors: Vec<[u8; 3]>,
    /// One standard deviation of the position along the normal, m.
    pub sigma_m: Vec<f32>,
    /// Views that saw the surface, at most 255.
    pub views: Vec<u8>,
    /// Indices of the vertices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Area of a triangle, m2.
    pub fn area_m2(&self, triangle: [u32; 3]) -> f64 {
        let normal = self.doubled_normal(triangle);
        0.5 * (normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]).sqrt()
    }

    /// Normal of a triangle, of the length of its doubled area.
    pub(crate) fn doubled_normal(&self, triangle: [u32; 3]) -> [f64; 3] {
        let [a, b, c] = triangle.map(|i| self.positions[i as usize].map(f64::from));
        let [u, v] = [b, c].map(|p| [p[0] - a[0], p[1] - a[1], p[2] - a[2]]);
        [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ]
    }

    /// Keeps the vertices and triangles that are marked; triangles must have marked vertices only.
    pub(crate) fn retain(&mut self, vertices: &[bool], triangles: &[bool]) {
        let mut next = 0;
        let renumbered: Vec<u32> = vertices
            .iter()
            .map(|keep| {
                let index = if *keep { next } else { u32::MAX };
                next += u32::from(*keep);
                index
            })
            .collect();
        fn keep<T>(of: &mut Vec<T>, marks: &[bool]) {
            let mut marks = marks.iter();
            of.retain(|_| *marks.next().unwrap_or(&false));
        }
        keep(&mut self.positions, vertices);
        keep(&mut self.normals, vertices);
        keep(&mut self.colors, vertices);
        keep(&mut self.sigma_m, vertices);
        keep(&mut self.views, vertices);
        keep(&mut self.triangles, triangles);
        for triangle in &mut self.triangles {
            *triangle = triangle.map(|i| renumbered[i as usize]);
        }
    }
}
