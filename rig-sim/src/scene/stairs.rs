//! A staircase in a court: up, round a corner on the landing, down again, and back over the yard.
//!
//! The first flight rises along x, the second one falls along y. Both lie against house walls; towards the
//! yard they have cheeks with railings. Risers of 0.17 m and goings of 0.29 m fit a step of 0.63 m
//! (Blondel's rule; DIN 18065).

use nalgebra::Vector3;

use super::build::{Backdrop, Builder, Made};
use super::light::{Lamp, Lights};
use super::mesh::Stuff;
use super::route::{Leg, Route, parts};
use super::surface::Class;
use super::texture::Recipe;

const RISE: f64 = 0.17;
const GOING: f64 = 0.29;
/// Of a flight, the one up to the landing included.
const RISERS: usize = 11;
/// Width of the flights and of the landing.
const WIDTH: f64 = 2.0;
/// Where the landing begins, in x; its inner corner is at `(RUN, WIDTH)`.
const RUN: f64 = (RISERS - 1) as f64 * GOING;
const TOP: f64 = RISERS as f64 * RISE;
/// The house walls stand at y = 0 and x = EAST.
const EAST: f64 = RUN + WIDTH;
const YARD: [[f64; 2]; 2] = [[-9.0, 0.0], [EAST, 13.0]];

/// What is where.
struct Palette {
    slabs: u16,
    tread: u16,
    edge: u16,
    riser: u16,
    concrete: u16,
    brick: u16,
    plaster: u16,
    stone: u16,
    dark: u16,
    steel: u16,
    wood: u16,
    leaves: u16,
    grass: u16,
}

/// A flight that rises from the middle of its foot in a direction.
struct Flight {
    foot: Vector3<f64>,
    ahead: Vector3<f64>,
    /// The side that is open to the yard: 1 left, -1 right.
    open: f64,
}

