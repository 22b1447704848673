//! A street: houses, pavement, kerb, road with a crosswalk, and the same on the other side.
//!
//! x runs along the street, y across it. The walker goes along one pavement, over the crosswalk, back
//! along the other one, and over the road again.

use nalgebra::Vector3;

use super::build::{Backdrop, Builder, Made};
use super::light::{Lamp, Lights};
use super::mesh::Stuff;
use super::route::{Leg, Route};
use super::surface::Class;
use super::texture::Recipe;

const LENGTH: [f64; 2] = [-14.0, 30.0];
/// Across: house, pavement, road, pavement, house.
const HOUSE: f64 = 0.0;
const KERB: f64 = 3.4;
const FAR_KERB: f64 = 9.8;
const FAR_HOUSE: f64 = 13.2;
const KERB_HEIGHT: f64 = 0.12;
/// Crosswalks, along the street.
const CROSSINGS: [[f64; 2]; 2] = [[-3.0, 0.0], [14.0, 17.0]];

/// What is where.
struct Palette {
    slabs: u16,
    kerb: u16,
    asphalt: u16,
    paint: u16,
    stone: u16,
    brick: u16,
    plaster: u16,
    dark: u16,
    metal: u16,
    car: [u16; 3],
    window: u16,
    bark: u16,
    leaves: u16,
    grass: u16,
}

pub(super) fn build(b: &mut Builder) -> Made {
    let palette = palette(b);
    ground(b, &palette);
    houses(b, &palette, HOUSE, -1.0);
    houses(b, &palette, FAR_HOUSE, 1.0);
    let lamps = furniture(b, &palette);
    cars(b, &palette);
    let clouds = b.texture(&Recipe {
        radius: [12.0, 400.0],
        contrast: 0.35,
        grain: 0.0,
        mixed: 0.0,
        stretch: 2.0,
    });
    let (near, far) = (1.7, FAR_HOUSE - 1.7);
    let (left, right) = (-1.5, 15.5);
    Made {
        lights: Lights {
            sun: Vector3::new(0.4, 0.5, 0.9),
            low_sun: Vector3::new(0.95, 0.12, 0.16),
            lamps,
            indoors: false,
        },
        sky: Backdrop { texture: clouds },
        route: Route {
            points: vec![
                [left + 2.0, near],
                [4.0, near + 0.3],
                [8.0, near - 0.2],
                [right - 2.5, near],
                [right - 0.3, near + 0.2],
                [right, 4.0],
                [right, 6.6],
                [right, far - 1.2],
                [right - 0.8, far],
                [right - 3.5, far + 0.1],
                [7.0, far - 0.2],
                [3.0, far + 0.3],
                [left + 0.8, far],
                [left, far - 1.0],
                [left, 6.6],
                [left, 4.0],
                [left + 0.2, near + 0.6],
            ],
            start_below: 1.5,
            legs: vec![
                Leg::Walk {
                    metres: 12.0,
                    speed: 1.35,
                },
                Leg::Stand { seconds: 1.6 },
                Leg::Walk {
                    metres: 14.0,
                    speed: 1.2,
                },
                Leg::Walk {
                    metres: 12.0,
                    speed: 2.6,
                },
                Leg::Walk {
                    metres: 8.0,
                    speed: 1.3,
                },
                Leg::Stumble,
                Leg::Walk {
                    metres: 8.0,
                    speed: 1.1,
                },
            ],
        },
    }
}

