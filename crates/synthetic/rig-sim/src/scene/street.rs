//! Street furniture: lamps, bollards, bins, cars, benches, covers of drains, litter.

use nalgebra::Vector3;

use super::build::Builder;
use super::light::Lamp;
use super::mesh::Stuff;
use super::palette;
use super::surface::Class;
use super::sweep::{Ring, sweep};

/// Materials of street furniture.
#[derive(Clone, Debug)]
pub(super) struct StreetMaterials {
    pub(super) metal: u16,
    glow: u16,
    pub(super) wood: u16,
    pub(super) stone: u16,
    bins: [u16; 2],
    cars: [u16; 4],
    window: u16,
    tyre: u16,
    light: u16,
    cover: u16,
    leaf: [u16; 2],
}

impl StreetMaterials {
    pub(super) fn new(b: &mut Builder) -> Self {
        use palette::{CONCRETE, LAMP, METAL, PANE, STEEL, VARNISH, WHITE, WOOD};
        let dyed = |own: [f32; 3]| VARNISH.dyed(own, own.map(|c| 0.8 * c + 0.02));
        let cars = [
            [0.3, 0.035, 0.04],
            [0.06, 0.1, 0.22],
            [0.52, 0.53, 0.54],
            [0.05, 0.05, 0.055],
        ];
        let leaf = [[0.3, 0.2, 0.05], [0.2, 0.1, 0.04]];
        Self {
            metal: METAL.of(Class::Obstacle, b),
            glow: LAMP.glowing(2.0).of(Class::Obstacle, b),
            wood: WOOD.of(Class::Obstacle, b),
            stone: CONCRETE.of(Class::Obstacle, b),
            bins: [[0.04, 0.12, 0.06], [0.07, 0.07, 0.08]]
                .map(|own| dyed(own).of(Class::Obstacle, b)),
            cars: cars.map(|own| dyed(own).of(Class::Obstacle, b)),
            window: PANE.of(Class::Obstacle, b),
            tyre: dyed([0.03; 3]).of(Class::Obstacle, b),
            light: WHITE.of(Class::Obstacle, b),
            cover: STEEL
                .dyed([0.13, 0.12, 0.11], [0.08, 0.07, 0.06])
                .of(Class::Pavement, b),
            leaf: leaf.map(|own| dyed(own).of(Class::Pavement, b)),
        }
    }

    /// A lamp on a post.
    pub(super) fn lamp(&self, b: &mut Builder, foot: Vector3<f64>, height: f64) -> Lamp {
        let post = b.of_thing(self.metal);
        let at = |z: f64| foot + Vector3::z() * z;
        let rings = [
            (-0.05, 0.14),
            (0.3, 0.12),
            (0.35, 0.07),
            (0.5 * height, 0.06),
            (height, 0.045),
        ]
        .map(|(z, radius)| Ring::round(at(z), radius));
        sweep(&mut b.mesh, &rings, Vector3::x(), 10, post);
        let bulb = Stuff {
            material: self.glow,
            ..post
        };
        let glass = [(0.0, 0.1), (0.12, 0.18), (0.14, 0.2)]
            .map(|(z, radius)| Ring::round(at(height + z), radius));
        sweep(&mut b.mesh, &glass, Vector3::x(), 10, bulb);
        let shade = [(0.13, 0.34), (0.17, 0.3), (0.3, 0.06)]
            .map(|(z, radius)| Ring::round(at(height + z), radius));
        sweep(&mut b.mesh, &shade, Vector3::x(), 12, post);
        Lamp {
            // Beside the post and below the glass, so that neither occludes it.
            position: at(height - 0.06) + Vector3::y() * 0.12,
            strength: 0.06,
        }
    }

    pub(super) fn bollard(&self, b: &mut Builder, foot: Vector3<f64>) {
        let bollard = b.of_thing(self.metal);
        let rings = [
            (-0.02, 0.075),
            (0.06, 0.07),
            (0.78, 0.06),
            (0.8, 0.07),
            (0.9, 0.065),
            (0.95, 0.03),
        ]
        .map(|(z, radius)| Ring::round(foot + Vector3::z() * z, radius));
        sweep(&mut b.mesh, &rings, Vector3::x(), 10, bollard);
    }

