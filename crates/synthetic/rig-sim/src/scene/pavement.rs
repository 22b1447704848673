//! A street: houses, pavement, kerb, road with a crosswalk, and the same on the other side.
//!
//! x runs along the street, y across it. The walker follows one pavement, crosses the crosswalk,
//! returns on the other pavement, and crosses the road again.

use nalgebra::Vector3;

use super::build::{Builder, SceneParts};
use super::front::{self, Row, Style};
use super::light::{Lamp, Lights};
use super::palette;
use super::plants::{self, Greens};
use super::route::{Leg, Route};
use super::street;
use super::surface::Class;

const LENGTH: [f64; 2] = [-14.0, 30.0];
/// Across: house, pavement, road, pavement, house.
const HOUSE: f64 = 0.0;
const KERB: f64 = 3.4;
const FAR_KERB: f64 = 9.8;
const FAR_HOUSE: f64 = 13.2;
const KERB_HEIGHT: f64 = 0.12;
/// Crosswalks, along the street.
const CROSSINGS: [[f64; 2]; 2] = [[-3.0, 0.0], [14.0, 17.0]];
/// Trees on either side of the road.
const TREES: [[f64; 2]; 5] = [
    [-8.0, KERB - 0.75],
    [6.5, KERB - 0.75],
    [22.0, KERB - 0.75],
    [1.0, FAR_KERB + 0.75],
    [9.0, FAR_KERB + 0.75],
];

/// Materials of the scene.
struct Palette {
    slabs: u16,
    kerb: u16,
    asphalt: u16,
    /// Asphalt laid later, over pipes.
    patch: u16,
    paint: u16,
    grass: u16,
    earth: u16,
    greens: Greens,
    street: street::StreetMaterials,
    fronts: front::FrontMaterials,
}

pub(super) fn build(b: &mut Builder) -> SceneParts {
    let p = Palette {
        slabs: palette::SLABS.of(Class::Pavement, b),
        kerb: palette::KERB.of(Class::Pavement, b),
        asphalt: palette::ASPHALT.of(Class::Road, b),
        patch: palette::ASPHALT
            .dyed([0.065, 0.065, 0.07], [0.09, 0.09, 0.09])
            .of(Class::Road, b),
        paint: palette::ROAD_PAINT.of(Class::Crosswalk, b),
        grass: palette::GRASS.of(Class::Grass, b),
        earth: palette::EARTH.of(Class::Grass, b),
        greens: Greens::new(b),
        street: street::StreetMaterials::new(b),
        fronts: front::FrontMaterials::new(b),
    };
    ground(b, &p);
    houses(b, &p);
    let lamps = furniture(b, &p);
    cars(b, &p);
    litter(b, &p);
    let (near, far) = (1.7, FAR_HOUSE - 1.7);
    let (left, right) = (-1.5, 15.5);
    SceneParts {
        lights: Lights {
            sun: Vector3::new(0.4, 0.5, 0.9),
            low_sun: Vector3::new(0.95, 0.12, 0.17),
            lamps,
            indoors: false,
        },
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
                Leg::walk(12.0, 1.35),
                Leg::Stand { seconds: 1.6 },
                Leg::walk(14.0, 1.2),
                Leg::walk(12.0, 2.6),
                Leg::walk(8.0, 1.3),
                Leg::Stumble,
                Leg::walk(8.0, 1.1),
            ],
        },
    }
}

/// Worn and settled: a few millimetres, slowly varying.
fn uneven(x: f64, y: f64) -> f64 {
    0.006 * libm::sin(0.9 * x + 0.4) * libm::cos(1.3 * y) + 0.003 * libm::sin(2.7 * x - 1.9 * y)
}

fn pavement(x: f64, y: f64) -> f64 {
    0.5 * uneven(x, y)
}

/// The road has a crown for the rain.
fn road(x: f64, y: f64) -> f64 {
    let across = (y - KERB) / (FAR_KERB - KERB);
    -KERB_HEIGHT + 0.16 * across * (1.0 - across) + 0.4 * uneven(x, y)
}

/// Where the road was dug up: corners.
const PATCHES: [[[f64; 2]; 2]; 4] = [
    [[-14.0, 7.2], [2.0, 7.8]],
    [[1.4, 4.0], [2.0, 7.8]],
    [[10.2, 6.0], [12.2, 7.0]],
    [[17.4, 4.4], [30.0, 4.8]],
];