fn palette(b: &mut Builder) -> Palette {
    let recipe = |radius: [f32; 2], contrast: f32, grain: f32, mixed: f32, stretch: f32| Recipe {
        radius,
        contrast,
        grain,
        mixed,
        stretch,
    };
    let stone = b.texture(&recipe([1.5, 120.0], 0.28, 0.12, 0.3, 1.0));
    let asphalt = b.texture(&recipe([1.0, 60.0], 0.4, 0.2, 0.2, 1.0));
    let wall = b.texture(&recipe([2.0, 160.0], 0.3, 0.08, 0.4, 1.6));
    let smooth = b.texture(&recipe([4.0, 300.0], 0.15, 0.04, 0.3, 1.0));
    let green = b.texture(&recipe([2.0, 40.0], 0.45, 0.1, 0.5, 2.5));
    Palette {
        slabs: b.material(
            Class::Pavement,
            stone,
            1.6,
            [0.33, 0.31, 0.29],
            [0.27, 0.27, 0.28],
        ),
        kerb: b.material(
            Class::Pavement,
            stone,
            1.0,
            [0.42, 0.41, 0.4],
            [0.36, 0.36, 0.36],
        ),
        asphalt: b.material(
            Class::Road,
            asphalt,
            1.5,
            [0.1, 0.1, 0.105],
            [0.15, 0.14, 0.13],
        ),
        paint: b.material(
            Class::Crosswalk,
            asphalt,
            1.2,
            [0.62, 0.62, 0.6],
            [0.45, 0.45, 0.44],
        ),
        stone: b.material(
            Class::Wall,
            stone,
            1.0,
            [0.42, 0.41, 0.4],
            [0.36, 0.36, 0.36],
        ),
        brick: b.material(
            Class::Wall,
            wall,
            2.5,
            [0.34, 0.17, 0.12],
            [0.42, 0.3, 0.24],
        ),
        plaster: b.material(
            Class::Wall,
            smooth,
            2.5,
            [0.6, 0.55, 0.42],
            [0.5, 0.48, 0.42],
        ),
        dark: b.material(
            Class::Wall,
            smooth,
            3.0,
            [0.05, 0.06, 0.08],
            [0.16, 0.17, 0.2],
        ),
        metal: b.material(
            Class::Obstacle,
            smooth,
            1.0,
            [0.12, 0.16, 0.14],
            [0.2, 0.2, 0.2],
        ),
        car: [
            b.material(
                Class::Obstacle,
                smooth,
                4.0,
                [0.32, 0.05, 0.05],
                [0.4, 0.1, 0.1],
            ),
            b.material(
                Class::Obstacle,
                smooth,
                4.0,
                [0.08, 0.12, 0.25],
                [0.12, 0.15, 0.3],
            ),
            b.material(
                Class::Obstacle,
                smooth,
                4.0,
                [0.55, 0.56, 0.57],
                [0.4, 0.4, 0.4],
            ),
        ],
        window: b.material(
            Class::Obstacle,
            smooth,
            8.0,
            [0.05, 0.06, 0.08],
            [0.07, 0.08, 0.1],
        ),
        bark: b.material(
            Class::Obstacle,
            asphalt,
            2.0,
            [0.16, 0.12, 0.09],
            [0.22, 0.18, 0.14],
        ),
        leaves: b.material(
            Class::Obstacle,
            green,
            4.0,
            [0.1, 0.17, 0.05],
            [0.2, 0.24, 0.08],
        ),
        grass: b.material(
            Class::Grass,
            green,
            1.5,
            [0.09, 0.15, 0.04],
            [0.2, 0.19, 0.09],
        ),
    }
}

/// Worn and settled: a few millimetres, slowly varying.
fn uneven(x: f64, y: f64) -> f64 {
    0.006 * libm::sin(0.9 * x + 0.4) * libm::cos(1.3 * y) + 0.003 * libm::sin(2.7 * x - 1.9 * y)
}

