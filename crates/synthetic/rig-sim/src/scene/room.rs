//! A furnished room with panes, thin rails and thin legs, which are easily missed.
//!
//! The walker goes around a glass screen, a table and a guard rail in the middle, along furniture
//! at the walls. Rails are 2 to 4 cm thick.

use nalgebra::Vector3;

use super::build::{Builder, SceneParts};
use super::interior::{DoorStuff, Opening, Slab, Wall, ceiling_lamp};
use super::light::{Lamp, Lights};
use super::mesh::Stuff;
use super::plants::{self, Greens};
use super::route::{Leg, Route, parts};
use super::surface::Class;

/// In x and y, from the corner at 0.
const SIZE: [f64; 2] = [10.0, 7.0];
const HEIGHT: f64 = 2.7;

/// Materials of the scene.
struct Palette {
    parquet: u16,
    rug: u16,
    paper: u16,
    ceiling: u16,
    white: u16,
    wood: u16,
    steel: u16,
    cloth: [u16; 2],
    books: [u16; 4],
    door: DoorStuff,
    lamp: u16,
    greens: Greens,
    glass: u16,
    grass: u16,
}

pub(super) fn build(b: &mut Builder) -> SceneParts {
    let palette = palette(b);
    let lamps = shell(b, &palette);
    middle(b, &palette);
    along_the_walls(b, &palette);
    let points = vec![
        [1.9, 1.3],
        [3.2, 1.25],
        [4.6, 1.35],
        [6.0, 1.25],
        [7.4, 1.3],
        [8.5, 1.5],
        [8.75, 2.6],
        [8.7, 4.2],
        [8.5, 5.4],
        [7.4, 5.75],
        [6.0, 5.7],
        [4.6, 5.75],
        [3.2, 5.7],
        [1.9, 5.6],
        [1.35, 4.8],
        [1.3, 3.5],
        [1.35, 2.1],
    ];
    let cuts = parts(&points, &[[6.0, 1.3], [8.7, 3.5], [4.6, 5.7]]);
    let walk = |part: usize, speed: f64| Leg::walk(cuts[part], speed);
    SceneParts {
        lights: Lights {
            sun: Vector3::new(0.6, -0.3, 0.7),
            // Through the garden door.
            low_sun: Vector3::new(0.95, -0.1, 0.22),
            lamps,
            indoors: true,
        },
        route: Route {
            legs: vec![
                walk(0, 1.1),
                Leg::Stand { seconds: 1.5 },
                walk(1, 0.9),
                walk(2, 1.2),
                Leg::Stand { seconds: 1.0 },
                walk(3, 0.8),
            ],
            points,
            start_below: 1.5,
        },
    }
}

fn palette(b: &mut Builder) -> Palette {
    use super::palette::{
        CEILING, CLOTH, GRASS, LAMP, PARQUET, RUG, STEEL, VARNISH, WALLPAPER, WHITE, WOOD,
    };
    let book = |color: [f32; 3]| VARNISH.dyed(color, color.map(|c| 0.6 * c + 0.1));
    Palette {
        parquet: PARQUET.of(Class::Pavement, b),
        rug: RUG.of(Class::Pavement, b),
        paper: WALLPAPER.of(Class::Wall, b),
        ceiling: CEILING.of(Class::Wall, b),
        white: WHITE.of(Class::Wall, b),
        wood: WOOD
            .dyed([0.42, 0.28, 0.16], [0.34, 0.21, 0.11])
            .of(Class::Obstacle, b),
        steel: STEEL.of(Class::Obstacle, b),
        cloth: [
            CLOTH.dyed([0.12, 0.17, 0.24], [0.18, 0.22, 0.26]),
            CLOTH.dyed([0.42, 0.36, 0.26], [0.34, 0.3, 0.24]),
        ]
        .map(|finish| finish.of(Class::Obstacle, b)),
        books: [
            book([0.4, 0.08, 0.06]),
            book([0.08, 0.2, 0.35]),
            book([0.5, 0.45, 0.3]),
            book([0.08, 0.22, 0.12]),
        ]
        .map(|finish| finish.of(Class::Obstacle, b)),
        door: DoorStuff {
            leaf: WHITE.of(Class::Obstacle, b),
            frame: WHITE.of(Class::Wall, b),
            handle: STEEL.of(Class::Obstacle, b),
        },
        lamp: LAMP.glowing(1.0).of(Class::Obstacle, b),
        greens: Greens::new(b),
        // Reflections of a room in a pane are about as bright as a gray wall.
        glass: WALLPAPER
            .dyed([0.38, 0.42, 0.41], [0.38, 0.42, 0.41])
            .of(Class::Glass, b),
        grass: GRASS.of(Class::Grass, b),
    }
}

