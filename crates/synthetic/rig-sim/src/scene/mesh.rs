//! Triangle meshes and their construction.
//!
//! Contract: a triangle's corners run counter-clockwise seen from outside; `uv` are metres on the
//! surface, so that a texture has its physical size everywhere. Shared edges have bit-equal
//! corners, hence no cracks.

use nalgebra::{UnitQuaternion, Vector3};

/// A corner: its position and its texture coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Position in the mesh frame, m.
    pub position: Vector3<f64>,
    /// Texture coordinates, m along the surface.
    pub uv: [f64; 2],
}

/// A triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// Counter-clockwise seen from outside.
    pub corners: [Corner; 3],
    /// Index into the scene's materials.
    pub material: u16,
    /// Instance; 0 is the ground.
    pub instance: u16,
}

impl Triangle {
    /// Outward unit normal.
    pub fn normal(&self) -> Vector3<f64> {
        let [a, b, c] = self.corners.map(|c| c.position);
        (b - a).cross(&(c - a)).normalize()
    }
}

/// Triangles in one frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// In any order.
    pub triangles: Vec<Triangle>,
}

/// Material and instance.
#[derive(Clone, Copy, Debug)]
pub struct Stuff {
    /// Index into the scene's materials.
    pub material: u16,
    /// Instance.
    pub instance: u16,
}

impl Mesh {
    /// A quadrilateral; corners counter-clockwise from outside, the first one's `uv` given, the
    /// others by their distance along `a→b` and `a→d`.
    pub fn quad(&mut self, [a, b, c, d]: [Vector3<f64>; 4], uv: [f64; 2], stuff: Stuff) {
        let along = (b - a).normalize();
        let across = {
            let side = d - a;
            (side - along * side.dot(&along)).normalize()
        };
        let corner = |p: Vector3<f64>| Corner {
            position: p,
            uv: [uv[0] + (p - a).dot(&along), uv[1] + (p - a).dot(&across)],
        };
        let Stuff { material, instance } = stuff;
        for corners in [[a, b, c], [a, c, d]] {
            self.triangles.push(Triangle {
                corners: corners.map(corner),
                material,
                instance,
            });
        }
    }

    /// A triangle; corners counter-clockwise from outside, `uv` as of [`Mesh::quad`].
    pub fn triangle(&mut self, [a, b, c]: [Vector3<f64>; 3], uv: [f64; 2], stuff: Stuff) {
        let along = (b - a).normalize();
        let side = c - a;
        let across = (side - along * side.dot(&along)).normalize();
        let corner = |p: Vector3<f64>| Corner {
            position: p,
            uv: [uv[0] + (p - a).dot(&along), uv[1] + (p - a).dot(&across)],
        };
        self.triangles.push(Triangle {
            corners: [a, b, c].map(corner),
            material: stuff.material,
            instance: stuff.instance,
        });
    }

    /// A quadrilateral cut into cells of at most `cell_m`.
    pub(crate) fn tiled_quad(
        &mut self,
        [a, b, c, d]: [Vector3<f64>; 4],
        uv: [f64; 2],
        cell_m: f64,
        stuff: Stuff,
    ) {
        let cells = |length: f64| (length / cell_m).ceil().max(1.0) as usize;
        let (columns, rows) = (cells((b - a).norm()), cells((d - a).norm()));
        let at = |i: usize, j: usize| {
            let (s, t) = (i as f64 / columns as f64, j as f64 / rows as f64);
            (a * (1.0 - s) + b * s) * (1.0 - t) + (d * (1.0 - s) + c * s) * t
        };
        let (width, height) = ((b - a).norm(), (d - a).norm());
        let corner = |i: usize, j: usize| Corner {
            position: at(i, j),
            uv: [
                uv[0] + width * i as f64 / columns as f64,
                uv[1] + height * j as f64 / rows as f64,
            ],
        };
        for j in 0..rows {
            for i in 0..columns {
                let quad = [
                    corner(i, j),
                    corner(i + 1, j),
                    corner(i + 1, j + 1),
                    corner(i, j + 1),
                ];
                self.push_quad(quad, stuff);
            }
        }
    }

