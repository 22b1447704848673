//! A long corridor with nearly blank walls, between a lobby and an open end.
//!
//! x runs along it. The walker keeps to the right, out through the open end and back, round in the
//! lobby, and out again. The paint has a contrast of a few percent, which is hard for stereo
//! matching and tracking.

use nalgebra::Vector3;

use super::build::{Builder, SceneParts};
use super::interior::{DoorStuff, Opening, Slab, THICK, Wall, ceiling_lamp};
use super::light::{Lamp, Lights};
use super::plants::{self, Greens};
use super::route::{Leg, Route, parts};
use super::surface::Class;

const LENGTH: f64 = 26.0;
const WIDTH: f64 = 2.4;
const HEIGHT: f64 = 2.6;
/// The lobby, in front of the corridor.
const LOBBY: [[f64; 2]; 2] = [[-4.6, -1.2], [-THICK, WIDTH + 1.2]];
/// Height of the passages at both ends.
const PASSAGE: f64 = 2.35;

/// Materials of the scene.
struct Palette {
    floor: u16,
    paint: u16,
    ceiling: u16,
    skirting: u16,
    lamp: u16,
    sign: u16,
    door: DoorStuff,
    board: u16,
    plate: u16,
    red: u16,
    wood: u16,
    greens: Greens,
    paving: u16,
    render: u16,
    grass: u16,
}

pub(super) fn build(b: &mut Builder) -> SceneParts {
    let palette = palette(b);
    let lamps = corridor(b, &palette);
    lobby(b, &palette);
    outside(b, &palette);
    let (out, home) = (0.7, WIDTH - 0.7);
    let middle = 0.5 * WIDTH;
    let points = vec![
        [1.0, out],
        [5.0, out + 0.05],
        [10.0, out - 0.05],
        [15.0, out],
        [20.0, out + 0.05],
        [24.0, out],
        [26.5, out],
        [28.0, out - 0.1],
        [29.0, middle],
        [28.0, home + 0.1],
        [26.5, home],
        [24.0, home],
        [20.0, home - 0.05],
        [15.0, home],
        [10.0, home + 0.05],
        [5.0, home],
        [1.0, home],
        [-1.2, home],
        [-2.6, home + 0.1],
        [-3.4, middle],
        [-2.6, out - 0.1],
        [-1.2, out],
    ];
    let cuts = parts(
        &points,
        &[
            [10.0, out],
            [27.0, out],
            [27.0, home],
            [7.0, home],
            [-1.2, home],
        ],
    );
    let walk = |part: usize, speed: f64| Leg::walk(cuts[part], speed);
    SceneParts {
        lights: Lights {
            sun: Vector3::new(0.3, -0.5, 0.8),
            low_sun: Vector3::new(0.97, 0.03, 0.16),
            lamps,
            indoors: true,
        },
        route: Route {
            legs: vec![
                walk(0, 1.35),
                Leg::Stand { seconds: 1.4 },
                walk(1, 1.25),
                walk(2, 0.7),
                walk(3, 2.5),
                walk(4, 1.2),
                Leg::Stumble,
                walk(5, 0.75),
            ],
            points,
            start_below: 1.5,
        },
    }
}

fn palette(b: &mut Builder) -> Palette {
    use super::palette::{
        CEILING, DOOR, GRASS, LAMP, LINO, PAINT, PAPERS, PLASTER, SLABS, VARNISH, WOOD,
    };
    let gray = VARNISH.dyed([0.2, 0.21, 0.23], [0.24, 0.24, 0.25]);
    let red = VARNISH.dyed([0.45, 0.04, 0.03], [0.5, 0.08, 0.06]);
    Palette {
        floor: LINO.of(Class::Pavement, b),
        paint: PAINT.of(Class::Wall, b),
        ceiling: CEILING.of(Class::Wall, b),
        skirting: gray.of(Class::Wall, b),
        lamp: LAMP.glowing(1.2).of(Class::Obstacle, b),
        sign: VARNISH
            .dyed([0.05, 0.5, 0.2], [0.3, 0.8, 0.5])
            .glowing(0.08)
            .of(Class::Obstacle, b),
        door: DoorStuff {
            leaf: DOOR
                .dyed([0.36, 0.25, 0.15], [0.28, 0.19, 0.11])
                .of(Class::Obstacle, b),
            frame: gray.of(Class::Wall, b),
            handle: VARNISH.dyed([0.45; 3], [0.35; 3]).of(Class::Obstacle, b),
        },
        board: PAPERS.of(Class::Obstacle, b),
        plate: VARNISH
            .dyed([0.6, 0.6, 0.58], [0.1, 0.15, 0.3])
            .of(Class::Obstacle, b),
        red: red.of(Class::Obstacle, b),
        wood: WOOD.of(Class::Obstacle, b),
        greens: Greens::new(b),
        paving: SLABS.of(Class::Pavement, b),
        render: PLASTER.of(Class::Wall, b),
        grass: GRASS.of(Class::Grass, b),
    }
}

