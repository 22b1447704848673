//! A trail through a forest: a slope, worn ground with bumps, roots and stones to step over or on.
//!
//! A closed loop of some 65 m with a few metres of height. Roots and low stones are obstacles that
//! can be walked on; trees, bushes, boulders and logs leave room for shoulders.

use nalgebra::Vector3;

use self::terrain::Terrain;
use super::build::{Builder, SceneParts};
use super::light::{Lamp, Lights};
use super::route::{Leg, Route};
use super::surface::Class;
use super::sweep::{Ring, sweep};
use crate::walker::path::Path;

mod plants;
mod terrain;

/// Materials of the scene.
struct Palette {
    earth: u16,
    litter: u16,
    moss: u16,
    root: u16,
    flat_stone: u16,
    boulder: u16,
    bark: [u16; 2],
    leaves: [u16; 2],
    fern: u16,
    wood: u16,
}

/// An occupied disc on the ground.
struct Disc {
    at: [f64; 2],
    radius: f64,
}

pub(super) fn build(b: &mut Builder) -> SceneParts {
    let p = palette(b);
    let points = loop_points(b);
    let path = Path::closed(&points);
    let terrain = Terrain::new(b, &points);
    ground(b, &p, &terrain);
    let mut taken = Vec::new();
    let lamps = lamps(b, &p, &terrain, &path, &mut taken);
    let trees = plants::near_trees(b, &p, &terrain, &mut taken);
    plants::far_trees(b, &p, &terrain);
    roots(b, &p, &terrain, &path, &trees);
    stones(b, &p, &terrain, &path, &mut taken);
    logs(b, &p, &terrain, &mut taken);
    plants::undergrowth(b, &p, &terrain, &taken);
    SceneParts {
        lights: Lights {
            sun: Vector3::new(0.35, -0.3, 0.9),
            low_sun: Vector3::new(0.9, 0.3, 0.32),
            lamps,
            indoors: false,
        },
        route: Route {
            start_below: terrain.height(path.at(0.0).0[0], path.at(0.0).0[1]) + 1.0,
            points,
            legs: vec![
                Leg::walk(14.0, 1.05),
                Leg::walk(9.0, 0.8),
                Leg::Stand { seconds: 1.5 },
                Leg::walk(16.0, 1.2),
                Leg::Stumble,
                Leg::walk(10.0, 1.0),
                Leg::walk(9.0, 2.2),
                Leg::walk(8.0, 1.1),
            ],
        },
    }
}

/// Control points of a loop with bends, 24 m by 15 m.
fn loop_points(b: &mut Builder) -> Vec<[f64; 2]> {
    (0..16)
        .map(|i| {
            let angle = 2.0 * std::f64::consts::PI * f64::from(i) / 16.0;
            let reach = b.draw(0.86, 1.14);
            [
                12.0 * reach * libm::cos(angle),
                7.5 * reach * libm::sin(angle),
            ]
        })
        .collect()
}

fn palette(b: &mut Builder) -> Palette {
    use super::palette::{BARK, EARTH, LEAVES, LITTER, MOSS, STONES, WOOD};
    let palette = Palette {
        earth: EARTH.of(Class::Grass, b),
        litter: LITTER.of(Class::Grass, b),
        moss: MOSS.of(Class::Grass, b),
        root: BARK
            .dyed([0.2, 0.15, 0.1], [0.13, 0.1, 0.07])
            .of(Class::Obstacle, b),
        flat_stone: STONES.of(Class::Obstacle, b),
        boulder: STONES
            .dyed([0.27, 0.27, 0.25], [0.13, 0.16, 0.08])
            .of(Class::Obstacle, b),
        bark: [
            BARK.of(Class::Obstacle, b),
            BARK.dyed([0.3, 0.28, 0.24], [0.16, 0.15, 0.13])
                .of(Class::Obstacle, b),
        ],
        leaves: [
            LEAVES.of(Class::Obstacle, b),
            LEAVES
                .dyed([0.17, 0.15, 0.04], [0.26, 0.17, 0.05])
                .of(Class::Obstacle, b),
        ],
        fern: LEAVES
            .dyed([0.1, 0.19, 0.05], [0.2, 0.25, 0.09])
            .of(Class::Obstacle, b),
        wood: WOOD.of(Class::Obstacle, b),
    };
    // These are walkable.
    for low in [palette.root, palette.flat_stone] {
        b.materials[low as usize].walkable = true;
    }
    palette
}

