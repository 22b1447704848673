//! A staircase in a court: up, around a corner on the landing, down again, and back over the yard.
//!
//! The first flight rises along x, the second one falls along y. Both lie against house walls;
//! towards the yard they have cheeks with railings. Risers of 0.17 m and goings of 0.29 m fit a
//! step of 0.63 m (Blondel's rule; DIN 18065).

use nalgebra::Vector3;

use super::build::{Builder, SceneParts};
use super::front::{self, Row, Window};
use super::light::{Lamp, Lights};
use super::mesh::Stuff;
use super::plants::{self, Greens};
use super::route::{Leg, Route, parts};
use super::street;
use super::surface::Class;

const RISE: f64 = 0.17;
const GOING: f64 = 0.29;
/// Risers of a flight, including the last one up to the landing.
const RISERS: usize = 11;
/// Width of the flights and of the landing.
const WIDTH: f64 = 2.0;
/// Where the landing begins, in x; its inner corner is at `(RUN, WIDTH)`.
const RUN: f64 = (RISERS - 1) as f64 * GOING;
const TOP: f64 = RISERS as f64 * RISE;
/// The house walls stand at y = 0 and x = EAST.
const EAST: f64 = RUN + WIDTH;
const YARD: [[f64; 2]; 2] = [[-9.0, 0.0], [EAST, 13.0]];

/// Materials of the scene.
struct Palette {
    slabs: u16,
    tread: u16,
    edge: u16,
    riser: u16,
    concrete: u16,
    brick: u16,
    plaster: u16,
    steel: u16,
    wood: u16,
    grass: u16,
    greens: Greens,
    street: street::StreetMaterials,
    fronts: front::FrontMaterials,
}

/// A flight that rises from the middle of its foot in a direction.
struct Flight {
    foot: Vector3<f64>,
    ahead: Vector3<f64>,
    /// The side that is open to the yard: 1 left, -1 right.
    open: f64,
}

pub(super) fn build(b: &mut Builder) -> SceneParts {
    use super::palette::{BRICK, CONCRETE, GRANITE, GRASS, PLASTER, SLABS, STEEL, WOOD};
    let palette = Palette {
        slabs: SLABS.of(Class::Pavement, b),
        tread: GRANITE.of(Class::Stair, b),
        edge: GRANITE
            .dyed([0.16, 0.16, 0.17], [0.22, 0.22, 0.22])
            .of(Class::Stair, b),
        riser: GRANITE
            .dyed([0.33, 0.32, 0.31], [0.26, 0.26, 0.27])
            .of(Class::Stair, b),
        concrete: CONCRETE.of(Class::Wall, b),
        brick: BRICK.of(Class::Wall, b),
        plaster: PLASTER.of(Class::Wall, b),
        steel: STEEL.of(Class::Obstacle, b),
        wood: WOOD.of(Class::Obstacle, b),
        grass: GRASS.of(Class::Grass, b),
        greens: Greens::new(b),
        street: street::StreetMaterials::new(b),
        fronts: front::FrontMaterials::new(b),
    };
    let flights = [
        Flight {
            foot: Vector3::new(0.0, 0.5 * WIDTH, 0.0),
            ahead: Vector3::x(),
            open: 1.0,
        },
        Flight {
            foot: Vector3::new(RUN + 0.5 * WIDTH, WIDTH + RUN, 0.0),
            ahead: -Vector3::y(),
            open: -1.0,
        },
    ];
    for flight in &flights {
        steps(b, &palette, flight);
        railings(b, &palette, flight);
    }
    landing(b, &palette);
    houses(b, &palette);
    let lamps = yard(b, &palette);
    let mid = 0.5 * WIDTH;
    let right = RUN + mid;
    let points = vec![
        [-2.7, 3.4],
        [-2.5, 2.1],
        [-1.9, 1.2],
        [-1.0, mid],
        [0.0, mid],
        [1.0, mid],
        [2.0, mid],
        [RUN - 0.2, mid],
        [right - 0.5, mid],
        [right - 0.05, mid + 0.1],
        [right, mid + 0.7],
        [right, WIDTH + 0.4],
        [right, 3.4],
        [right, 4.4],
        [right, 5.6],
        [right - 0.2, 6.7],
        [2.6, 7.3],
        [1.0, 7.3],
        [-0.8, 7.1],
        [-2.2, 6.3],
        [-2.7, 5.0],
    ];
    let cuts = parts(
        &points,
        &[
            [-0.5, mid],
            [RUN + 0.2, mid],
            [right, WIDTH - 0.5],
            [right, WIDTH + RUN + 0.1],
            [-2.0, 6.5],
        ],
    );
    let walk = |part: usize, speed: f64| Leg::walk(cuts[part], speed);
    SceneParts {
        lights: Lights {
            sun: Vector3::new(-0.35, 0.55, 0.8),
            low_sun: Vector3::new(-0.95, 0.12, 0.17),
            lamps,
            indoors: false,
        },
        route: Route {
            legs: vec![
                walk(0, 1.1),
                walk(1, 0.5),
                walk(2, 0.6),
                walk(3, 0.5),
                walk(4, 1.3),
                Leg::Stand { seconds: 1.2 },
                walk(5, 1.2),
            ],
            points,
            start_below: 1.5,
        },
    }
}