/// Floor, walls with windows, ceiling, lamps, and the garden. Returns the lamps.
fn shell(b: &mut Builder, p: &Palette) -> Vec<Lamp> {
    let on = Builder::on_ground;
    let [x, y] = SIZE;
    let slab = |height: f64, is_ceiling: bool| Slab {
        from: [0.0; 2],
        to: SIZE,
        height,
        is_ceiling,
    };
    slab(0.0, false).build(b, [&[], &[]], 0.35, on(p.parquet));
    slab(HEIGHT, true).build(b, [&[], &[]], 0.4, on(p.ceiling));
    let wall = |from: [f64; 2], to: [f64; 2]| Wall {
        from,
        to,
        height: HEIGHT,
    };
    let window = |along: f64| Opening {
        along: [along, along + 1.5],
        up: [0.9, 2.2],
    };
    let garden = Opening {
        along: [2.4, 4.6],
        up: [-1.0, 2.25],
    };
    let door = Opening {
        along: [4.8, 5.7],
        up: [-1.0, 2.06],
    };
    for (wall, openings) in [
        (wall([0.0, y], [x, y]), vec![window(1.6), window(5.4)]),
        (wall([x, y], [x, 0.0]), vec![garden]),
        (wall([x, 0.0], [0.0, 0.0]), vec![]),
        (wall([0.0, 0.0], [0.0, y]), vec![door]),
    ] {
        wall.build(b, &openings, 0.4, on(p.paper));
        wall.skirting(b, &openings, 0.06, on(p.white));
        for hole in &openings {
            match hole.along == door.along {
                true => wall.door(b, hole, p.door),
                false => glazed(b, p, &wall, hole),
            }
        }
    }
    // The threshold, and the garden.
    b.standing_box(
        Vector3::new(x + 0.13, y - 3.5, -0.1),
        Vector3::new(0.2, 2.19, 0.1),
        0.0,
        0.4,
        on(p.white),
    );
    for (from, to) in [
        ([x + 0.2, -20.0], [50.0, 30.0]),
        ([-20.0, y + 0.2], [x + 0.2, 30.0]),
    ] {
        b.mesh
            .ground(from, to, 1.5, |_, _| -0.06, |_, _| on(p.grass));
    }
    for ends in [[[17.0, -4.0], [17.0, 16.0]], [[-4.0, 12.5], [17.0, 12.5]]] {
        let ends = ends.map(|[x, y]| Vector3::new(x, y, -0.05));
        plants::hedge(b, p.greens.leaves, ends, 1.3);
    }
    for [x, y] in [[21.0, 1.0], [23.0, 6.5], [3.0, 17.0], [10.0, 19.0]] {
        plants::street_tree(b, p.greens, Vector3::new(x, y, -0.05), 2.4);
    }
    let mut lamps = Vec::new();
    for x in [2.2, 5.0, 7.8] {
        for y in [1.9, 5.1] {
            let ceiling = Vector3::new(x, y, HEIGHT);
            lamps.push(ceiling_lamp(b, ceiling, [0.5, 0.5], 0.05, p.lamp));
        }
    }
    lamps
}

/// A window or glass door: a frame of 5 cm with a bar across, and the pane.
fn glazed(b: &mut Builder, p: &Palette, wall: &Wall, hole: &Opening) {
    let [left, right] = hole.along;
    let (low, high) = (hole.up[0].max(0.0), hole.up[1]);
    let frame = b.of_thing(p.white);
    let out = [-0.13, -0.07];
    let bar = 0.05;
    let mid = 0.5 * (left + right);
    for along in [
        [left - 0.01, left + bar],
        [mid - 0.5 * bar, mid + 0.5 * bar],
        [right - bar, right + 0.01],
    ] {
        wall.block(b, along, [low, high + 0.01], out, frame);
    }
    for along in [
        [left + bar, mid - 0.5 * bar],
        [mid + 0.5 * bar, right - bar],
    ] {
        wall.block(b, along, [low, low + bar], out, frame);
        wall.block(b, along, [high - bar, high + 0.01], out, frame);
        let [x0, x1] = along;
        let (z0, z1) = (low + bar, high - bar);
        let corners = [(x0, z0), (x1, z0), (x1, z1), (x0, z1)];
        let pane = b.of_thing(p.glass);
        b.pane(corners.map(|(x, z)| wall.at(x, z, -0.1)), 0.4, pane);
    }
    if low > 0.0 {
        // The board over the sill.
        wall.block(
            b,
            [left - 0.04, right + 0.04],
            [low - 0.03, low + 0.002],
            [-0.07, 0.12],
            frame,
        );
    }
}

