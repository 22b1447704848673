//! Trees, bushes and ferns.

use nalgebra::Vector3;

use super::terrain::Terrain;
use super::{Disc, Palette, free_place};
use crate::scene::build::Builder;
use crate::scene::mesh::Stuff;
use crate::scene::plants::{Clump, bush};
use crate::scene::sweep::{Ring, sweep};

/// Trees near the trail. Returns their positions.
pub(super) fn near_trees(
    b: &mut Builder,
    p: &Palette,
    terrain: &Terrain,
    taken: &mut Vec<Disc>,
) -> Vec<[f64; 2]> {
    let mut trees = Vec::new();
    for i in 0..75 {
        let radius = b.draw(0.08, 0.26);
        // Every second one stands by the trail, if there is room.
        let Some(at) = free_place(b, terrain, taken, 0.75 + 1.6 * radius, 0.9) else {
            continue;
        };
        if i % 2 == 0 && terrain.off_trail(at[0], at[1]) > 3.0 {
            continue;
        }
        tree(b, p, terrain, at, radius, true);
        taken.push(Disc {
            at,
            radius: 0.3 + radius,
        });
        trees.push(at);
    }
    trees
}

/// Background trees.
pub(super) fn far_trees(b: &mut Builder, p: &Palette, terrain: &Terrain) {
    for i in 0..90 {
        let angle = 2.0 * std::f64::consts::PI * (f64::from(i) + b.draw(0.0, 1.0)) / 90.0;
        let reach = b.draw(1.0, 2.6);
        let at = [
            20.0 * reach * libm::cos(angle),
            16.0 * reach * libm::sin(angle),
        ];
        let radius = b.draw(0.12, 0.3);
        tree(b, p, terrain, at, radius, false);
    }
}

fn tree(b: &mut Builder, p: &Palette, terrain: &Terrain, at: [f64; 2], radius: f64, near: bool) {
    let species = usize::from(b.draw(0.0, 1.0) < 0.4);
    let trunk = b.of_thing(p.bark[species]);
    let crown = Stuff {
        material: p.leaves[species],
        ..trunk
    };
    let height = b.draw(26.0, 40.0) * (0.1 + radius);
    let foot = terrain.point(at[0], at[1]);
    let lean = [b.draw(-0.06, 0.06), b.draw(-0.06, 0.06)];
    let bend = b.draw(-0.15, 0.15);
    let axis = |z: f64| {
        let wave = bend * libm::sin(1.1 * z);
        foot + Vector3::new(lean[0] * z + wave, lean[1] * z - 0.6 * wave, z)
    };
    // The foot of a trunk is wider.
    let mut rings: Vec<Ring> = [(-0.3, 1.9), (0.06, 1.5), (0.3, 1.15), (0.8, 1.0)]
        .map(|(z, wide)| Ring::round(axis(z), radius * wide))
        .to_vec();
    let pieces = if near { 7 } else { 3 };
    for i in 1..=pieces {
        let t = f64::from(i) / f64::from(pieces);
        let z = 0.8 + (height - 0.8) * t;
        rings.push(Ring::round(axis(z), radius * (1.0 - 0.75 * t)));
    }
    let sides = if near { 8 } else { 5 };
    sweep(&mut b.mesh, &rings, Vector3::x(), sides, trunk);
    let clumps = if near { 4 } else { 2 };
    for i in 0..clumps {
        let t = 0.55 + 0.45 * (f64::from(i) + b.draw(0.0, 1.0)) / f64::from(clumps);
        let size = (0.22 * height * (1.45 - t)).max(0.7);
        let off = Vector3::new(b.draw(-0.5, 0.5), b.draw(-0.5, 0.5), 0.0) * size;
        let radii = Vector3::new(size, size * b.draw(0.8, 1.2), 0.75 * size);
        let spray = if near { 0.8 * size } else { 0.95 * size };
        Clump::new(axis(height * t) + off, radii, spray).grow(b, crown);
    }
    if near {
        branches(b, terrain, &axis, [radius, height], trunk);
    }
}

/// Dead twigs on the lower trunk; none reaches over the trail at the height of a face.
fn branches(
    b: &mut Builder,
    terrain: &Terrain,
    axis: &dyn Fn(f64) -> Vector3<f64>,
    [radius, height]: [f64; 2],
    stuff: Stuff,
) {
    for _ in 0..3 {
        let from = axis(b.draw(1.2, 0.5 * height));
        let angle = b.draw(0.0, 2.0 * std::f64::consts::PI);
        let out = Vector3::new(libm::cos(angle), libm::sin(angle), b.draw(-0.1, 0.5));
        let tip = from + out * b.draw(0.5, 1.3);
        if terrain.off_trail(tip.x, tip.y) < 0.8 {
            continue;
        }
        let elbow = (from + tip) * 0.5 + Vector3::z() * b.draw(-0.1, 0.1);
        let rings = [
            Ring::round(from, 0.12 * radius),
            Ring::round(elbow, 0.08 * radius),
            Ring::round(tip, 0.03 * radius),
        ];
        let aside = Vector3::new(-out.y, out.x, 0.0);
        sweep(&mut b.mesh, &rings, aside, 4, stuff);
    }
}

pub(super) fn undergrowth(b: &mut Builder, p: &Palette, terrain: &Terrain, taken: &[Disc]) {
    for i in 0..45 {
        let size = b.draw(0.2, 0.45);
        let Some(at) = free_place(b, terrain, taken, 0.75 + size, 0.2) else {
            continue;
        };
        let foot = terrain.point(at[0], at[1]);
        let leaves = b.of_thing(p.leaves[i % 2]);
        bush(b, leaves, foot, 2.2 * size);
    }
    for _ in 0..100 {
        let Some(at) = free_place(b, terrain, taken, 0.75, 0.1) else {
            continue;
        };
        fern(b, p, terrain.point(at[0], at[1]));
    }
}

/// Fronds that bend outwards, visible from both sides.
fn fern(b: &mut Builder, p: &Palette, foot: Vector3<f64>) {
    let fern = b.of_thing(p.fern);
    let turn = b.draw(0.0, 6.0);
    let size = b.draw(0.2, 0.5);
    for i in 0..6 {
        let angle = turn + 1.05 * f64::from(i) + b.draw(-0.2, 0.2);
        let out = Vector3::new(libm::cos(angle), libm::sin(angle), 0.0);
        let aside = Vector3::new(-out.y, out.x, 0.0);
        let rise = size * b.draw(1.2, 2.0);
        let at = |k: u32| {
            let t = f64::from(k) / 3.0;
            let middle = foot + out * (size * t) + Vector3::z() * (rise * t * (1.2 - 0.9 * t));
            let half = aside * (size * (0.02 + 0.4 * t * (1.0 - t)));
            [middle - half, middle + half]
        };
        for k in 0..3 {
            let ([a, d], [next, c]) = (at(k), at(k + 1));
            let uv = [size * f64::from(k) / 3.0, 0.0];
            b.mesh.quad([a, next, c, d], uv, fern);
            b.mesh.quad([d, c, next, a], uv, fern);
        }
    }
}