impl Flight {
    /// The point `s` ahead of the foot, `left` of the middle, at a height.
    fn at(&self, s: f64, left: f64, height: f64) -> Vector3<f64> {
        self.foot + self.ahead * s + Vector3::z().cross(&self.ahead) * left + Vector3::z() * height
    }

    /// Height of the line through the edges of the steps.
    fn nosing(s: f64) -> f64 {
        RISE + s * RISE / GOING
    }
}

fn steps(b: &mut Builder, p: &Palette, flight: &Flight) {
    // Cells across agree on all faces, so that edges are shared.
    const CELL: f64 = 0.3;
    const EDGE: f64 = 0.04;
    let half = 0.5 * WIDTH;
    let band = |s: [f64; 2], z: [f64; 2]| {
        [
            flight.at(s[0], half, z[0]),
            flight.at(s[0], -half, z[0]),
            flight.at(s[1], -half, z[1]),
            flight.at(s[1], half, z[1]),
        ]
    };
    let on = Builder::on_ground;
    for k in 0..RISERS {
        let (s, top) = (k as f64 * GOING, (k + 1) as f64 * RISE);
        let foot = if k == 0 { -0.05 } else { top - RISE };
        let uv = [0.31 * k as f64, 0.0];
        b.mesh
            .tiled_quad(band([s, s], [foot, top]), uv, CELL, on(p.riser));
        if k + 1 < RISERS {
            let (mid, end) = (s + EDGE, s + GOING);
            b.mesh
                .tiled_quad(band([s, mid], [top; 2]), uv, CELL, on(p.edge));
            b.mesh
                .tiled_quad(band([mid, end], [top; 2]), uv, CELL, on(p.tread));
        }
    }
}