/// A thin rail.
fn rail(b: &mut Builder, ends: [Vector3<f64>; 2], diameter_m: f64, stuff: Stuff) {
    b.mesh.tube(ends, [0.5 * diameter_m; 2], 10, 0.5, stuff);
}

/// Table and chairs, the glass screen, the guard rail: inside the loop.
fn middle(b: &mut Builder, p: &Palette) {
    let rug = Builder::on_ground(p.rug);
    b.standing_box(
        Vector3::new(3.6, 3.5, -0.02),
        Vector3::new(2.6, 2.2, 0.028),
        0.0,
        0.4,
        rug,
    );

    let table = b.of_thing(p.wood);
    b.standing_box(
        Vector3::new(3.6, 3.5, 0.71),
        Vector3::new(1.6, 0.9, 0.03),
        0.0,
        0.3,
        table,
    );
    for (x, y) in [(-0.74, -0.39), (0.74, -0.39), (-0.74, 0.39), (0.74, 0.39)] {
        let foot = Vector3::new(3.6 + x, 3.5 + y, 0.0);
        b.standing_box(foot, Vector3::new(0.05, 0.05, 0.715), 0.0, 0.4, table);
    }
    let bowl = b.of_thing(p.books[1]);
    let base = Vector3::new(3.4, 3.55, 0.74);
    b.mesh.tube(
        [base, base + Vector3::z() * 0.09],
        [0.07, 0.14],
        14,
        0.2,
        bowl,
    );
    for i in 0..5 {
        let book = b.of_thing(p.books[i % 4]);
        let at = Vector3::new(3.95, 3.4, 0.74 + 0.03 * i as f64);
        let yaw = b.draw(-0.5, 0.5);
        b.standing_box(at, Vector3::new(0.21, 0.15, 0.03), yaw, 0.3, book);
    }
    for (x, y, yaw) in [
        (3.2, 2.75, 0.1),
        (4.05, 2.7, -0.2),
        (3.15, 4.25, 3.0),
        (4.0, 4.3, 3.3),
    ] {
        chair(b, p, Vector3::new(x, y, 0.0), yaw);
    }

    // A screen of three panes between posts.
    let posts = b.of_thing(p.steel);
    let at = |k: f64, z: f64| Vector3::new(5.7, 2.3 + 0.8 * k, z);
    for k in 0..4 {
        let k = f64::from(k);
        rail(b, [at(k, 0.0), at(k, 2.0)], 0.03, posts);
    }
    rail(b, [at(0.0, 2.0), at(3.0, 2.0)], 0.03, posts);
    for k in 0..3 {
        let pane = b.of_thing(p.glass);
        let (from, to) = (f64::from(k) + 0.03, f64::from(k) + 0.97);
        let corners = [at(from, 0.06), at(to, 0.06), at(to, 1.96), at(from, 1.96)];
        b.pane(corners, 0.4, pane);
    }

    // A guard rail of thin bars, as around an opening in the floor.
    let guard = b.of_thing(p.steel);
    let corners = [(6.5, 2.7), (7.7, 2.7), (7.7, 4.3), (6.5, 4.3)];
    let at = |k: usize, z: f64| {
        let (x, y) = corners[k % 4];
        Vector3::new(x, y, z)
    };
    for k in 0..4 {
        rail(b, [at(k, 0.0), at(k, 1.02)], 0.04, guard);
        rail(b, [at(k, 1.0), at(k + 1, 1.0)], 0.035, guard);
        rail(b, [at(k, 0.1), at(k + 1, 0.1)], 0.02, guard);
        let bars = if k % 2 == 0 { 9 } else { 12 };
        for i in 1..bars {
            let t = f64::from(i) / f64::from(bars);
            let foot = at(k, 0.1) * (1.0 - t) + at(k + 1, 0.1) * t;
            rail(b, [foot, foot + Vector3::z() * 0.9], 0.02, guard);
        }
    }
    // Within it, a low glass table.
    let legs = b.of_thing(p.steel);
    for (x, y) in [(6.8, 3.1), (7.4, 3.1), (6.8, 3.9), (7.4, 3.9)] {
        let foot = Vector3::new(x, y, 0.0);
        rail(b, [foot, foot + Vector3::z() * 0.45], 0.025, legs);
    }
    let top = [(6.7, 3.0), (7.5, 3.0), (7.5, 4.0), (6.7, 4.0)];
    let pane = b.of_thing(p.glass);
    b.pane(top.map(|(x, y)| Vector3::new(x, y, 0.455)), 0.4, pane);
}

