//! A plain room with enough texture on its walls to track, for calibration boards; the boards are
//! added by [`super::Scene::with_boards`].

use nalgebra::Vector3;

use super::build::{Builder, SceneParts};
use super::interior::{DoorStuff, Opening, Slab, Wall, ceiling_lamp};
use super::light::Lights;
use super::mesh::Stuff;
use super::route::{Leg, Route};
use super::surface::Class;
use super::texture::Recipe;
use crate::targets::board::Board;

/// In x and y, from corner to corner; the rig starts at 0.
const FROM: [f64; 2] = [-2.6, -2.7];
const TO: [f64; 2] = [3.0, 2.7];
const HEIGHT: f64 = 2.7;

pub(super) fn build(b: &mut Builder) -> SceneParts {
    use super::palette::{CEILING, LAMP, LINO, PAPERS, STEEL, VARNISH, WALLPAPER, WHITE, WOOD};
    let on = Builder::on_ground;
    let (floor, paper, ceiling) = (
        LINO.of(Class::Pavement, b),
        WALLPAPER.of(Class::Wall, b),
        CEILING.of(Class::Wall, b),
    );
    let (white, wood, papers) = (
        WHITE.of(Class::Wall, b),
        WOOD.of(Class::Obstacle, b),
        PAPERS.of(Class::Obstacle, b),
    );
    let door = DoorStuff {
        leaf: white,
        frame: white,
        handle: STEEL.of(Class::Obstacle, b),
    };
    let boxes = [[0.1, 0.2, 0.35], [0.4, 0.1, 0.08], [0.35, 0.33, 0.2]].map(|color| {
        VARNISH
            .dyed(color, color.map(|c| 0.7 * c))
            .of(Class::Obstacle, b)
    });
    let slab = |height: f64, is_ceiling: bool| Slab {
        from: FROM,
        to: TO,
        height,
        is_ceiling,
    };
    slab(0.0, false).build(b, [&[], &[]], 0.35, on(floor));
    slab(HEIGHT, true).build(b, [&[], &[]], 0.4, on(ceiling));
    let ([x0, y0], [x1, y1]) = (FROM, TO);
    let wall = |from: [f64; 2], to: [f64; 2]| Wall {
        from,
        to,
        height: HEIGHT,
    };
    let hole = Opening {
        along: [1.2, 2.1],
        up: [-1.0, 2.06],
    };
    let walls = [
        wall([x0, y1], [x1, y1]),
        wall([x1, y1], [x1, y0]),
        wall([x1, y0], [x0, y0]),
        wall([x0, y0], [x0, y1]),
    ];
    for (k, wall) in walls.iter().enumerate() {
        let openings: &[Opening] = if k == 3 { &[hole] } else { &[] };
        wall.build(b, openings, 0.4, on(paper));
        wall.skirting(b, openings, 0.06, on(white));
        if k == 3 {
            wall.door(b, &hole, door);
            continue;
        }
        // A pin board, and boxes along the wall.
        let left = b.draw(0.5, 1.5);
        let board = b.of_thing(papers);
        wall.block(b, [left, left + 1.6], [1.0, 2.1], [0.0, 0.02], board);
        let mut along = b.draw(0.2, 0.6);
        while along < wall.length() - 0.9 {
            let (wide, high) = (b.draw(0.25, 0.6), b.draw(0.2, 0.7));
            let color = boxes[b.draw(0.0, 2.999) as usize];
            let thing: Stuff = b.of_thing(color);
            wall.block(b, [along, along + wide], [0.0, high], [0.05, 0.4], thing);
            along += wide + b.draw(0.1, 0.7);
        }
    }
    let table = b.of_thing(wood);
    let (at, size) = (Vector3::new(-2.0, 1.9, 0.71), Vector3::new(0.8, 1.2, 0.04));
    b.standing_box(at, size, 0.0, 0.3, table);
    let glowing = LAMP.glowing(1.0).of(Class::Obstacle, b);
    let mut lamps = Vec::new();
    for x in [-1.2, 0.5, 2.0] {
        for y in [-1.5, 0.0, 1.5] {
            let ceiling = Vector3::new(x, y, HEIGHT);
            lamps.push(ceiling_lamp(b, ceiling, [0.6, 0.2], 0.06, glowing));
        }
    }
    SceneParts {
        lights: Lights {
            sun: Vector3::new(0.6, -0.3, 0.7),
            low_sun: Vector3::new(0.95, -0.1, 0.22),
            lamps,
            indoors: true,
        },
        route: Route {
            points: vec![[0.3, 0.3], [-0.3, 0.3], [-0.3, -0.3], [0.3, -0.3]],
            start_below: 1.5,
            legs: vec![Leg::Stand { seconds: 1.0 }],
        },
    }
}

/// Adds boards to a room. The print has no grain, which would blur the edges of cells.
pub(super) fn stand(b: &mut Builder, boards: &[Board]) {
    if boards.is_empty() {
        return;
    }
    let even = b.texture(&Recipe {
        radius: [20.0, 100.0],
        contrast: 0.0,
        grain: 0.0,
        mixed: 0.0,
        stretch: 1.0,
    });
    let black = b.material(Class::Obstacle, even, 40.0, [0.04; 3], [0.04; 3]);
    let white = b.material(Class::Obstacle, even, 40.0, [0.75; 3], [0.75; 3]);
    let gray = b.material(Class::Obstacle, even, 40.0, [0.25; 3], [0.25; 3]);
    for board in boards {
        let instance = b.thing();
        let of = |material: u16| Stuff { material, instance };
        board.draw(&mut b.mesh, [of(black), of(white)], of(gray));
    }
}