/// The cheek with its railing on the side of the yard, a rail on the wall on the other.
fn railings(b: &mut Builder, p: &Palette, flight: &Flight) {
    let half = 0.5 * WIDTH;
    let (near, far) = (-0.12, RUN + 0.02);
    let cheek = b.of_thing(p.concrete);
    let edges = match flight.open > 0.0 {
        true => [half + 0.2, half],
        false => [-half, -half - 0.2],
    };
    // Counter-clockwise from above.
    let outline = |z: [f64; 2]| {
        [
            flight.at(near, edges[0], z[0]),
            flight.at(near, edges[1], z[0]),
            flight.at(far, edges[1], z[1]),
            flight.at(far, edges[0], z[1]),
        ]
    };
    let tops = [near, far].map(|s| Flight::nosing(s) + 0.1);
    b.mesh.prism(outline([-0.1; 2]), outline(tops), 0.35, cheek);

    let rail = b.of_thing(p.steel);
    let aside = flight.open * (half + 0.1);
    let over = |s: f64, up: f64| flight.at(s, aside, Flight::nosing(s) + up);
    let mut s = 0.05;
    while s < RUN - 0.1 {
        b.mesh
            .tube([over(s, 0.05), over(s, 0.92)], [0.02; 2], 8, 0.5, rail);
        s += 3.0 * GOING;
    }
    for (up, radius) in [(0.93, 0.024), (0.65, 0.011), (0.4, 0.011)] {
        b.mesh
            .tube([over(near, up), over(RUN, up)], [radius; 2], 8, 0.5, rail);
    }

    let rail = b.of_thing(p.wood);
    let aside = -flight.open * (half - 0.08);
    let over = |s: f64, left: f64, up: f64| flight.at(s, left, Flight::nosing(s) + up);
    let grip = [over(-0.2, aside, 0.9), over(RUN + 0.1, aside, 0.9)];
    b.mesh.tube(grip, [0.021; 2], 8, 0.5, rail);
    for k in 0..4 {
        let s = 0.2 + 0.8 * f64::from(k);
        let wall = -flight.open * (half + 0.01);
        b.mesh.tube(
            [over(s, aside, 0.88), over(s, wall, 0.86)],
            [0.008; 2],
            6,
            1.0,
            rail,
        );
    }
}

fn landing(b: &mut Builder, p: &Palette) {
    let at = |x: f64, y: f64| Vector3::new(x, y, TOP);
    let corners = [at(RUN, WIDTH), at(RUN, 0.0), at(EAST, 0.0), at(EAST, WIDTH)];
    let stuff = Builder::on_ground(p.tread);
    b.mesh.tiled_quad(corners, [5.0, 0.0], 0.3, stuff);
    // Where the cheeks meet.
    let pillar = b.of_thing(p.concrete);
    let base = Vector3::new(RUN - 0.1, WIDTH + 0.1, -0.1);
    b.standing_box(base, Vector3::new(0.24, 0.24, TOP + 1.2), 0.0, 0.4, pillar);
}

fn houses(b: &mut Builder, p: &Palette) {
    let [[west, _], [east, north]] = YARD;
    let south = b.of_thing(p.brick);
    let length = east + 0.6 - west;
    b.standing_box(
        Vector3::new(west + 0.5 * length, -0.3, -0.1),
        Vector3::new(length, 0.6, 6.1),
        0.0,
        0.6,
        south,
    );
    let house = b.of_thing(p.plaster);
    b.standing_box(
        Vector3::new(east + 0.3, 0.5 * north, -0.1),
        Vector3::new(0.6, north, 5.4),
        0.0,
        0.6,
        house,
    );
    let back = b.of_thing(p.plaster);
    b.standing_box(
        Vector3::new(west + 0.5 * length, north + 0.3, -0.1),
        Vector3::new(length, 0.6, 4.6),
        0.0,
        0.8,
        back,
    );
    // Windows along the walls, seen from the yard: west of the stairs, east, and across the yard.
    let (near, side, far) = (
        Row::new([0.0, 0.0], 0.0),
        Row::new([east, 0.0], 1.0),
        Row::new([0.0, north], 2.0),
    );
    let size = Window {
        width: 0.95,
        height: 1.35,
    };
    let mut windows = |row: &Row, wall: Stuff, up: f64, at: &[f64]| {
        for &along in at {
            row.window(b, &p.fronts, [along, up], size, wall);
        }
    };
    windows(&near, south, 1.1, &[-7.5, -5.4, -3.3, -1.2]);
    windows(&near, south, 3.9, &[-7.5, -5.4, -3.3, -1.2, 0.9, 3.0]);
    windows(&far, back, 1.1, &[7.5, 5.4, 3.3, 1.2, -0.9, -3.0]);
    windows(&side, house, 3.5, &[1.2, 3.4, 5.6, 7.8, 10.0]);
    windows(&side, house, 1.0, &[7.4, 9.4, 11.4]);
    let trim = |thing: Stuff| Stuff {
        material: p.fronts.trim,
        ..thing
    };
    let foot = -0.6 - west;
    let plinth = [foot, 0.06, 0.5];
    near.relief(b, [west + 0.5 * foot, -0.05], plinth, trim(south));
    let band = [length, 0.08, 0.16];
    near.relief(b, [west + 0.5 * length, 3.4], band, trim(south));
    far.relief(
        b,
        [-west - 0.5 * length, -0.05],
        [length, 0.06, 0.5],
        trim(back),
    );
}

