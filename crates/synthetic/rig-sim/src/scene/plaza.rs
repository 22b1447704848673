//! A paved square with house fronts all round, a fountain, planters and benches, and people who
//! walk about.
//!
//! x runs along the longer side. The walker goes around the square; people come towards the walker
//! and walk ahead on loops just inside and outside of that loop, others cross the view in the
//! middle. No loop meets another or the walker's, so there are no collisions.

use nalgebra::Vector3;

use super::build::{Builder, SceneParts};
use super::front::{self, Row, Style};
use super::light::Lights;
use super::palette;
use super::people::shape::Wardrobe;
use super::people::{self, Stroll};
use super::plants::Greens;
use super::route::{Leg, Route};
use super::street;
use super::surface::Class;

mod furniture;

/// Half the sides of the square, m.
const HALF: [f64; 2] = [17.0, 13.0];
/// Half the sides of the walker's loop, before its corners are rounded, m.
const ROUND: [f64; 2] = [11.5, 7.6];
/// Width of the streets that leave at two corners, m.
const STREET_M: f64 = 3.5;
const FOUNTAIN: [f64; 2] = [-3.8, 0.0];

/// Materials of the scene.
struct Palette {
    /// Two shades.
    slabs: [u16; 2],
    /// Bands between them, and the streets.
    setts: u16,
    stone: u16,
    water: u16,
    flowers: u16,
    greens: Greens,
    street: street::StreetMaterials,
    fronts: front::FrontMaterials,
}

pub(super) fn build(b: &mut Builder) -> SceneParts {
    let light = palette::SLABS.dyed([0.4, 0.37, 0.33], [0.16, 0.15, 0.13]);
    let p = Palette {
        slabs: [palette::SLABS, light].map(|finish| finish.of(Class::Pavement, b)),
        setts: palette::SETTS.of(Class::Pavement, b),
        stone: palette::STONES
            .dyed([0.42, 0.41, 0.38], [0.34, 0.33, 0.31])
            .of(Class::Obstacle, b),
        water: palette::PANE
            .dyed([0.06, 0.1, 0.11], [0.16, 0.22, 0.23])
            .of(Class::Obstacle, b),
        flowers: palette::LEAVES
            .dyed([0.11, 0.18, 0.06], [0.42, 0.16, 0.2])
            .of(Class::Obstacle, b),
        greens: Greens::new(b),
        street: street::StreetMaterials::new(b),
        fronts: front::FrontMaterials::new(b),
    };
    ground(b, &p);
    houses(b, &p);
    furniture::fountain(b, &p);
    let lamps = furniture::lamps(b, &p);
    furniture::seats_and_planters(b, &p);
    furniture::trees(b, &p);
    crowd(b);
    SceneParts {
        lights: Lights {
            sun: Vector3::new(-0.35, 0.45, 0.8),
            low_sun: Vector3::new(-0.9, -0.25, 0.42),
            lamps,
            indoors: false,
        },
        route: Route {
            points: round(ROUND, 0.0),
            start_below: 1.5,
            legs: vec![
                Leg::walk(16.0, 1.3),
                Leg::Stand { seconds: 2.0 },
                Leg::walk(14.0, 1.1),
                Leg::walk(12.0, 1.5),
                Leg::Stumble,
                Leg::walk(9.0, 1.2),
                Leg::walk(10.0, 2.4),
            ],
        },
    }
}

/// Control points of a rectangle with rounded corners, counter-clockwise, `outwards` m outside of
/// the one with these half sides.
fn round([x, y]: [f64; 2], outwards: f64) -> Vec<[f64; 2]> {
    let (x, y, o) = (x, y, outwards);
    // The straight parts are translated as a whole, so the loops keep their distance in the corners
    // too.
    let quarter = [
        [0.35 * x, -y - o],
        [x - 2.0, -y - o],
        [x + 0.8 * o, -y - 0.8 * o],
        [x + o, 2.0 - y],
        [x + o, 0.0],
    ];
    let mut points = quarter.to_vec();
    points.extend(quarter[..4].iter().rev().map(|q| [q[0], -q[1]]));
    let left: Vec<[f64; 2]> = points.iter().map(|q| [-q[0], -q[1]]).collect();
    points.extend(left);
    points
}

