//! Furniture of the square: fountain, lamps, benches, planters, bollards, trees.

use nalgebra::Vector3;

use super::{FOUNTAIN, HALF, Palette};
use crate::scene::build::Builder;
use crate::scene::light::Lamp;
use crate::scene::mesh::Stuff;
use crate::scene::plants::{self, Clump};
use crate::scene::sweep::{Ring, sweep};

/// A basin with a step, water, and a bowl on a stem.
pub(super) fn fountain(b: &mut Builder, p: &Palette) {
    let stone = b.of_thing(p.stone);
    let water = Stuff {
        material: p.water,
        ..stone
    };
    let foot = Vector3::new(FOUNTAIN[0], FOUNTAIN[1], 0.0);
    // Radius and height, from the outer foot of the step to the inner foot of the wall.
    let profile = [
        [2.6, -0.02],
        [2.6, 0.15],
        [2.28, 0.15],
        [2.22, 0.5],
        [2.3, 0.55],
        [2.3, 0.62],
        [1.98, 0.62],
        [1.98, 0.4],
    ];
    let sides = 40;
    let at = |[radius, height]: [f64; 2], k: usize| {
        let angle = 2.0 * std::f64::consts::PI * (k % sides) as f64 / sides as f64;
        foot + Vector3::new(radius * libm::cos(angle), radius * libm::sin(angle), height)
    };
    for k in 0..sides {
        let along = 2.3 * 2.0 * std::f64::consts::PI * k as f64 / sides as f64;
        let mut down = 0.0;
        for pair in profile.windows(2) {
            let [from, to] = [pair[0], pair[1]];
            let quad = [at(from, k), at(from, k + 1), at(to, k + 1), at(to, k)];
            b.mesh.quad(quad, [along, down], stone);
            down += libm::hypot(to[0] - from[0], to[1] - from[1]);
        }
        for (inner, outer) in [(0.0, 0.7), (0.7, 1.4), (1.4, 1.99)] {
            let (from, to) = ([outer, 0.47], [inner, 0.47]);
            let center = at(to, k);
            b.mesh.triangle(
                [center, at(from, k), at(from, k + 1)],
                [along, outer],
                water,
            );
            if inner > 0.0 {
                b.mesh.triangle(
                    [center, at(from, k + 1), at(to, k + 1)],
                    [along, outer],
                    water,
                );
            }
        }
    }
    let stem = [
        (0.3, 0.4),
        (0.6, 0.36),
        (0.75, 0.2),
        (1.15, 0.14),
        (1.35, 0.2),
        (1.45, 0.7),
        (1.6, 0.95),
        (1.66, 0.95),
        (1.67, 0.3),
        (1.9, 0.12),
        (2.1, 0.18),
        (2.25, 0.1),
        (2.3, 0.02),
    ]
    .map(|(z, radius)| Ring::round(foot + Vector3::z() * z, radius));
    sweep(&mut b.mesh, &stem, Vector3::x(), 20, stone);
}

pub(super) fn lamps(b: &mut Builder, p: &Palette) -> Vec<Lamp> {
    [
        [-9.5, -10.6],
        [0.0, -10.6],
        [9.0, -10.6],
        [-9.0, 10.6],
        [0.0, 10.6],
        [9.5, 10.6],
        [0.6, 0.0],
    ]
    .map(|[x, y]| p.street.lamp(b, Vector3::new(x, y, 0.0), 3.8))
    .to_vec()
}

pub(super) fn seats_and_planters(b: &mut Builder, p: &Palette) {
    for [x, y, yaw] in [
        [-5.0, -10.9, 0.02],
        [4.5, -10.9, -0.03],
        [-4.5, 10.9, 3.12],
        [5.0, 10.9, 3.17],
        [-3.8, 3.6, 3.13],
        [-3.8, -3.6, 0.0],
        [14.7, 2.5, 1.57],
        [-14.7, -2.5, -1.57],
    ] {
        p.street.bench(b, Vector3::new(x, y, 0.0), yaw);
    }
    for [x, y] in [
        [-7.3, -10.7],
        [2.2, -10.8],
        [7.0, -10.7],
        [-7.0, 10.8],
        [-2.2, 10.7],
        [7.3, 10.7],
        [-14.6, 2.0],
        [14.6, -2.2],
        [1.2, 2.3],
        [1.2, -2.3],
    ] {
        planter(b, p, Vector3::new(x, y, -0.01));
    }
    for i in 0..8 {
        let along = 0.5 + 0.85 * f64::from(i % 4);
        let (x, y) = match i < 4 {
            true => (HALF[0] - along, -HALF[1] - 0.3),
            false => (along - HALF[0], HALF[1] + 0.3),
        };
        p.street.bollard(b, Vector3::new(x, y, 0.0));
    }
}

fn planter(b: &mut Builder, p: &Palette, foot: Vector3<f64>) {
    let stone = b.of_thing(p.stone);
    let green = |material: u16| Stuff { material, ..stone };
    let rings = [
        (0.0, 0.36),
        (0.4, 0.46),
        (0.48, 0.5),
        (0.55, 0.5),
        (0.551, 0.3),
    ]
    .map(|(z, radius)| Ring::round(foot + Vector3::z() * z, radius));
    sweep(&mut b.mesh, &rings, Vector3::x(), 14, stone);
    for i in 0..6 {
        let off = Vector3::new(b.draw(-0.2, 0.2), b.draw(-0.2, 0.2), b.draw(0.65, 1.0));
        let radii = Vector3::new(1.0, 1.0, 0.9) * b.draw(0.16, 0.25);
        let material = if i % 2 == 0 {
            p.greens.leaves
        } else {
            p.flowers
        };
        Clump::new(foot + off, radii, 0.2).grow(b, green(material));
    }
}

pub(super) fn trees(b: &mut Builder, p: &Palette) {
    for [x, y] in [
        [-12.5, -10.8],
        [11.8, -10.8],
        [-11.8, 10.8],
        [12.5, 10.8],
        [7.8, 3.2],
        [7.8, -3.2],
    ] {
        let foot = Vector3::new(x, y, 0.0);
        plants::street_tree(b, p.greens, foot, 3.3);
        p.street.fallen_leaves(b, [x, y], 2.5, 30, |_, _| 0.0);
    }
    for [x, y] in [
        [-1.5, -7.2],
        [9.8, -6.6],
        [11.2, 2.0],
        [2.0, 7.9],
        [-11.0, -1.0],
    ] {
        p.street.cover(b, Vector3::new(x, y, 0.0), true);
    }
}