fn ground(b: &mut Builder, p: &Palette) {
    let [x0, x1] = LENGTH;
    let on = Builder::on_ground;
    // The road has a crown for the rain.
    let road = |x: f64, y: f64| {
        let across = (y - KERB) / (FAR_KERB - KERB);
        -KERB_HEIGHT + 0.08 * across * (1.0 - across) * 4.0 * 0.5 + 0.4 * uneven(x, y)
    };
    let pavement = |x: f64, y: f64| 0.5 * uneven(x, y);
    let (asphalt, paint) = (p.asphalt, p.paint);
    let striped = move |x: f64, y: f64| {
        let crossing = CROSSINGS.iter().any(|c| (c[0]..c[1]).contains(&x));
        let stripe = ((y - KERB - 0.2) / 0.5).rem_euclid(2.0) < 1.0;
        on(if crossing && stripe { paint } else { asphalt })
    };
    // Cells that end where stripes end.
    b.mesh
        .ground([x0, KERB], [x1, FAR_KERB], 0.2, road, striped);
    for (from, to) in [(HOUSE, KERB - 0.15), (FAR_KERB + 0.15, FAR_HOUSE)] {
        b.mesh
            .ground([x0, from], [x1, to], 0.25, pavement, |_, _| on(p.slabs));
    }
    // Kerb stones: top and face.
    for (inner, edge) in [(KERB - 0.15, KERB), (FAR_KERB + 0.15, FAR_KERB)] {
        let (low, high) = (inner.min(edge), inner.max(edge));
        b.mesh
            .ground([x0, low], [x1, high], 0.25, pavement, |_, _| on(p.kerb));
        let steps = ((x1 - x0) / 0.25).ceil() as usize;
        for i in 0..steps {
            let at = |k: usize| x0 + (x1 - x0) * k as f64 / steps as f64;
            let (xa, xb) = (at(i), at(i + 1));
            let top = |x: f64| Vector3::new(x, edge, pavement(x, edge));
            let foot = |x: f64| Vector3::new(x, edge, -KERB_HEIGHT - 0.05);
            let face = if edge > inner {
                // Faces the road, which lies at larger y.
                [foot(xb), foot(xa), top(xa), top(xb)]
            } else {
                [foot(xa), foot(xb), top(xb), top(xa)]
            };
            b.mesh.quad(face, [xa, 0.0], on(p.kerb));
        }
    }
    // Beyond the ends of the street, grass as far as one can see.
    for (from, to) in [([-60.0, -30.0], [x0, 45.0]), ([x1, -30.0], [80.0, 45.0])] {
        b.mesh
            .ground(from, to, 3.0, |_, _| -0.02, |_, _| on(p.grass));
    }
}

/// A row of house fronts with plinths, windows and doors, facing the street.
fn houses(b: &mut Builder, p: &Palette, y: f64, outwards: f64) {
    let mut x = LENGTH[0];
    while x < LENGTH[1] - 1.0 {
        let width = b.draw(5.0, 9.0).min(LENGTH[1] - x);
        let height = b.draw(5.5, 9.0);
        let wall = if b.draw(0.0, 1.0) < 0.5 {
            p.brick
        } else {
            p.plaster
        };
        let house = b.of_thing(wall);
        let depth = 0.6;
        let middle =
            |x: f64, w: f64, d: f64| Vector3::new(x + 0.5 * w, y + outwards * 0.5 * d, 0.0);
        b.standing_box(
            middle(x, width, depth),
            Vector3::new(width, depth, height),
            0.0,
            1.0,
            house,
        );
        // What stands proud of the wall: plinth, sills, frames.
        let proud = |b: &mut Builder, x: f64, z: f64, size: [f64; 3], material: u16| {
            let stuff = Stuff { material, ..house };
            let base = Vector3::new(x, y - outwards * 0.5 * size[1], z);
            b.standing_box(
                base,
                Vector3::new(size[0], size[1], size[2]),
                0.0,
                1.0,
                stuff,
            );
        };
        proud(b, x + 0.5 * width, 0.0, [width - 0.02, 0.05, 0.5], p.stone);
        let windows = (width / 1.8) as usize;
        for i in 0..windows {
            let at = x + (i as f64 + 0.5) * width / windows as f64;
            for floor in 0..2 {
                let sill = 1.0 + 2.8 * f64::from(floor);
                if floor == 0 && i == windows / 2 {
                    proud(b, at, 0.0, [1.0, 0.06, 2.1], p.dark);
                    continue;
                }
                proud(b, at, sill, [0.9, 0.03, 1.3], p.dark);
                proud(b, at, sill - 0.08, [1.1, 0.14, 0.08], p.stone);
                proud(b, at, sill + 0.62, [0.9, 0.05, 0.05], p.plaster);
                proud(b, at, sill, [0.05, 0.05, 1.3], p.plaster);
            }
        }
        x += width;
    }
}

