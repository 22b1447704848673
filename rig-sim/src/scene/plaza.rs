//! A paved square with house fronts all round, a fountain, planters and benches, and people who walk about.
//!
//! x runs along the longer side. The walker goes round the square; people come towards the walker and
//! walk ahead on loops just inside and outside of that, others cross the view in the middle. No
//! loop meets another or the walker's, so nobody bumps into anybody.

use nalgebra::Vector3;

use super::build::{Backdrop, Builder, Made};
use super::light::Lights;
use super::people::shape::Wardrobe;
use super::people::{self, Stroll};
use super::route::{Leg, Route};
use super::surface::Class;
use super::texture::Recipe;

mod fronts;
mod furniture;

/// Half the sides of the square, m.
const HALF: [f64; 2] = [17.0, 13.0];
/// Half the sides of the walker's round, before its corners are rounded, m.
const ROUND: [f64; 2] = [11.5, 7.6];
/// Width of the streets that leave at two corners, m.
const STREET_M: f64 = 3.5;
const FOUNTAIN: [f64; 2] = [-3.8, 0.0];

/// What is where.
struct Palette {
    slabs: [u16; 3],
    street: u16,
    walls: [u16; 3],
    trim: u16,
    pane: u16,
    door: u16,
    awning: [u16; 2],
    stone: u16,
    water: u16,
    wood: u16,
    metal: u16,
    bark: u16,
    leaves: u16,
    flowers: u16,
}

pub(super) fn build(b: &mut Builder) -> Made {
    let p = palette(b);
    ground(b, &p);
    fronts::build(b, &p);
    furniture::fountain(b, &p);
    let lamps = furniture::lamps(b, &p);
    furniture::seats_and_planters(b, &p);
    furniture::trees(b, &p);
    crowd(b);
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
            sun: Vector3::new(-0.35, 0.45, 0.8),
            low_sun: Vector3::new(-0.9, -0.25, 0.42),
            lamps,
            indoors: false,
        },
        sky: Backdrop { texture: clouds },
        route: Route {
            points: round(ROUND, 0.0),
            start_below: 1.5,
            legs: vec![
                walk(16.0, 1.3),
                Leg::Stand { seconds: 2.0 },
                walk(14.0, 1.1),
                walk(12.0, 1.5),
                Leg::Stumble,
                walk(9.0, 1.2),
                walk(10.0, 2.4),
            ],
        },
    }
}

/// Control points of a rectangle with rounded corners, counter-clockwise, `outwards` m outside of the one
/// with these half sides.
fn round([x, y]: [f64; 2], outwards: f64) -> Vec<[f64; 2]> {
    let (x, y, o) = (x, y, outwards);
    // The straight parts move as a whole, and so the loops stay apart in the corners too.
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

fn palette(b: &mut Builder) -> Palette {
    let recipe = |radius: [f32; 2], contrast: f32, grain: f32, mixed: f32, stretch: f32| Recipe {
        radius,
        contrast,
        grain,
        mixed,
        stretch,
    };
    let stone = b.texture(&recipe([1.5, 140.0], 0.26, 0.12, 0.35, 1.0));
    let plaster = b.texture(&recipe([2.0, 220.0], 0.2, 0.07, 0.35, 1.3));
    let brick = b.texture(&recipe([2.0, 60.0], 0.32, 0.08, 0.45, 2.2));
    let smooth = b.texture(&recipe([4.0, 300.0], 0.15, 0.04, 0.3, 1.0));
    let grain = b.texture(&recipe([1.5, 60.0], 0.35, 0.1, 0.4, 5.0));
    let green = b.texture(&recipe([2.0, 40.0], 0.45, 0.1, 0.5, 1.8));
    Palette {
        slabs: [
            b.material(
                Class::Pavement,
                stone,
                1.5,
                [0.36, 0.33, 0.29],
                [0.29, 0.28, 0.27],
            ),
            b.material(
                Class::Pavement,
                stone,
                1.5,
                [0.4, 0.37, 0.33],
                [0.33, 0.31, 0.29],
            ),
            b.material(
                Class::Pavement,
                stone,
                1.1,
                [0.19, 0.185, 0.18],
                [0.24, 0.22, 0.21],
            ),
        ],
        street: b.material(
            Class::Pavement,
            stone,
            2.0,
            [0.27, 0.26, 0.25],
            [0.22, 0.22, 0.22],
        ),
        walls: [
            b.material(
                Class::Wall,
                plaster,
                2.5,
                [0.58, 0.45, 0.28],
                [0.5, 0.41, 0.3],
            ),
            b.material(
                Class::Wall,
                brick,
                2.2,
                [0.36, 0.19, 0.13],
                [0.43, 0.29, 0.22],
            ),
            b.material(
                Class::Wall,
                plaster,
                2.5,
                [0.55, 0.54, 0.5],
                [0.45, 0.45, 0.44],
            ),
        ],
        trim: b.material(
            Class::Wall,
            stone,
            1.5,
            [0.5, 0.48, 0.43],
            [0.42, 0.4, 0.37],
        ),
        pane: b.material(
            Class::Wall,
            smooth,
            3.0,
            [0.05, 0.06, 0.08],
            [0.16, 0.17, 0.2],
        ),
        door: b.material(
            Class::Wall,
            grain,
            1.5,
            [0.16, 0.1, 0.06],
            [0.1, 0.07, 0.05],
        ),
        awning: [
            b.material(
                Class::Obstacle,
                smooth,
                2.0,
                [0.45, 0.09, 0.08],
                [0.38, 0.08, 0.07],
            ),
            b.material(
                Class::Obstacle,
                smooth,
                2.0,
                [0.1, 0.22, 0.16],
                [0.13, 0.26, 0.2],
            ),
        ],
        stone: b.material(
            Class::Obstacle,
            stone,
            1.2,
            [0.42, 0.41, 0.38],
            [0.34, 0.33, 0.31],
        ),
        water: b.material(
            Class::Obstacle,
            smooth,
            1.0,
            [0.07, 0.12, 0.13],
            [0.16, 0.22, 0.23],
        ),
        wood: b.material(
            Class::Obstacle,
            grain,
            1.0,
            [0.32, 0.2, 0.11],
            [0.24, 0.15, 0.09],
        ),
        metal: b.material(
            Class::Obstacle,
            smooth,
            1.0,
            [0.08, 0.09, 0.09],
            [0.14, 0.14, 0.14],
        ),
        bark: b.material(
            Class::Obstacle,
            grain,
            1.8,
            [0.22, 0.19, 0.15],
            [0.15, 0.12, 0.09],
        ),
        leaves: b.material(
            Class::Obstacle,
            green,
            4.0,
            [0.09, 0.16, 0.05],
            [0.18, 0.23, 0.08],
        ),
        flowers: b.material(
            Class::Obstacle,
            green,
            1.5,
            [0.11, 0.18, 0.06],
            [0.42, 0.16, 0.2],
        ),
    }
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
            return on(p.slabs[2]);
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
        b.mesh
            .ground(from, to, 2.5, |_, _| 0.0, |_, _| on(p.street));
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
    // The same way as the walker, slower.
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