pub(super) fn build(b: &mut Builder) -> Made {
    let palette = palette(b);
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
    let clouds = b.texture(&Recipe {
        radius: [12.0, 400.0],
        contrast: 0.35,
        grain: 0.0,
        mixed: 0.0,
        stretch: 2.0,
    });
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
    let walk = |part: usize, speed: f64| Leg::Walk {
        metres: cuts[part],
        speed,
    };
    Made {
        lights: Lights {
            sun: Vector3::new(-0.35, 0.55, 0.8),
            low_sun: Vector3::new(-0.95, 0.12, 0.17),
            lamps,
            indoors: false,
        },
        sky: Backdrop { texture: clouds },
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

fn palette(b: &mut Builder) -> Palette {
    let recipe = |radius: [f32; 2], contrast: f32, grain: f32, mixed: f32, stretch: f32| Recipe {
        radius,
        contrast,
        grain,
        mixed,
        stretch,
    };
    let granite = b.texture(&recipe([1.5, 60.0], 0.3, 0.15, 0.35, 1.0));
    let poured = b.texture(&recipe([2.0, 240.0], 0.16, 0.08, 0.3, 1.0));
    let wall = b.texture(&recipe([1.5, 48.0], 0.3, 0.1, 0.4, 2.5));
    let smooth = b.texture(&recipe([4.0, 300.0], 0.15, 0.04, 0.3, 1.0));
    let green = b.texture(&recipe([2.0, 40.0], 0.45, 0.1, 0.5, 2.5));
    Palette {
        slabs: b.material(
            Class::Pavement,
            granite,
            1.6,
            [0.3, 0.29, 0.28],
            [0.24, 0.24, 0.25],
        ),
        tread: b.material(
            Class::Stair,
            granite,
            1.0,
            [0.38, 0.37, 0.35],
            [0.3, 0.3, 0.31],
        ),
        edge: b.material(
            Class::Stair,
            granite,
            1.0,
            [0.16, 0.16, 0.17],
            [0.22, 0.22, 0.22],
        ),
        riser: b.material(
            Class::Stair,
            granite,
            1.0,
            [0.33, 0.32, 0.31],
            [0.26, 0.26, 0.27],
        ),
        concrete: b.material(
            Class::Wall,
            poured,
            1.5,
            [0.42, 0.41, 0.39],
            [0.34, 0.33, 0.32],
        ),
        brick: b.material(
            Class::Wall,
            wall,
            2.5,
            [0.33, 0.17, 0.12],
            [0.4, 0.28, 0.22],
        ),
        plaster: b.material(
            Class::Wall,
            smooth,
            1.3,
            [0.58, 0.54, 0.44],
            [0.5, 0.47, 0.4],
        ),
        stone: b.material(
            Class::Wall,
            poured,
            1.5,
            [0.5, 0.49, 0.46],
            [0.42, 0.41, 0.4],
        ),
        dark: b.material(
            Class::Wall,
            smooth,
            3.0,
            [0.05, 0.06, 0.08],
            [0.08, 0.09, 0.11],
        ),
        steel: b.material(
            Class::Obstacle,
            smooth,
            1.0,
            [0.2, 0.21, 0.22],
            [0.28, 0.28, 0.28],
        ),
        wood: b.material(
            Class::Obstacle,
            wall,
            1.0,
            [0.3, 0.19, 0.1],
            [0.22, 0.13, 0.07],
        ),
        leaves: b.material(
            Class::Obstacle,
            green,
            3.0,
            [0.09, 0.16, 0.05],
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
    // Windows with frames and sills; a plinth along the walls of the yard.
    let window = |b: &mut Builder, middle: Vector3<f64>, along: Vector3<f64>| {
        let yaw = libm::atan2(along.y, along.x);
        let size = |w: f64, d: f64, h: f64| Vector3::new(w, d, h);
        let (pane, stone) = (b.of_thing(p.dark), Builder::on_ground(p.stone));
        let up = |z: f64| middle + Vector3::z() * z;
        b.standing_box(middle, size(0.95, 0.04, 1.35), yaw, 1.0, pane);
        b.standing_box(up(-0.09), size(1.15, 0.2, 0.09), yaw, 1.2, stone);
        b.standing_box(up(1.35), size(1.15, 0.09, 0.14), yaw, 1.2, stone);
        b.standing_box(up(0.85), size(0.95, 0.09, 0.05), yaw, 1.0, stone);
        b.standing_box(middle, size(0.05, 0.1, 0.85), yaw, 1.0, stone);
    };
    for x in [-7.5, -5.4, -3.3, -1.2] {
        window(b, Vector3::new(x, 0.0, 1.1), Vector3::x());
    }
    for x in [-7.5, -5.4, -3.3, -1.2, 0.9, 3.0] {
        window(b, Vector3::new(x, 0.0, 3.9), Vector3::x());
        window(b, Vector3::new(x, north, 1.1), Vector3::x());
    }
    for y in [1.2, 3.4, 5.6, 7.8, 10.0] {
        window(b, Vector3::new(east, y, 3.5), Vector3::y());
    }
    for y in [7.4, 9.4, 11.4] {
        window(b, Vector3::new(east, y, 1.0), Vector3::y());
    }
    let plinth = b.of_thing(p.stone);
    b.standing_box(
        Vector3::new(0.5 * (west - 0.6), 0.0, -0.05),
        Vector3::new(-0.6 - west, 0.08, 0.5),
        0.0,
        0.6,
        plinth,
    );
}

/// The yard, and what stands in it. Returns the lamps.
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

    // A raised bed inside the round.
    let bed = b.of_thing(p.concrete);
    b.standing_box(
        Vector3::new(0.4, 4.2, -0.05),
        Vector3::new(2.2, 1.3, 0.5),
        0.0,
        0.4,
        bed,
    );
    for _ in 0..12 {
        let bush = b.of_thing(p.leaves);
        let at = Vector3::new(b.draw(-0.4, 1.2), b.draw(3.8, 4.6), b.draw(0.5, 0.75));
        b.lump(at, Vector3::new(0.34, 0.3, 0.3), 6, 0.25, bush);
    }
    let bench = b.of_thing(p.wood);
    b.standing_box(
        Vector3::new(0.4, 5.4, 0.41),
        Vector3::new(1.7, 0.4, 0.05),
        0.0,
        0.4,
        bench,
    );
    for x in [-0.3, 1.1] {
        let leg = Vector3::new(x, 5.4, -0.02);
        b.standing_box(leg, Vector3::new(0.08, 0.36, 0.43), 0.0, 0.4, bench);
    }
    for (x, y) in [
        (-6.5, 4.0),
        (-6.0, 9.5),
        (-14.0, 2.0),
        (-15.0, 10.0),
        (-11.0, 17.0),
    ] {
        let trunk = b.of_thing(p.wood);
        let foot = Vector3::new(x, y, -0.05);
        let fork = foot + Vector3::new(b.draw(-0.2, 0.2), b.draw(-0.2, 0.2), 2.5);
        b.mesh.tube([foot, fork], [0.15, 0.1], 10, 0.4, trunk);
        let crown = Stuff {
            material: p.leaves,
            ..trunk
        };
        for _ in 0..5 {
            let off = Vector3::new(b.draw(-0.7, 0.7), b.draw(-0.7, 0.7), b.draw(0.1, 1.2));
            b.lump(fork + off, Vector3::new(0.8, 0.8, 0.6), 7, 0.25, crown);
        }
    }
    let mut lamps = Vec::new();
    for (x, y) in [(-1.2, 8.6), (-4.2, 2.6)] {
        let post = b.of_thing(p.steel);
        let head = Vector3::new(x, y, 3.8);
        let foot = Vector3::new(x, y, -0.05);
        b.mesh.tube([foot, head], [0.06, 0.045], 10, 0.7, post);
        b.standing_box(head, Vector3::new(0.4, 0.4, 0.1), 0.0, 1.0, post);
        lamps.push(Lamp {
            position: head - Vector3::z() * 0.1,
            strength: 0.06,
        });
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