fn ground(b: &mut Builder, p: &Palette, terrain: &Terrain) {
    terrain.lay(&mut b.mesh, |x, y, off| {
        let patch = terrain.patch(x, y);
        // Edges are irregular: leaves cover them.
        let worn = off < 0.5 + 0.2 * patch + 0.12 * terrain.fray(x, y);
        // Leaves gather on the trail too, and moss grows beside it.
        let drift = terrain.patch(y + 40.0, 1.3 * x) + 0.2 * terrain.fray(y, x);
        Builder::on_ground(match (worn, drift) {
            (true, d) if d < 0.45 => p.earth,
            (false, d) if d < -0.75 => p.moss,
            _ => p.litter,
        })
    });
}

/// Posts with a lamp each, as beside a lit running track. Without them a night would be black.
fn lamps(
    b: &mut Builder,
    p: &Palette,
    terrain: &Terrain,
    path: &Path,
    taken: &mut Vec<Disc>,
) -> Vec<Lamp> {
    let mut lamps = Vec::new();
    for i in 0..6 {
        let ([x, y], [dx, dy]) = path.at(path.length_m() * (f64::from(i) + 0.3) / 6.0);
        let side = if i % 2 == 0 { 1.15 } else { -1.15 };
        let foot = terrain.point(x - dy * side, y + dx * side) - Vector3::z() * 0.1;
        let head = foot + Vector3::z() * 2.7;
        let post = b.of_thing(p.wood);
        b.mesh.tube([foot, head], [0.06, 0.05], 9, 0.5, post);
        let yaw = libm::atan2(dy, dx);
        let inwards = Vector3::new(dy, -dx, 0.0) * side.signum();
        b.standing_box(head, Vector3::new(0.3, 0.3, 0.08), yaw, 0.3, post);
        lamps.push(Lamp {
            position: head + inwards * 0.2 - Vector3::z() * 0.1,
            strength: 0.05,
        });
        taken.push(Disc {
            at: [foot.x, foot.y],
            radius: 0.4,
        });
    }
    lamps
}

/// A free position at least `clear` m from the trail's middle.
fn free_place(
    b: &mut Builder,
    terrain: &Terrain,
    taken: &[Disc],
    clear: f64,
    radius: f64,
) -> Option<[f64; 2]> {
    (0..40).find_map(|_| {
        let (x, y) = (b.draw(-17.0, 17.0), b.draw(-12.5, 12.5));
        let free = |s: &Disc| libm::hypot(s.at[0] - x, s.at[1] - y) > s.radius + radius;
        (terrain.off_trail(x, y) > clear && taken.iter().all(free)).then_some([x, y])
    })
}

/// Roots that cross the trail: from trees beside it, and others without a visible tree.
fn roots(b: &mut Builder, p: &Palette, terrain: &Terrain, path: &Path, trees: &[[f64; 2]]) {
    let crossings = (path.length_m() / 2.2) as usize;
    for i in 0..crossings {
        let gone = 2.2 * (i as f64 + b.draw(0.0, 0.8));
        let ([x, y], [dx, dy]) = path.at(gone);
        let side = if b.draw(0.0, 1.0) < 0.5 { 1.0 } else { -1.0 };
        let near = trees.iter().find(|t| libm::hypot(t[0] - x, t[1] - y) < 2.0);
        let slant = b.draw(-0.7, 0.7);
        let from = near.copied().unwrap_or([
            x - dy * 1.3 * side - dx * slant,
            y + dx * 1.3 * side - dy * slant,
        ]);
        let to = [
            2.0 * x - from[0] + dx * slant * 0.5,
            2.0 * y - from[1] + dy * slant * 0.5,
        ];
        root(b, p, terrain, from, to);
    }
}

