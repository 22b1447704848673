//! Trees, bushes, hedges.
//!
//! Leaves are not modelled individually: a crown is a dark core with sprays around it, triangles
//! with a leaf texture, between which the sky is visible.

use nalgebra::Vector3;

use super::build::Builder;
use super::mesh::Stuff;
use super::palette;
use super::surface::Class;
use super::sweep::{Ring, sweep};

/// A clump of leaves about a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clump {
    /// Center or radii, m.
    pub(super) center: Vector3<f64>,
    /// Center or radii, m.
    pub(super) radii: Vector3<f64>,
    /// Number of sprays.
    pub(super) sprays: u32,
    /// Length of a spray, m.
    pub(super) spray_m: f64,
}

impl Clump {
    /// With a number of sprays that occludes about half of the background.
    pub(super) fn new(center: Vector3<f64>, radii: Vector3<f64>, spray_m: f64) -> Self {
        let [x, y, z] = [radii.x, radii.y, radii.z];
        let surface = 4.0 * std::f64::consts::PI * (x * y + y * z + z * x) / 3.0;
        Self {
            center,
            radii,
            sprays: (1.1 * surface / (spray_m * spray_m)) as u32,
            spray_m,
        }
    }

    /// Adds the clump to a scene.
    pub(super) fn grow(&self, b: &mut Builder, leaves: Stuff) {
        b.lump(self.center, self.radii * 0.8, 4, 0.2, leaves);
        for _ in 0..self.sprays {
            // Uniform over the sphere, less dense outwards.
            let up = b.draw(-1.0, 1.0);
            let angle = b.draw(0.0, 2.0 * std::f64::consts::PI);
            let level = (1.0 - up * up).sqrt();
            let out = Vector3::new(level * libm::cos(angle), level * libm::sin(angle), up);
            let reach = 0.78 + 0.38 * b.draw(0.0, 1.0) * b.draw(0.0, 1.0);
            let at = self.center + out.component_mul(&self.radii) * reach;
            let tilt = [0, 1, 2].map(|_| b.draw(-0.6, 0.6));
            let facing = (out + Vector3::from(tilt)).normalize();
            let helper = if facing.z.abs() > 0.8 {
                Vector3::x()
            } else {
                Vector3::z()
            };
            let right = helper.cross(&facing).normalize();
            let over = facing.cross(&right);
            let start = b.draw(0.0, 2.0);
            let corners = [0.0, 1.0, 2.0].map(|k| {
                let turn = start + 2.0 * std::f64::consts::PI * k / 3.0 + b.draw(-0.5, 0.5);
                let length = self.spray_m * b.draw(0.45, 0.85);
                at + (right * libm::cos(turn) + over * libm::sin(turn)) * length
            });
            // Visible from both sides.
            let [p, q, r] = corners;
            b.mesh.triangle([p, q, r], [at.x + at.z, at.y], leaves);
            b.mesh.triangle([p, r, q], [at.x + at.z, at.y], leaves);
        }
    }
}

/// Materials of trees.
#[derive(Clone, Copy, Debug)]
pub(super) struct Greens {
    pub(super) bark: u16,
    pub(super) leaves: u16,
}

impl Greens {
    pub(super) fn new(b: &mut Builder) -> Self {
        Self {
            bark: palette::BARK.of(Class::Obstacle, b),
            leaves: palette::LEAVES.of(Class::Obstacle, b),
        }
    }
}

/// A tree of a street: a trunk of `trunk_m` and a round crown above it.
pub(super) fn street_tree(b: &mut Builder, greens: Greens, foot: Vector3<f64>, trunk_m: f64) {
    let trunk = b.of_thing(greens.bark);
    let leaves = Stuff {
        material: greens.leaves,
        ..trunk
    };
    let lean = [b.draw(-0.05, 0.05), b.draw(-0.05, 0.05)];
    let at = |z: f64| foot + Vector3::new(lean[0] * z, lean[1] * z, z);
    let rings = [
        (-0.1, 0.22),
        (0.15, 0.16),
        (0.4 * trunk_m, 0.13),
        (0.7 * trunk_m, 0.12),
        (trunk_m + 0.9, 0.06),
    ]
    .map(|(z, radius)| Ring::round(at(z), radius));
    sweep(&mut b.mesh, &rings, Vector3::x(), 10, trunk);
    for k in 0..5 {
        let angle = 1.3 * f64::from(k) + b.draw(-0.3, 0.3);
        let out = Vector3::new(libm::cos(angle), libm::sin(angle), 0.0);
        let center = at(trunk_m + b.draw(0.3, 1.5)) + out * b.draw(0.4, 0.9);
        // A limb that carries it.
        let limb = [
            Ring::round(at(trunk_m - 0.3), 0.06),
            Ring::round(center, 0.03),
        ];
        sweep(
            &mut b.mesh,
            &limb,
            Vector3::new(-out.y, out.x, 0.0),
            5,
            trunk,
        );
        let radii = Vector3::new(0.8, 0.8, 0.65) * b.draw(0.8, 1.15);
        Clump::new(center, radii, 0.55).grow(b, leaves);
    }
}

/// A bush of a few clumps on the ground, `size` m wide.
pub(super) fn bush(b: &mut Builder, leaves: Stuff, foot: Vector3<f64>, size: f64) {
    for _ in 0..3 {
        let off = Vector3::new(b.draw(-0.3, 0.3), b.draw(-0.3, 0.3), b.draw(0.2, 0.55));
        let radii = Vector3::new(0.42, 0.42, 0.38) * (size * b.draw(0.75, 1.15));
        Clump::new(foot + off * size, radii, 0.42 * size).grow(b, leaves);
    }
}

/// A hedge along a line on level ground, `width` m wide.
pub(super) fn hedge(b: &mut Builder, material: u16, ends: [Vector3<f64>; 2], width: f64) {
    let leaves = b.of_thing(material);
    let along = ends[1] - ends[0];
    let count = (along.norm() / (0.7 * width)).ceil() as u32;
    for k in 0..=count {
        let center = ends[0] + along * (f64::from(k) / f64::from(count));
        let off = Vector3::new(b.draw(-0.1, 0.1), b.draw(-0.1, 0.1), b.draw(0.38, 0.5)) * width;
        let radii = Vector3::new(0.55, 0.55, 0.5) * (width * b.draw(0.9, 1.1));
        Clump::new(center + off, radii, 0.5 * width).grow(b, leaves);
    }
}