/// A chair of steel tube; its back is behind it when it looks along +y.
fn chair(b: &mut Builder, p: &Palette, at: Vector3<f64>, yaw: f64) {
    let turn = Builder::yaw(yaw);
    let point = |x: f64, y: f64, z: f64| at + turn * Vector3::new(x, y, z);
    let frame = b.of_thing(p.steel);
    for x in [-0.2, 0.2] {
        rail(b, [point(x, 0.2, 0.0), point(x, 0.19, 0.45)], 0.022, frame);
        rail(
            b,
            [point(x, -0.22, 0.0), point(x, -0.2, 0.45)],
            0.022,
            frame,
        );
        rail(
            b,
            [point(x, -0.2, 0.44), point(x, -0.28, 0.88)],
            0.022,
            frame,
        );
    }
    let cloth = Stuff {
        material: p.cloth[0],
        ..frame
    };
    let size = Vector3::new(0.44, 0.42, 0.04);
    b.standing_box(point(0.0, 0.0, 0.44), size, yaw, 0.3, cloth);
    let size = Vector3::new(0.42, 0.03, 0.22);
    b.standing_box(point(0.0, -0.27, 0.66), size, yaw, 0.3, cloth);
}

/// Shelf, sofa, clothes rail, glass cabinet, lamp, radiator: outside the loop.
fn along_the_walls(b: &mut Builder, p: &Palette) {
    let [x, y] = SIZE;
    let wall = |from: [f64; 2], to: [f64; 2]| Wall {
        from,
        to,
        height: HEIGHT,
    };
    let south = wall([x, 0.0], [0.0, 0.0]);
    let north = wall([0.0, y], [x, y]);

    bookshelf(b, p, &south);
    sofa(b, p, &south);
    bar_and_radiators(b, p, &south, &north);
    clothes_rail(b, p, &north);
    glass_cabinet(b, p, &south);
    floor_lamp(b, p);
}

/// A shelf with books.
fn bookshelf(b: &mut Builder, p: &Palette, south: &Wall) {
    let shelf = b.of_thing(p.wood);
    let (left, right) = (5.6, 7.6);
    for along in [[left, left + 0.025], [right - 0.025, right]] {
        south.block(b, along, [0.0, 1.9], [0.02, 0.3], shelf);
    }
    for k in 0..5 {
        let up = 0.08 + 0.44 * f64::from(k);
        let inside = [left + 0.025, right - 0.025];
        south.block(b, inside, [up, up + 0.025], [0.02, 0.3], shelf);
        if k == 4 {
            break;
        }
        let mut at = left + 0.04;
        while at < right - 0.2 {
            let (thick, high) = (b.draw(0.018, 0.05), b.draw(0.19, 0.3));
            let deep = b.draw(0.15, 0.22);
            let color = b.draw(0.0, 4.0) as usize;
            let book = b.of_thing(p.books[color]);
            let foot = up + 0.025;
            south.block(
                b,
                [at, at + thick - 0.001],
                [foot, foot + high],
                [0.05, 0.05 + deep],
                book,
            );
            at += thick;
            if b.draw(0.0, 1.0) < 0.06 {
                at += b.draw(0.1, 0.3);
            }
        }
    }
}

fn sofa(b: &mut Builder, p: &Palette, south: &Wall) {
    let sofa = b.of_thing(p.cloth[1]);
    south.block(b, [2.4, 4.4], [0.05, 0.4], [0.05, 0.75], sofa);
    south.block(b, [2.4, 4.4], [0.4, 0.8], [0.05, 0.22], sofa);
    south.block(b, [2.2, 2.4], [0.05, 0.6], [0.05, 0.75], sofa);
    south.block(b, [4.4, 4.6], [0.05, 0.6], [0.05, 0.75], sofa);
}