/// Lamp posts, trees, bins, bollards. Returns the lamps.
fn furniture(b: &mut Builder, p: &Palette) -> Vec<Lamp> {
    let mut lamps = Vec::new();
    for (i, x) in [-10.0, -4.5, 3.0, 10.5, 18.5, 25.0].into_iter().enumerate() {
        let y = if i % 2 == 0 {
            KERB - 0.5
        } else {
            FAR_KERB + 0.5
        };
        let post = b.of_thing(p.metal);
        let foot = Vector3::new(x, y, -0.05);
        let head = Vector3::new(x, y, 4.2);
        b.mesh.tube([foot, head], [0.07, 0.05], 10, 0.7, post);
        b.standing_box(head, Vector3::new(0.5, 0.2, 0.1), 0.0, 1.0, post);
        lamps.push(Lamp {
            position: head - Vector3::z() * 0.1,
            strength: 0.06,
        });
    }
    for (x, y) in [
        (-8.0, KERB - 0.6),
        (6.5, KERB - 0.6),
        (22.0, KERB - 0.6),
        (1.0, FAR_KERB + 0.6),
        (9.0, FAR_KERB + 0.6),
    ] {
        let trunk = b.of_thing(p.bark);
        let lean = Vector3::new(b.draw(-0.2, 0.2), b.draw(-0.1, 0.1), 0.0);
        let foot = Vector3::new(x, y, -0.05);
        let fork = foot + lean + Vector3::z() * 2.6;
        b.mesh.tube([foot, fork], [0.16, 0.1], 10, 0.4, trunk);
        let crown = Stuff {
            material: p.leaves,
            ..trunk
        };
        for _ in 0..5 {
            let off = Vector3::new(b.draw(-0.7, 0.7), b.draw(-0.5, 0.5), b.draw(0.1, 1.2));
            b.lump(fork + off, Vector3::new(0.8, 0.7, 0.6), 7, 0.25, crown);
        }
    }
    for (x, y, yaw) in [
        (2.0, 0.45, 0.1),
        (9.5, 0.4, -0.2),
        (12.0, FAR_HOUSE - 0.4, 0.3),
        (5.0, FAR_HOUSE - 0.5, 0.0),
    ] {
        let bin = b.of_thing(p.metal);
        b.standing_box(
            Vector3::new(x, y, 0.0),
            Vector3::new(0.5, 0.45, 0.95),
            yaw,
            0.5,
            bin,
        );
    }
    for crossing in CROSSINGS {
        for x in crossing {
            for y in [KERB - 0.35, FAR_KERB + 0.35] {
                let bollard = b.of_thing(p.metal);
                let foot = Vector3::new(x, y, -0.02);
                b.mesh.tube(
                    [foot, foot + Vector3::z() * 0.9],
                    [0.06, 0.06],
                    10,
                    0.5,
                    bollard,
                );
            }
        }
    }
    lamps
}

fn cars(b: &mut Builder, p: &Palette) {
    for (i, (x, y)) in [
        (3.0, KERB + 1.0),
        (8.5, KERB + 1.05),
        (-9.0, KERB + 1.0),
        (6.0, FAR_KERB - 1.0),
        (21.5, KERB + 1.0),
        (11.0, FAR_KERB - 1.05),
    ]
    .into_iter()
    .enumerate()
    {
        let body = b.of_thing(p.car[i % 3]);
        let glass = Stuff {
            material: p.window,
            ..body
        };
        let base = Vector3::new(x, y, -KERB_HEIGHT + 0.25);
        b.standing_box(base, Vector3::new(4.2, 1.7, 0.6), 0.0, 0.7, body);
        b.standing_box(
            base + Vector3::z() * 0.6,
            Vector3::new(2.2, 1.5, 0.5),
            0.0,
            0.7,
            glass,
        );
        b.standing_box(
            base + Vector3::z() * 1.1,
            Vector3::new(2.1, 1.45, 0.06),
            0.0,
            0.7,
            body,
        );
        for (dx, dy) in [(-1.3, -0.8), (1.3, -0.8), (-1.3, 0.8), (1.3, 0.8)] {
            let hub = base + Vector3::new(dx, dy, 0.05);
            let half = Vector3::y() * 0.1;
            b.mesh
                .tube([hub - half, hub + half], [0.3, 0.3], 12, 0.3, glass);
        }
    }
}