    /// A dustbin on wheels: tapered, with a lid.
    pub(super) fn bin(&self, b: &mut Builder, foot: Vector3<f64>, yaw: f64, kind: usize) {
        let body = b.of_thing(self.bins[kind % 2]);
        let turn = Builder::yaw(yaw);
        let square = |half: [f64; 2], z: f64| {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(x, y)| foot + turn * Vector3::new(x * half[0], y * half[1], z))
        };
        let (low, high) = (square([0.2, 0.22], 0.06), square([0.28, 0.3], 0.95));
        b.mesh.prism(low, high, 0.5, body);
        let (low, high) = (square([0.3, 0.32], 0.95), square([0.26, 0.28], 1.03));
        b.mesh.prism(low, high, 0.5, body);
        let tyre = Stuff {
            material: self.tyre,
            ..body
        };
        for x in [-0.2, 0.2] {
            let at = |s: f64| foot + turn * Vector3::new(x + s, 0.22, 0.1);
            b.mesh.tube([at(-0.03), at(0.03)], [0.1; 2], 10, 0.3, tyre);
        }
    }

    /// A parked car that faces along x rotated by `yaw`; `foot` is on the road below its middle.
    pub(super) fn car(&self, b: &mut Builder, foot: Vector3<f64>, yaw: f64, kind: usize) {
        let paint = b.of_thing(self.cars[kind % self.cars.len()]);
        let of = |material: u16| Stuff { material, ..paint };
        let turn = Builder::yaw(yaw);
        let at = |x: f64, y: f64, z: f64| foot + turn * Vector3::new(x, y, z);
        // Outlines of cross-sections from the tail to the nose: along, half the width, bottom, top.
        let lower = [
            [-2.1, 0.7, 0.42, 0.78],
            [-2.0, 0.82, 0.26, 0.9],
            [-1.2, 0.86, 0.22, 0.94],
            [0.9, 0.86, 0.22, 0.9],
            [1.75, 0.8, 0.24, 0.74],
            [2.05, 0.66, 0.34, 0.6],
        ];
        self.loft(b, &at, &lower, 0.12, [paint; 2]);
        // Panes all round, roof on top.
        let upper = [
            [-1.75, 0.7, 0.86, 0.92],
            [-1.3, 0.72, 0.88, 1.38],
            [0.1, 0.72, 0.88, 1.42],
            [0.95, 0.72, 0.86, 0.9],
        ];
        self.loft(b, &at, &upper, 0.1, [of(self.window), paint]);
        for (x, y) in [(-1.32, -0.76), (1.3, -0.76), (-1.32, 0.76), (1.3, 0.76)] {
            let hub = |s: f64| at(x, y + s, 0.31);
            let side = if y > 0.0 { 1.0 } else { -1.0 };
            let tyre = of(self.tyre);
            b.mesh.tube([hub(-0.1), hub(0.1)], [0.31; 2], 14, 0.4, tyre);
            let rim = [hub(0.09 * side), hub(0.115 * side)];
            b.mesh.tube(rim, [0.19, 0.17], 10, 0.4, of(self.light));
        }
        for y in [-0.55, 0.55] {
            let mut lamp = |x: f64, z: f64, material: u16| {
                let size = Vector3::new(0.12, 0.26, 0.12);
                b.standing_box(at(x, y, z), size, yaw, 0.5, of(material));
            };
            lamp(1.93, 0.56, self.light);
            lamp(-2.03, 0.7, self.cars[0]);
        }
        let plate = Vector3::new(0.02, 0.5, 0.11);
        b.standing_box(at(-2.1, 0.0, 0.5), plate, yaw, 0.6, of(self.light));
    }

    /// A body through cross-sections with chamfered upper edges: sides and ends of one material,
    /// tops of another.
    fn loft(
        &self,
        b: &mut Builder,
        at: &dyn Fn(f64, f64, f64) -> Vector3<f64>,
        sections: &[[f64; 4]],
        chamfer: f64,
        [sides, top]: [Stuff; 2],
    ) {
        let ring = |&[x, half, low, high]: &[f64; 4]| {
            let edge = (high - 0.4 * chamfer).max(low + 0.01);
            let narrow = half - chamfer;
            [
                at(x, -half, low),
                at(x, -half, edge),
                at(x, -narrow, high),
                at(x, narrow, high),
                at(x, half, edge),
                at(x, half, low),
            ]
        };
        let mut along = 0.0;
        for pair in sections.windows(2) {
            let (from, to) = (ring(&pair[0]), ring(&pair[1]));
            // An inclined top is a pane like the sides.
            let level = (pair[0][3] - pair[1][3]).abs() < 0.2;
            for k in 0..5 {
                let stuff = if k == 2 && level { top } else { sides };
                // Counter-clockwise seen from outside.
                let face = [from[k], to[k], to[k + 1], from[k + 1]];
                b.mesh.tiled_quad(face, [along, 0.3 * k as f64], 0.9, stuff);
            }
            along += pair[1][0] - pair[0][0];
        }
        let last = sections.len() - 1;
        for (i, [p, q]) in [(0, [0, 1]), (last, [1, 0])] {
            let r = ring(&sections[i]);
            for k in 1..5 {
                let fan = [r[0], r[k + p], r[k + q]];
                b.mesh.triangle(fan, [0.0, 0.0], sides);
            }
        }
    }

    /// Planks on two stone feet, with a back; one sits facing along y.
    pub(super) fn bench(&self, b: &mut Builder, foot: Vector3<f64>, yaw: f64) {
        let wood = b.of_thing(self.wood);
        let stone = Stuff {
            material: self.stone,
            ..wood
        };
        let turn = Builder::yaw(yaw);
        let mut place = |at: [f64; 3], size: [f64; 3], stuff: Stuff| {
            let base = foot + turn * Vector3::from(at);
            b.standing_box(base, Vector3::from(size), yaw, 0.6, stuff);
        };
        for x in [-0.7, 0.7] {
            place([x, 0.0, -0.02], [0.1, 0.42, 0.42], stone);
            place([x, -0.24, -0.02], [0.06, 0.06, 0.88], stone);
        }
        for y in [-0.16, 0.0, 0.16] {
            place([0.0, y, 0.41], [1.8, 0.13, 0.04], wood);
        }
        for z in [0.56, 0.72] {
            place([0.0, -0.19, z], [1.8, 0.035, 0.12], wood);
        }
    }

    /// The round cover of a drain, a few millimetres over the ground, or a square grating.
    pub(super) fn cover(&self, b: &mut Builder, middle: Vector3<f64>, is_round: bool) {
        let cover = Builder::on_ground(self.cover);
        if is_round {
            let rings = [(0.33, -0.03), (0.325, 0.004)]
                .map(|(radius, z)| Ring::round(middle + Vector3::z() * z, radius));
            sweep(&mut b.mesh, &rings, Vector3::x(), 20, cover);
            return;
        }
        for k in 0..7 {
            let base = middle + Vector3::new(0.06 * f64::from(k) - 0.18, 0.0, -0.04);
            b.standing_box(base, Vector3::new(0.035, 0.42, 0.044), 0.0, 0.5, cover);
        }
    }

    /// Fallen leaves, flat on the ground, at random within `reach` m of a point.
    pub(super) fn fallen_leaves(
        &self,
        b: &mut Builder,
        around: [f64; 2],
        reach: f64,
        count: u32,
        height: impl Fn(f64, f64) -> f64,
    ) {
        for k in 0..count {
            let angle = b.draw(0.0, 2.0 * std::f64::consts::PI);
            let far = reach * b.draw(0.0, 1.0);
            let (x, y) = (
                around[0] + far * libm::cos(angle),
                around[1] + far * libm::sin(angle),
            );
            let turn = b.draw(0.0, 2.0 * std::f64::consts::PI);
            let size = b.draw(0.02, 0.045);
            let point = |ahead: f64, left: f64| {
                let (s, c) = (libm::sin(turn), libm::cos(turn));
                let (px, py) = (
                    x + size * (ahead * c - left * s),
                    y + size * (ahead * s + left * c),
                );
                // Slightly above the ground, so that they are visible.
                Vector3::new(px, py, height(px, py) + 0.003)
            };
            let corners = [
                point(-1.0, 0.0),
                point(0.1, -0.55),
                point(1.1, 0.1),
                point(0.0, 0.6),
            ];
            let leaf = Builder::on_ground(self.leaf[(k % 2) as usize]);
            b.mesh.quad(corners, [x, y], leaf);
        }
    }
}