/// A root that winds half buried over the ground.
fn root(b: &mut Builder, p: &Palette, terrain: &Terrain, from: [f64; 2], to: [f64; 2]) {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let length = libm::hypot(dx, dy);
    let aside = Vector3::new(-dy, dx, 0.0) / length;
    let radius = b.draw(0.02, 0.05);
    let (wind, phase) = (b.draw(0.04, 0.12), b.draw(0.0, 6.0));
    let buried = b.draw(0.2, 0.6);
    let count = (length / 0.14).ceil() as usize;
    let rings: Vec<Ring> = (0..=count)
        .map(|i| {
            let t = i as f64 / count as f64;
            let off = aside * (wind * libm::sin(3.1 * length * t + phase));
            let (x, y) = (from[0] + dx * t + off.x, from[1] + dy * t + off.y);
            let thick = radius * (1.0 - 0.6 * t);
            // It dips below the ground in places, and at both ends.
            let dive = 0.6 + 0.4 * libm::sin(2.3 * length * t + 2.0 * phase);
            let ends = (6.0 * t).min(6.0 * (1.0 - t)).min(1.0);
            let up = thick * (1.6 * ends - 1.0 - buried * dive);
            Ring::round(terrain.point(x, y) + Vector3::z() * up, thick)
        })
        .collect();
    let stuff = b.of_thing(p.root);
    sweep(&mut b.mesh, &rings, aside, 8, stuff);
}

/// Low stones in the trail, and boulders beside it.
fn stones(b: &mut Builder, p: &Palette, terrain: &Terrain, path: &Path, taken: &mut Vec<Disc>) {
    let count = (path.length_m() / 0.7) as usize;
    for i in 0..count {
        let ([x, y], [dx, dy]) = path.at(0.7 * (i as f64 + b.draw(0.0, 1.0)));
        let side = b.draw(-0.7, 0.7);
        let at = terrain.point(x - dy * side, y + dx * side);
        let size = b.draw(0.04, 0.17);
        let flat = b.draw(0.4, 0.7);
        let stone = b.of_thing(p.flat_stone);
        let radii = Vector3::new(size, size * b.draw(0.7, 1.2), size * flat);
        let sunk = Vector3::z() * (radii.z * b.draw(0.1, 0.6));
        b.lump(at - sunk, radii, 5, 0.1, stone);
    }
    for _ in 0..22 {
        let size = b.draw(0.25, 0.6);
        let Some(at) = free_place(b, terrain, taken, 0.55 + 1.2 * size, size) else {
            continue;
        };
        let boulder = b.of_thing(p.boulder);
        let radii = Vector3::new(size, size * b.draw(0.7, 1.0), size * b.draw(0.5, 0.8));
        let center = terrain.point(at[0], at[1]) + Vector3::z() * (0.2 * radii.z);
        b.lump(center, radii, 8, 0.08, boulder);
        taken.push(Disc { at, radius: size });
    }
}

fn logs(b: &mut Builder, p: &Palette, terrain: &Terrain, taken: &mut Vec<Disc>) {
    for _ in 0..9 {
        let Some(at) = free_place(b, terrain, taken, 1.4, 0.8) else {
            continue;
        };
        let angle = b.draw(0.0, std::f64::consts::PI);
        let half = [1.2 * libm::cos(angle), 1.2 * libm::sin(angle)];
        let radius = b.draw(0.09, 0.2);
        let ends = [-1.0, 0.0, 1.0].map(|s| [at[0] + s * half[0], at[1] + s * half[1]]);
        if ends.iter().any(|e| terrain.off_trail(e[0], e[1]) < 0.9) {
            continue;
        }
        let rings: Vec<Ring> = (0..=6)
            .map(|i| {
                let s = f64::from(i) / 3.0 - 1.0;
                let foot = terrain.point(at[0] + s * half[0], at[1] + s * half[1]);
                Ring::round(
                    foot + Vector3::z() * (0.7 * radius),
                    radius * (1.0 - 0.15 * s),
                )
            })
            .collect();
        let log = b.of_thing(p.bark[0]);
        sweep(&mut b.mesh, &rings, Vector3::z(), 10, log);
        taken.extend(ends.map(|at| Disc { at, radius: 0.6 }));
    }
}

#[cfg(test)]
mod tests;