/// A rail along the wall, as for exercise, and radiators under the windows.
fn bar_and_radiators(b: &mut Builder, p: &Palette, south: &Wall, north: &Wall) {
    let bar = b.of_thing(p.wood);
    rail(
        b,
        [south.at(8.0, 0.95, 0.14), south.at(9.7, 0.95, 0.14)],
        0.04,
        bar,
    );
    for along in [8.2, 9.5] {
        let ends = [south.at(along, 0.93, 0.0), south.at(along, 0.93, 0.14)];
        rail(b, ends, 0.02, bar);
    }
    for from in [1.7, 5.5] {
        let radiator = b.of_thing(p.white);
        for k in 0..22 {
            let at = from + 0.06 * f64::from(k);
            north.block(b, [at, at + 0.045], [0.15, 0.75], [0.04, 0.12], radiator);
        }
        north.block(b, [from, from + 1.3], [0.18, 0.21], [0.05, 0.11], radiator);
    }
}

/// A rail with clothes.
fn clothes_rail(b: &mut Builder, p: &Palette, north: &Wall) {
    let stand = b.of_thing(p.steel);
    let (left, right) = (8.2, 9.6);
    for along in [left, right] {
        rail(
            b,
            [north.at(along, 0.0, 0.35), north.at(along, 1.6, 0.35)],
            0.03,
            stand,
        );
        rail(
            b,
            [north.at(along, 0.02, 0.12), north.at(along, 0.02, 0.58)],
            0.03,
            stand,
        );
    }
    rail(
        b,
        [north.at(left, 1.6, 0.35), north.at(right, 1.6, 0.35)],
        0.03,
        stand,
    );
    for k in 0..6 {
        let cloth = b.of_thing(p.cloth[k % 2]);
        let at = left + 0.15 + 0.1 * k as f64;
        let low = b.draw(0.5, 0.9);
        north.block(b, [at, at + 0.04], [low, 1.52], [0.15, 0.55], cloth);
    }
}

/// A cabinet of glass in a corner.
fn glass_cabinet(b: &mut Builder, p: &Palette, south: &Wall) {
    let cabinet = b.of_thing(p.wood);
    let (left, right, deep) = (0.5, 1.4, 0.4);
    for up in [[0.0, 0.3], [1.0, 1.02], [1.78, 1.82]] {
        south.block(b, [left, right], up, [0.02, deep], cabinet);
    }
    for along in [left, right - 0.03] {
        for out in [0.02, deep - 0.03] {
            let inside = [0.3, 1.78];
            south.block(b, [along, along + 0.03], inside, [out, out + 0.03], cabinet);
        }
    }
    let at = |along: f64, up: f64, out: f64| south.at(along, up, out);
    let pane = b.of_thing(p.glass);
    let front = deep - 0.015;
    let (l, r) = (left + 0.03, right - 0.03);
    b.pane(
        [
            at(l, 0.3, front),
            at(r, 0.3, front),
            at(r, 1.78, front),
            at(l, 1.78, front),
        ],
        0.4,
        pane,
    );
    for k in 0..5 {
        let vase = b.of_thing(p.books[k % 4]);
        let along = left + 0.15 + 0.15 * k as f64;
        let up = if k % 2 == 0 { 0.3 } else { 1.02 };
        let high = b.draw(0.15, 0.35);
        let ends = [at(along, up, 0.2), at(along, up + high, 0.2)];
        b.mesh.tube(ends, [0.05, 0.035], 12, 0.2, vase);
    }
}

/// A lamp on a thin stem.
fn floor_lamp(b: &mut Builder, p: &Palette) {
    let lamp = b.of_thing(p.steel);
    let foot = Vector3::new(0.45, 6.5, 0.0);
    rail(b, [foot, foot + Vector3::z() * 0.02], 0.3, lamp);
    rail(b, [foot, foot + Vector3::z() * 1.6], 0.02, lamp);
    let shade = b.of_thing(p.cloth[1]);
    let base = foot + Vector3::z() * 1.5;
    b.mesh.tube(
        [base, base + Vector3::z() * 0.26],
        [0.2, 0.13],
        16,
        0.3,
        shade,
    );
}
