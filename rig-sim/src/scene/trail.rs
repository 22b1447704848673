//! A trail through a forest: a slope, worn ground with bumps, roots and stones to step over or on.
//!
//! A closed loop of some 65 m with a few metres of height. Roots and low stones are obstacles that can be
//! walked on; trees, bushes, boulders and logs leave room for shoulders.

use nalgebra::Vector3;

use self::terrain::Terrain;
use super::build::{Backdrop, Builder, Made};
use super::light::{Lamp, Lights};
use super::route::{Leg, Route};
use super::surface::Class;
use super::sweep::{Ring, sweep};
use super::texture::Recipe;
use crate::walker::path::Path;

mod plants;
mod terrain;

/// What is where.
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

/// A round place that is taken.
struct Spot {
    at: [f64; 2],
    radius: f64,
}

pub(super) fn build(b: &mut Builder) -> Made {
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
    let clouds = b.texture(&Recipe {
        radius: [12.0, 400.0],
        contrast: 0.35,
        grain: 0.0,
        mixed: 0.0,
        stretch: 2.0,
    });
    let walk = |metres, speed| Leg::Walk { metres, speed };
    Made {
        lights: Lights {
            sun: Vector3::new(0.35, -0.3, 0.9),
            low_sun: Vector3::new(0.9, 0.3, 0.32),
            lamps,
            indoors: false,
        },
        sky: Backdrop { texture: clouds },
        route: Route {
            start_below: terrain.height(path.at(0.0).0[0], path.at(0.0).0[1]) + 1.0,
            points,
            legs: vec![
                walk(14.0, 1.05),
                walk(9.0, 0.8),
                Leg::Stand { seconds: 1.5 },
                walk(16.0, 1.2),
                Leg::Stumble,
                walk(10.0, 1.0),
                walk(9.0, 2.2),
                walk(8.0, 1.1),
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
    let recipe = |radius: [f32; 2], contrast: f32, grain: f32, mixed: f32, stretch: f32| Recipe {
        radius,
        contrast,
        grain,
        mixed,
        stretch,
    };
    let crumbs = b.texture(&recipe([1.0, 90.0], 0.38, 0.2, 0.3, 1.0));
    // Leaves 2 cm to 9 cm long at 2 mm per texel.
    let fallen = b.texture(&recipe([4.0, 24.0], 0.42, 0.1, 0.45, 1.9));
    let stone = b.texture(&recipe([1.5, 160.0], 0.3, 0.12, 0.35, 1.0));
    let furrows = b.texture(&recipe([2.0, 60.0], 0.45, 0.15, 0.4, 5.0));
    let green = b.texture(&recipe([2.0, 40.0], 0.5, 0.1, 0.5, 1.6));
    let palette = Palette {
        earth: b.material(
            Class::Grass,
            crumbs,
            1.3,
            [0.15, 0.11, 0.075],
            [0.22, 0.17, 0.12],
        ),
        litter: b.material(
            Class::Grass,
            fallen,
            2.0,
            [0.17, 0.1, 0.045],
            [0.3, 0.2, 0.08],
        ),
        moss: b.material(
            Class::Grass,
            green,
            1.2,
            [0.09, 0.13, 0.035],
            [0.16, 0.17, 0.06],
        ),
        root: b.material(
            Class::Obstacle,
            furrows,
            0.8,
            [0.2, 0.15, 0.1],
            [0.13, 0.1, 0.07],
        ),
        flat_stone: b.material(
            Class::Obstacle,
            stone,
            0.8,
            [0.3, 0.3, 0.28],
            [0.22, 0.23, 0.2],
        ),
        boulder: b.material(
            Class::Obstacle,
            stone,
            1.6,
            [0.27, 0.27, 0.25],
            [0.13, 0.16, 0.08],
        ),
        bark: [
            b.material(
                Class::Obstacle,
                furrows,
                2.0,
                [0.17, 0.13, 0.1],
                [0.1, 0.08, 0.06],
            ),
            b.material(
                Class::Obstacle,
                furrows,
                1.4,
                [0.3, 0.28, 0.24],
                [0.16, 0.15, 0.13],
            ),
        ],
        leaves: [
            b.material(
                Class::Obstacle,
                green,
                5.0,
                [0.07, 0.13, 0.035],
                [0.15, 0.2, 0.06],
            ),
            b.material(
                Class::Obstacle,
                green,
                6.0,
                [0.17, 0.15, 0.04],
                [0.26, 0.17, 0.05],
            ),
        ],
        fern: b.material(
            Class::Obstacle,
            green,
            1.0,
            [0.1, 0.19, 0.05],
            [0.2, 0.25, 0.09],
        ),
        wood: b.material(
            Class::Obstacle,
            furrows,
            1.0,
            [0.33, 0.26, 0.18],
            [0.24, 0.18, 0.12],
        ),
    };
    // Feet do stand on these.
    for low in [palette.root, palette.flat_stone] {
        b.materials[low as usize].walkable = true;
    }
    palette
}

fn ground(b: &mut Builder, p: &Palette, terrain: &Terrain) {
    terrain.lay(&mut b.mesh, |x, y, off| {
        let patch = terrain.patch(x, y);
        // No edge is sharp: leaves lie over it.
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
    taken: &mut Vec<Spot>,
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
        taken.push(Spot {
            at: [foot.x, foot.y],
            radius: 0.4,
        });
    }
    lamps
}

/// A free place at least `clear` m from the trail's middle.
fn free_place(
    b: &mut Builder,
    terrain: &Terrain,
    taken: &[Spot],
    clear: f64,
    radius: f64,
) -> Option<[f64; 2]> {
    (0..40).find_map(|_| {
        let (x, y) = (b.draw(-17.0, 17.0), b.draw(-12.5, 12.5));
        let free = |s: &Spot| libm::hypot(s.at[0] - x, s.at[1] - y) > s.radius + radius;
        (terrain.off_trail(x, y) > clear && taken.iter().all(free)).then_some([x, y])
    })
}

/// Roots that cross the trail: from trees beside it, and others whose tree is not seen.
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
            // It dives here and there, and at both ends for good.
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
fn stones(b: &mut Builder, p: &Palette, terrain: &Terrain, path: &Path, taken: &mut Vec<Spot>) {
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
        let centre = terrain.point(at[0], at[1]) + Vector3::z() * (0.2 * radii.z);
        b.lump(centre, radii, 8, 0.08, boulder);
        taken.push(Spot { at, radius: size });
    }
}

fn logs(b: &mut Builder, p: &Palette, terrain: &Terrain, taken: &mut Vec<Spot>) {
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
        taken.extend(ends.map(|at| Spot { at, radius: 0.6 }));
    }
}

#[cfg(test)]
mod tests;