/// Opening for a door that begins `along` m along a wall.
fn doorway(along: f64) -> Opening {
    Opening {
        along: [along, along + 0.9],
        up: [-1.0, 2.06],
    }
}

/// Floor, walls, doors and lamps. Returns the lamps.
fn corridor(b: &mut Builder, p: &Palette) -> Vec<Lamp> {
    let on = Builder::on_ground;
    // One floor for corridor and lobby; parts behind walls are not visible.
    let [from, to] = LOBBY;
    let floor = Slab {
        from,
        to: [LENGTH + THICK, to[1]],
        height: 0.0,
        is_ceiling: false,
    };
    floor.build(b, [&[-THICK, 0.0, LENGTH], &[0.0, WIDTH]], 0.4, on(p.floor));
    let ceiling = Slab {
        from: [-0.5 * THICK, 0.0],
        to: [LENGTH + 0.5 * THICK, WIDTH],
        height: HEIGHT,
        is_ceiling: true,
    };
    ceiling.build(b, [&[], &[]], 0.4, on(p.ceiling));
    // They end within the walls across, which have narrower passages.
    let (near, far) = (0.25 * THICK, LENGTH - 0.25 * THICK);
    let sides = [
        (
            Wall {
                from: [near, WIDTH],
                to: [far, WIDTH],
                height: HEIGHT,
            },
            [3.2, 9.0, 15.4, 20.8],
        ),
        (
            Wall {
                from: [far, 0.0],
                to: [near, 0.0],
                height: HEIGHT,
            },
            [2.4, 8.3, 12.0, 21.5],
        ),
    ];
    for (wall, doors) in &sides {
        let doors = doors.map(doorway);
        wall.build(b, &doors, 0.4, on(p.paint));
        wall.skirting(b, &doors, 0.06, on(p.skirting));
        for door in &doors {
            wall.door(b, door, p.door);
            // A sign beside it.
            let sign = b.of_thing(p.plate);
            let along = door.along[1] + 0.2;
            wall.block(b, [along, along + 0.16], [1.5, 1.62], [0.0, 0.008], sign);
        }
    }
    let (north, south) = (&sides[0].0, &sides[1].0);
    let board = b.of_thing(p.board);
    north.block(b, [6.0, 7.4], [1.1, 2.0], [0.0, 0.025], board);
    let bottle = b.of_thing(p.red);
    let at = |up: f64| south.at(6.1, up, 0.1);
    b.mesh
        .tube([at(0.5), at(0.98)], [0.07, 0.06], 12, 0.3, bottle);
    south.block(b, [6.06, 6.14], [0.8, 0.84], [0.0, 0.09], bottle);
    // Exit sign.
    let sign = b.of_thing(p.sign);
    let hung = Vector3::new(LENGTH - 1.2, 0.5 * WIDTH, HEIGHT - 0.3);
    b.standing_box(hung, Vector3::new(0.03, 0.36, 0.18), 0.0, 0.4, sign);
    let wires = b.of_thing(p.door.handle);
    for y in [-0.14, 0.14] {
        let top = hung + Vector3::new(0.0, y, 0.31);
        b.mesh
            .tube([top - Vector3::z() * 0.14, top], [0.004; 2], 6, 1.0, wires);
    }
    let lamp = |b: &mut Builder, x: f64, y: f64| {
        let ceiling = Vector3::new(x, y, HEIGHT);
        ceiling_lamp(b, ceiling, [1.2, 0.16], 0.05, p.lamp)
    };
    let mut lamps: Vec<Lamp> = (0..8)
        .map(|i| lamp(b, 1.6 + 3.2 * f64::from(i), 0.5 * WIDTH))
        .collect();
    lamps.push(lamp(b, -2.4, 0.2));
    lamps.push(lamp(b, -2.4, WIDTH - 0.2));
    lamps
}