    /// Ground from `from` to `to` in x and y, in cells of at most `cell_m`, at `height(x, y)`.
    pub fn ground(
        &mut self,
        from: [f64; 2],
        to: [f64; 2],
        cell_m: f64,
        height: impl Fn(f64, f64) -> f64,
        stuff: impl Fn(f64, f64) -> Stuff,
    ) {
        let cells = |axis: usize| ((to[axis] - from[axis]) / cell_m).ceil().max(1.0) as usize;
        let (columns, rows) = (cells(0), cells(1));
        let line = |axis: usize, i: usize, n: usize| {
            from[axis] + (to[axis] - from[axis]) * i as f64 / n as f64
        };
        let corner = |i: usize, j: usize| {
            let (x, y) = (line(0, i, columns), line(1, j, rows));
            Corner {
                position: Vector3::new(x, y, height(x, y)),
                uv: [x, y],
            }
        };
        for j in 0..rows {
            for i in 0..columns {
                let quad = [
                    corner(i, j),
                    corner(i + 1, j),
                    corner(i + 1, j + 1),
                    corner(i, j + 1),
                ];
                let middle = (quad[0].position + quad[2].position) * 0.5;
                self.push_quad(quad, stuff(middle.x, middle.y));
            }
        }
    }

    /// A rotated box of size `size` about `center`; faces cut into cells of at most `cell_m`.
    pub(crate) fn cuboid(
        &mut self,
        center: Vector3<f64>,
        size: Vector3<f64>,
        turn: UnitQuaternion<f64>,
        cell_m: f64,
        stuff: Stuff,
    ) {
        let at = |x: f64, y: f64, z: f64| {
            center + turn * Vector3::new(x * size.x, y * size.y, z * size.z) * 0.5
        };
        let faces = [
            [(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)],
            [(-1, 1, -1), (1, 1, -1), (1, -1, -1), (-1, -1, -1)],
            [(-1, -1, -1), (1, -1, -1), (1, -1, 1), (-1, -1, 1)],
            [(1, -1, -1), (1, 1, -1), (1, 1, 1), (1, -1, 1)],
            [(1, 1, -1), (-1, 1, -1), (-1, 1, 1), (1, 1, 1)],
            [(-1, 1, -1), (-1, -1, -1), (-1, -1, 1), (-1, 1, 1)],
        ];
        for (i, face) in faces.into_iter().enumerate() {
            let corners = face.map(|(x, y, z)| at(f64::from(x), f64::from(y), f64::from(z)));
            self.tiled_quad(corners, [3.7 * i as f64, 0.0], cell_m, stuff);
        }
    }

    /// A body between four corners below and the four above them, both counter-clockwise seen from
    /// above; faces cut into cells of about `cell_m`.
    pub fn prism(
        &mut self,
        [a, b, c, d]: [Vector3<f64>; 4],
        [e, f, g, h]: [Vector3<f64>; 4],
        cell_m: f64,
        stuff: Stuff,
    ) {
        let faces = [
            [e, f, g, h],
            [d, c, b, a],
            [a, b, f, e],
            [b, c, g, f],
            [c, d, h, g],
            [d, a, e, h],
        ];
        for (i, face) in faces.into_iter().enumerate() {
            self.tiled_quad(face, [3.7 * i as f64, 0.0], cell_m, stuff);
        }
    }