/// Worn and settled: a few millimetres, none at the edge of the square.
fn uneven(x: f64, y: f64) -> f64 {
    let inside = |v: f64, half: f64| (half - v.abs()).clamp(0.0, 1.0);
    let fade = inside(x, HALF[0]).min(inside(y, HALF[1]));
    fade * (0.003 * libm::sin(0.8 * x + 0.3) * libm::cos(1.1 * y)
        + 0.002 * libm::sin(2.3 * x - 1.7 * y))
}

fn ground(b: &mut Builder, p: &Palette) {
    let on = Builder::on_ground;
    let [w, h] = HALF;
    // Slabs of two shades at random, between bands of a darker stone.
    let shades: Vec<bool> = (0..4096).map(|_| b.draw(0.0, 1.0) < 0.5).collect();
    let slab = |x: f64, y: f64| {
        let (i, j) = (((x + w) / 0.4) as usize, ((y + h) / 0.4) as usize);
        if i % 11 == 5 || j % 11 == 5 {
            return on(p.setts);
        }
        on(p.slabs[usize::from(shades[(i / 2 + 61 * (j / 2)) % shades.len()])])
    };
    b.mesh.ground([-w, -h], [w, h], 0.4, uneven, slab);
    // The streets, and whatever lies behind the houses.
    let far = 60.0;
    for (from, to) in [
        ([-far, -far], [far, -h]),
        ([-far, h], [far, far]),
        ([-far, -h], [-w, h]),
        ([w, -h], [far, h]),
    ] {
        b.mesh.ground(from, to, 2.5, |_, _| 0.0, |_, _| on(p.setts));
    }
}

/// The fronts around the square, and along the streets that leave it.
fn houses(b: &mut Builder, p: &Palette) {
    let [w, h] = HALF;
    let style = Style {
        shops: 0.6,
        floors: [2, 3],
    };
    for (row, length) in [
        (Row::new([-w, -h], 0.0), 2.0 * w - STREET_M),
        (Row::new([w, -h], 1.0), 2.0 * h),
        (Row::new([w, h], 2.0), 2.0 * w - STREET_M),
        (Row::new([-w, h], 3.0), 2.0 * h),
        // The ends of the two streets, and their other sides.
        (
            Row::new([w - STREET_M - 2.0, -h - 14.0], 0.0),
            STREET_M + 4.0,
        ),
        (
            Row::new([STREET_M + 2.0 - w, h + 14.0], 2.0),
            STREET_M + 4.0,
        ),
        (Row::new([w, -h - 14.0], 1.0), 14.0),
        (Row::new([-w, h + 14.0], 3.0), 14.0),
    ] {
        row.houses(b, &p.fronts, style, length);
    }
}

/// The people, on loops that meet neither each other nor the walker's.
fn crowd(b: &mut Builder) {
    let wardrobe = Wardrobe::new(b);
    let mut on = |points: &[[f64; 2]], speed: f64, starts: &[f64]| {
        for &start in starts {
            let stroll = Stroll {
                points: points.to_vec(),
                start,
                speed,
            };
            people::add(b, &wardrobe, &stroll);
        }
    };
    // Towards the walker, close by.
    let mut inner = round(ROUND, -1.0);
    inner.reverse();
    on(&inner, 1.25, &[0.07, 0.36, 0.62, 0.85]);
    // In the walker's direction, slower.
    on(&round(ROUND, 1.1), 1.0, &[0.12, 0.4, 0.55, 0.78]);
    // To and fro in the middle, across the view.
    let oval = |x: f64, half: [f64; 2]| -> Vec<[f64; 2]> {
        [
            [-1.0, -0.6],
            [0.0, -1.2],
            [1.0, -0.6],
            [1.0, 0.6],
            [0.0, 1.2],
            [-1.0, 0.6],
        ]
        .map(|[u, v]| [x + half[0] * u, half[1] * v])
        .to_vec()
    };
    on(&oval(4.3, [1.6, 5.2]), 1.35, &[0.1, 0.58]);
    on(&oval(-8.4, [1.0, 4.6]), 1.15, &[0.3]);
}

#[cfg(test)]
mod tests;