/// The yard with its objects. Returns the lamps.
fn yard(b: &mut Builder, p: &Palette) -> Vec<Lamp> {
    let [from, to] = YARD;
    // Worn and settled by a few millimetres, but not at the foot of the stairs.
    let height = |x: f64, y: f64| {
        let calm = ((x * x + y * y).sqrt() / 4.0).min(1.0);
        0.004 * calm * libm::sin(0.8 * x + 0.3) * libm::cos(1.1 * y)
    };
    let slabs = Builder::on_ground(p.slabs);
    b.mesh.ground(from, to, 0.3, height, |_, _| slabs);
    let grass = Builder::on_ground(p.grass);
    b.mesh.ground(
        [-60.0, -30.0],
        [from[0], 45.0],
        3.0,
        |_, _| -0.02,
        |_, _| grass,
    );

    // A raised bed inside the loop.
    let bed = b.of_thing(p.concrete);
    b.standing_box(
        Vector3::new(0.4, 4.2, -0.05),
        Vector3::new(2.2, 1.3, 0.5),
        0.0,
        0.4,
        bed,
    );
    for k in 0..4 {
        let leaves = b.of_thing(p.greens.leaves);
        let foot = Vector3::new(-0.35 + 0.5 * f64::from(k), b.draw(4.05, 4.35), 0.35);
        plants::bush(b, leaves, foot, 0.8 + 0.05 * f64::from(k % 2));
    }
    p.street.bench(b, Vector3::new(0.4, 5.5, 0.0), 0.0);
    for [x, y] in [
        [-6.5, 4.0],
        [-6.0, 9.5],
        [-14.0, 2.0],
        [-15.0, 10.0],
        [-11.0, 17.0],
    ] {
        plants::street_tree(b, p.greens, Vector3::new(x, y, 0.0), 2.8);
        p.street.fallen_leaves(b, [x, y], 3.0, 40, height);
    }
    p.street.fallen_leaves(b, [-0.6, 2.6], 0.5, 14, height);
    for [x, y] in [[-1.8, 4.9], [2.0, 8.2]] {
        p.street.cover(b, Vector3::new(x, y, height(x, y)), true);
    }
    p.street.bin(b, Vector3::new(-3.2, 0.5, 0.0), 0.1, 0);
    p.street.bin(b, Vector3::new(-4.0, 0.5, 0.0), -0.1, 1);
    // The view beyond the open end.
    let hedge = [[-17.0, -4.0], [-17.0, 22.0]].map(|[x, y]| Vector3::new(x, y, 0.0));
    plants::hedge(b, p.greens.leaves, hedge, 1.6);
    let mut lamps = Vec::new();
    for (x, y) in [(-1.2, 8.6), (-4.2, 2.6)] {
        lamps.push(p.street.lamp(b, Vector3::new(x, y, 0.0), 3.8));
    }
    // On the wall above the landing.
    let body = b.of_thing(p.steel);
    let at = Vector3::new(EAST - 0.1, 0.5 * WIDTH, TOP + 2.3);
    b.standing_box(at, Vector3::new(0.2, 0.3, 0.12), 0.0, 1.0, body);
    lamps.push(Lamp {
        position: at + Vector3::new(-0.12, 0.0, -0.08),
        strength: 0.03,
    });
    lamps
}