fn lobby(b: &mut Builder, p: &Palette) {
    let on = Builder::on_ground;
    let [[west, south], [east, north]] = LOBBY;
    let wall = |from: [f64; 2], to: [f64; 2]| Wall {
        from,
        to,
        height: HEIGHT,
    };
    let ceiling = Slab {
        from: LOBBY[0],
        to: LOBBY[1],
        height: HEIGHT,
        is_ceiling: true,
    };
    ceiling.build(b, [&[], &[]], 0.4, on(p.ceiling));
    let entrance = Opening {
        along: [north - WIDTH + 0.1, north - 0.1],
        up: [-1.0, PASSAGE],
    };
    let door = doorway(2.4);
    for (wall, openings) in [
        (wall([west, north], [east, north]), vec![]),
        (wall([east, north], [east, south]), vec![entrance]),
        (wall([east, south], [west, south]), vec![]),
        (wall([west, south], [west, north]), vec![door]),
    ] {
        wall.build(b, &openings, 0.4, on(p.paint));
        wall.skirting(b, &openings, 0.06, on(p.skirting));
    }
    let back = wall([west, south], [west, north]);
    back.door(b, &door, p.door);
    let board = b.of_thing(p.board);
    back.block(b, [0.5, 1.9], [1.2, 2.0], [0.0, 0.025], board);

    let bench = b.of_thing(p.wood);
    let side = wall([west, north], [east, north]);
    side.block(b, [0.9, 2.5], [0.4, 0.45], [0.06, 0.42], bench);
    for along in [1.1, 2.25] {
        side.block(b, [along, along + 0.06], [0.0, 0.4], [0.1, 0.38], bench);
    }
    let pot = b.of_thing(p.red);
    let foot = Vector3::new(west + 0.4, south + 0.4, 0.0);
    let rim = foot + Vector3::z() * 0.4;
    b.mesh.tube([foot, rim], [0.15, 0.2], 14, 0.2, pot);
    let leaves = b.of_thing(p.greens.leaves);
    plants::bush(b, leaves, rim, 0.6);
}

/// The house's front around the open end, the path before it, grass and a hedge.
fn outside(b: &mut Builder, p: &Palette) {
    let on = Builder::on_ground;
    let front = Wall {
        from: [LENGTH + THICK, -6.0],
        to: [LENGTH + THICK, WIDTH + 6.0],
        height: 5.0,
    };
    let passage = Opening {
        along: [6.1, 6.0 + WIDTH - 0.1],
        up: [-1.0, PASSAGE],
    };
    front.build(b, &[passage], 0.5, on(p.render));
    // A little lower than the threshold, and under it.
    let height = |x: f64, y: f64| -0.012 + 0.003 * libm::sin(0.9 * x) * libm::cos(1.3 * y);
    let edge = 34.0;
    b.mesh
        .ground([LENGTH, -6.0], [edge, 8.4], 0.35, height, |_, _| {
            on(p.paving)
        });
    for (from, to) in [
        ([edge, -30.0], [80.0, 32.0]),
        ([LENGTH + THICK, -30.0], [edge, -6.0]),
        ([LENGTH + THICK, 8.4], [edge, 32.0]),
    ] {
        b.mesh
            .ground(from, to, 2.5, |_, _| -0.03, |_, _| on(p.grass));
    }
    // Low enough that the sun comes over it.
    let ends = [-9.0, 11.5].map(|y| Vector3::new(36.0, y, 0.0));
    plants::hedge(b, p.greens.leaves, ends, 0.9);
    for [x, y] in [[44.0, -6.0], [47.0, 3.5], [43.0, 9.0]] {
        plants::street_tree(b, p.greens, Vector3::new(x, y, -0.05), 2.2);
    }
}