fn ground(b: &mut Builder, p: &Palette) {
    let [x0, x1] = LENGTH;
    let on = Builder::on_ground;
    let striped = |x: f64, y: f64| {
        let crossing = CROSSINGS.iter().any(|c| (c[0]..c[1]).contains(&x));
        let stripe = ((y - KERB - 0.2) / 0.5).rem_euclid(2.0) < 1.0;
        let dug_up = PATCHES
            .iter()
            .any(|[from, to]| (from[0]..to[0]).contains(&x) && (from[1]..to[1]).contains(&y));
        on(match (crossing && stripe, dug_up) {
            (true, _) => p.paint,
            (false, true) => p.patch,
            (false, false) => p.asphalt,
        })
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
            // u increases to the right for a viewer.
            let (face, u) = match edge > inner {
                true => ([foot(xb), foot(xa), top(xa), top(xb)], -xb),
                false => ([foot(xa), foot(xb), top(xb), top(xa)], xa),
            };
            b.mesh.quad(face, [u, 0.2], on(p.kerb));
        }
    }
    // Earth around the trees, in a frame.
    for [x, y] in TREES {
        let frame = b.of_thing(p.street.stone);
        for (dx, dy, size) in [
            (-0.5, 0.0, [0.06, 1.0, 0.06]),
            (0.5, 0.0, [0.06, 1.0, 0.06]),
            (0.0, -0.47, [0.94, 0.06, 0.06]),
            (0.0, 0.47, [0.94, 0.06, 0.06]),
        ] {
            let base = Vector3::new(x + dx, y + dy, -0.05);
            b.standing_box(base, Vector3::from(size), 0.0, 0.5, frame);
        }
        let earth = Vector3::new(0.94, 0.88, 0.055);
        b.standing_box(Vector3::new(x, y, -0.05), earth, 0.0, 0.3, on(p.earth));
    }
    // Beyond the ends of the street, grass to the horizon.
    for (from, to) in [([-60.0, -30.0], [x0, 45.0]), ([x1, -30.0], [80.0, 45.0])] {
        b.mesh
            .ground(from, to, 3.0, |_, _| -0.02, |_, _| on(p.grass));
    }
}

/// The two sides of the street, and what closes its ends.
fn houses(b: &mut Builder, p: &Palette) {
    let [x0, x1] = LENGTH;
    let style = Style {
        shops: 0.3,
        floors: [1, 2],
    };
    for (row, length) in [
        (Row::new([x0, HOUSE], 0.0), x1 - x0),
        (Row::new([x1, FAR_HOUSE], 2.0), x1 - x0),
        // Across the ends; far enough for a low sun to come over.
        (Row::new([x1 + 40.0, -12.0], 1.0), 38.0),
        (Row::new([x0 - 12.0, 22.0], -1.0), 30.0),
    ] {
        row.houses(b, &p.fronts, style, length);
    }
}

/// Lamp posts, trees, bins, bollards. Returns the lamps.
fn furniture(b: &mut Builder, p: &Palette) -> Vec<Lamp> {
    let mut lamps = Vec::new();
    for (i, x) in [-10.0, -4.5, 3.0, 10.5, 18.5, 25.0].into_iter().enumerate() {
        let y = match i % 2 == 0 {
            true => KERB - 0.5,
            false => FAR_KERB + 0.5,
        };
        lamps.push(p.street.lamp(b, Vector3::new(x, y, 0.0), 4.2));
    }
    for [x, y] in TREES {
        let foot = Vector3::new(x, y, -0.02);
        plants::street_tree(b, p.greens, foot, 3.0);
    }
    for (i, (x, y, yaw)) in [
        (2.0, 0.45, 0.1),
        (2.75, 0.5, -0.1),
        (9.5, 0.45, -0.2),
        (12.0, FAR_HOUSE - 0.45, 3.3),
        (5.0, FAR_HOUSE - 0.5, 3.1),
        (4.2, FAR_HOUSE - 0.45, 3.0),
    ]
    .into_iter()
    .enumerate()
    {
        p.street.bin(b, Vector3::new(x, y, 0.0), yaw, i);
    }
    for x in CROSSINGS.into_iter().flatten() {
        for y in [KERB - 0.35, FAR_KERB + 0.35] {
            p.street.bollard(b, Vector3::new(x, y, 0.0));
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
        (22.5, FAR_KERB - 1.0),
    ]
    .into_iter()
    .enumerate()
    {
        let half_turns = if y < 6.0 { 0.0 } else { 1.0 };
        let yaw = std::f64::consts::PI * half_turns + b.draw(-0.03, 0.03);
        let foot = Vector3::new(x, y, road(x, y));
        p.street.car(b, foot, yaw, i);
    }
}

/// Covers of drains, leaves under trees and along the kerb.
fn litter(b: &mut Builder, p: &Palette) {
    for (x, y) in [(4.4, 1.9), (12.6, 1.2), (7.2, FAR_HOUSE - 1.5)] {
        p.street.cover(b, Vector3::new(x, y, pavement(x, y)), true);
    }
    for (x, y) in [(-1.5, 5.6), (15.7, 8.0), (18.0, 6.0)] {
        p.street.cover(b, Vector3::new(x, y, road(x, y)), true);
    }
    for (x, y) in [(0.6, KERB + 0.3), (13.4, FAR_KERB - 0.3)] {
        p.street.cover(b, Vector3::new(x, y, road(x, y)), false);
    }
    for at in TREES {
        p.street.fallen_leaves(b, at, 2.6, 45, pavement);
    }
    for x in [-5.0, 5.0, 12.0, 19.0] {
        for y in [KERB + 0.25, FAR_KERB - 0.25] {
            p.street.fallen_leaves(b, [x, y], 0.22, 12, road);
        }
    }
    for x in [0.0, 3.0, 7.5, 10.0, 13.0] {
        let along = [x, b.draw(0.3, 0.6)];
        p.street.fallen_leaves(b, along, 0.28, 6, pavement);
    }
}