    /// A tube from `from` to `to` with these radii, of `sides` sides, cut along its length into
    /// pieces of at most `piece_m`, closed at both ends. Textures run along u.
    pub(crate) fn tube(
        &mut self,
        [from, to]: [Vector3<f64>; 2],
        [r0, r1]: [f64; 2],
        sides: usize,
        piece_m: f64,
        stuff: Stuff,
    ) {
        let axis = (to - from).normalize();
        let helper = match axis.z.abs() > 0.9 {
            true => Vector3::x(),
            false => Vector3::z(),
        };
        let right = axis.cross(&helper).normalize();
        let up = right.cross(&axis);
        let length = (to - from).norm();
        let pieces = (length / piece_m).ceil().max(1.0) as usize;
        let around = 2.0 * std::f64::consts::PI * r0.max(r1);
        let ring = |i: usize, k: usize| {
            let t = i as f64 / pieces as f64;
            let angle = 2.0 * std::f64::consts::PI * (k % sides) as f64 / sides as f64;
            let radius = r0 + (r1 - r0) * t;
            // Counter-clockwise seen against the axis is from `up` towards `-right`.
            let out = up * libm::cos(angle) - right * libm::sin(angle);
            Corner {
                position: from + (to - from) * t + out * radius,
                uv: [length * t, around * k as f64 / sides as f64],
            }
        };
        for i in 0..pieces {
            for k in 0..sides {
                let quad = [
                    ring(i, k + 1),
                    ring(i, k),
                    ring(i + 1, k),
                    ring(i + 1, k + 1),
                ];
                self.push_quad(quad, stuff);
            }
        }
        for k in 1..sides - 1 {
            let flat = |i: usize, k: usize| {
                let corner = ring(i, k);
                let arm = corner.position - from;
                Corner {
                    uv: [arm.dot(&right), arm.dot(&up)],
                    ..corner
                }
            };
            let Stuff { material, instance } = stuff;
            for corners in [
                [flat(0, 0), flat(0, k), flat(0, k + 1)],
                [flat(pieces, 0), flat(pieces, k + 1), flat(pieces, k)],
            ] {
                self.triangles.push(Triangle {
                    corners,
                    material,
                    instance,
                });
            }
        }
    }

    /// The mesh, rotated and then translated.
    pub fn transformed(&self, turn: &UnitQuaternion<f64>, shift: &Vector3<f64>) -> Self {
        let mut moved = self.clone();
        for triangle in &mut moved.triangles {
            for corner in &mut triangle.corners {
                corner.position = turn * corner.position + shift;
            }
        }
        moved
    }

    fn push_quad(&mut self, [a, b, c, d]: [Corner; 4], Stuff { material, instance }: Stuff) {
        for corners in [[a, b, c], [a, c, d]] {
            let sides = [1, 2].map(|i| corners[i].position - corners[0].position);
            if sides[0].cross(&sides[1]).norm_squared() > 1e-18 {
                self.triangles.push(Triangle {
                    corners,
                    material,
                    instance,
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six times the volume that the triangles enclose, positive when they face outwards.
    fn volume6(mesh: &Mesh) -> f64 {
        let volume = |t: &Triangle| {
            let [a, b, c] = t.corners.map(|c| c.position);
            a.dot(&b.cross(&c))
        };
        mesh.triangles.iter().map(volume).sum()
    }

    const STUFF: Stuff = Stuff {
        material: 0,
        instance: 0,
    };

    #[test]
    fn boxes_and_tubes_are_closed_and_face_outwards() {
        let mut mesh = Mesh::default();
        let size = Vector3::new(1.0, 2.0, 3.0);
        let turn = UnitQuaternion::from_euler_angles(0.3, 0.2, 1.0);
        mesh.cuboid(Vector3::new(5.0, 1.0, 2.0), size, turn, 0.4, STUFF);
        assert!((volume6(&mesh) / 6.0 - 6.0).abs() < 1e-9);

        let mut mesh = Mesh::default();
        let square = |z: f64| {
            [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)].map(|(x, y)| Vector3::new(x, y, z))
        };
        let slanted = square(1.0).map(|p| p + Vector3::z() * p.x);
        mesh.prism(square(0.0), slanted, 0.3, STUFF);
        assert!((volume6(&mesh) / 6.0 - 4.0).abs() < 1e-9);

        for to in [Vector3::new(0.0, 0.0, 2.0), Vector3::new(1.0, -2.0, 0.5)] {
            let mut mesh = Mesh::default();
            mesh.tube([Vector3::zeros(), to], [0.5, 0.5], 64, 0.3, STUFF);
            let expected = std::f64::consts::PI * 0.25 * to.norm();
            assert!((volume6(&mesh) / 6.0 / expected - 1.0).abs() < 0.01, "{to}");
        }
    }
}
