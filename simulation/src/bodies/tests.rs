use cad_transforms::RigidTransform;
use scene_bundle::outputs::collision::{Collision, ConvexPart, HeightLayer, PartKind};
use scene_bundle::outputs::grid::Grid;

use super::{BodiesConfig, Body, BodyShape, RigidBodies};
use crate::SimulationError;

/// Rest: bodies fall from 10 cm and have two seconds.
const STEPS: usize = 1000;

/// A box from one corner to the opposite one.
fn slab(from_m: [f64; 3], to_m: [f64; 3]) -> ConvexPart {
    let corner = |i: usize| [0, 1, 2].map(|k| if i >> k & 1 == 1 { to_m[k] } else { from_m[k] });
    ConvexPart {
        kind: PartKind::Ground,
        plane: None,
        vertices_m: (0..8).map(corner).collect(),
        triangles: Vec::new(),
    }
}

/// Ground with its surface at z = 0, and five steps of 17 cm from x = 1.5 m.
fn stairs() -> Collision {
    let tread = |i: usize| {
        let from = 1.5 + 0.29 * i as f64;
        slab([from, -2.0, -0.2], [5.0, 2.0, 0.17 * (i + 1) as f64])
    };
    let ground = slab([-3.0, -2.0, -0.2], [5.0, 2.0, 0.0]);
    Collision {
        parts: [ground].into_iter().chain((0..5).map(tread)).collect(),
        ..Collision::default()
    }
}

/// Height of a ramp that rises differently along x and y.
fn ramp_m([x, y]: [f64; 2]) -> f64 {
    0.3 + 0.05 * x - 0.02 * y
}

/// A layer of 40 by 24 cells with a hole around (0.5, 0.25).
fn ramp() -> Collision {
    let grid = Grid {
        cell_m: 0.05,
        origin_m: [-1.0, -0.6],
        columns: 40,
        rows: 24,
    };
    let height = |cell: usize| {
        let (row, column) = (cell / grid.columns, cell % grid.columns);
        let at = [
            grid.origin_m[0] + column as f64 * grid.cell_m,
            grid.origin_m[1] + row as f64 * grid.cell_m,
        ];
        match (at[0] - 0.5).abs() < 0.2 && (at[1] - 0.25).abs() < 0.2 {
            true => f32::NAN,
            false => ramp_m(at) as f32,
        }
    };
    let heights_m = (0..grid.cells()).map(height).collect();
    Collision {
        layers: vec![HeightLayer { grid, heights_m }],
        ..Collision::default()
    }
}

/// A body of one shape.
fn single(shape: BodyShape, mass_kg: f64, position_m: [f64; 3]) -> Body {
    Body::new(shape, mass_kg, position_m).unwrap()
}

/// A trunk on four legs, 0.3 by 0.2 m; its origin is 0.122 m above the soles.
fn stand(position_m: [f64; 3]) -> Body {
    let at = |x, y, z| RigidTransform::from_translation_m([x, y, z]).unwrap();
    let trunk = BodyShape::Box {
        half_m: [0.15, 0.1, 0.02],
    };
    let foot = BodyShape::Ball { radius_m: 0.022 };
    let mut body = single(trunk, 4.0, position_m);
    for (x, y) in [(0.13, 0.08), (0.13, -0.08), (-0.13, 0.08), (-0.13, -0.08)] {
        body.shapes.push((foot, at(x, y, -0.1)));
    }
    body
}

/// Name, the body at a position, and the height of its origin above what it rests on.
type Case = (&'static str, fn([f64; 3]) -> Body, f64);

fn bodies() -> [Case; 4] {
    [
        (
            "box",
            |at| {
                single(
                    BodyShape::Box {
                        half_m: [0.1, 0.1, 0.05],
                    },
                    2.0,
                    at,
                )
            },
            0.05,
        ),
        (
            "ball",
            |at| single(BodyShape::Ball { radius_m: 0.05 }, 1.0, at),
            0.05,
        ),
        (
            "capsule",
            |at| {
                single(
                    BodyShape::Capsule {
                        half_m: 0.05,
                        radius_m: 0.04,
                    },
                    1.0,
                    at,
                )
            },
            0.09,
        ),
        ("stand", stand, 0.122),
    ]
}

fn run(world: &mut RigidBodies, steps: usize) {
    for _ in 0..steps {
        world.step().unwrap();
    }
}

/// Height of a body's origin, and the angle of its z axis from the vertical.
fn height_and_tilt(world: &RigidBodies, body: usize) -> (f64, f64) {
    let pose = world.state(body).unwrap().world_from_body;
    (
        pose.translation_m()[2],
        pose.rotate([0.0, 0.0, 1.0])[2].clamp(-1.0, 1.0).acos(),
    )
}

#[test]
fn bodies_rest_on_the_plane_and_on_a_tread() {
    // In the middle of the last tread, which is wide.
    for (place, ground_m) in [([0.0, 0.0], 0.0), ([3.8, 0.3], 0.85)] {
        for (name, body, height_m) in bodies() {
            let mut world = RigidBodies::new(&stairs(), BodiesConfig::default()).unwrap();
            let index = world
                .add(&body([place[0], place[1], ground_m + height_m + 0.1]))
                .unwrap();
            run(&mut world, STEPS);
            let (height, tilt) = height_and_tilt(&world, index);
            assert!(
                (height - ground_m - height_m).abs() < 2e-3,
                "{name}: {height} m"
            );
            assert!(name == "ball" || tilt < 2e-3, "{name}: {tilt} rad");
            let contacts = world.contacts(index).unwrap();
            let force: f64 = contacts.iter().map(|own| own.force_n * own.normal[2]).sum();
            let weight = 9.81 * body([0.0; 3]).mass_kg;
            assert!(
                (force / weight - 1.0).abs() < 0.02,
                "{name}: {force} N, {weight}"
            );
            assert!(
                contacts
                    .iter()
                    .all(|own| (own.point_m[2] - ground_m).abs() < 2e-3)
            );
        }
    }
}

/// Friction of 1 holds on a slope of 3 degrees; the slope differs in x and y, so that a mirrored or
/// a swapped layer has other heights.
#[test]
fn a_layer_has_its_heights_and_its_holes() {
    let ground = ramp();
    for at in [[-0.7, -0.4], [0.7, -0.45], [-0.6, 0.35], [0.05, 0.0]] {
        let mut world = RigidBodies::new(&ground, BodiesConfig::default()).unwrap();
        let plate = BodyShape::Box {
            half_m: [0.06, 0.06, 0.03],
        };
        let above = ramp_m(at) + 0.05;
        let body = world
            .add(&single(plate, 1.0, [at[0], at[1], above]))
            .unwrap();
        run(&mut world, STEPS);
        let pose = world.state(body).unwrap().world_from_body;
        let sole = pose.apply([0.0, 0.0, -0.03]);
        assert!(
            (sole[2] - ramp_m([sole[0], sole[1]])).abs() < 2e-3,
            "{sole:?}"
        );
        let up = pose.rotate([0.0, 0.0, 1.0]);
        let normal = [-0.05, 0.02, 1.0].map(|v: f64| v / (1.0 + 0.0029_f64).sqrt());
        assert!((0..3).all(|k| (up[k] - normal[k]).abs() < 3e-3), "{up:?}");
    }
    // Nothing was seen in the hole: what is dropped there falls through.
    let mut world = RigidBodies::new(&ground, BodiesConfig::default()).unwrap();
    let ball = single(BodyShape::Ball { radius_m: 0.05 }, 1.0, [0.5, 0.25, 0.5]);
    let body = world.add(&ball).unwrap();
    run(&mut world, STEPS);
    assert!(height_and_tilt(&world, body).0 < -1.0);
}

#[test]
fn a_ray_down_has_the_height_of_the_ground() {
    let mut world = RigidBodies::new(&ramp(), BodiesConfig::default()).unwrap();
    world.step().unwrap();
    for at in [[-0.713, -0.407], [0.691, -0.447], [-0.603, 0.358]] {
        let found = world.ground_m([at[0], at[1], 2.0], 5.0).unwrap();
        assert!((found - ramp_m(at)).abs() < 1e-5, "{found}");
    }
    assert!(world.ground_m([30.0, 0.0, 2.0], 5.0).is_none());
    assert!(world.ground_m([-0.713, -0.407, 2.0], 0.5).is_none());
    let mut stairs = RigidBodies::new(&stairs(), BodiesConfig::default()).unwrap();
    stairs.step().unwrap();
    let inside = [0.0, 0.0, -0.05];
    assert_eq!(stairs.ground_m(inside, 5.0), Some(inside[2]));
}

#[test]
fn nothing_passes_through_the_ground_at_five_meters_per_second() {
    for (name, body, height_m) in bodies() {
        // Long steps: 8 cm per step.
        for step_s in [0.002, 1.0 / 60.0] {
            let config = BodiesConfig {
                step_s,
                ..BodiesConfig::default()
            };
            let mut world = RigidBodies::new(&stairs(), config).unwrap();
            let mut fast = body([0.0, 0.0, 1.0]);
            fast.velocity_m_s = [0.0, 0.0, -5.0];
            let index = world.add(&fast).unwrap();
            let mut lowest = f64::INFINITY;
            for _ in 0..(2.0 / step_s) as usize {
                world.step().unwrap();
                lowest = lowest.min(height_and_tilt(&world, index).0);
            }
            assert!(lowest > height_m - 0.1, "{name}, {step_s} s: {lowest} m");
            let (height, _) = height_and_tilt(&world, index);
            // A capsule may fall over.
            let limit_m = if name == "capsule" { 0.052 } else { 2e-3 };
            assert!(
                (height - height_m).abs() < limit_m,
                "{name}, {step_s} s: {height} m"
            );
        }
    }
}

/// A pushed box slides as far as friction lets it: v²/(2 μ g).
#[test]
fn a_push_slides_a_box() {
    let config = BodiesConfig {
        friction: 0.5,
        ..BodiesConfig::default()
    };
    let mut world = RigidBodies::new(&stairs(), config).unwrap();
    let plate = BodyShape::Box {
        half_m: [0.2, 0.2, 0.02],
    };
    let body = world.add(&single(plate, 2.0, [-2.0, 0.0, 0.02])).unwrap();
    run(&mut world, 200);
    let before = world.state(body).unwrap().world_from_body.translation_m();
    world.push(body, [4.0, 0.0, 0.0], before).unwrap();
    run(&mut world, STEPS);
    let after = world.state(body).unwrap().world_from_body.translation_m();
    let expected = 2.0 * 2.0 / (2.0 * 0.5 * 9.81);
    assert!(
        (after[0] - before[0] - expected).abs() < 0.02 * expected,
        "{after:?}"
    );
    assert!(after[1].abs() < 1e-3);
}

/// Several bodies that hit each other; as bytes, so that nothing is compared as a number.
fn scene() -> RigidBodies {
    let mut world = RigidBodies::new(&stairs(), BodiesConfig::default()).unwrap();
    for (i, (_, body, _)) in bodies().into_iter().enumerate() {
        let mut own = body([2.0, 0.02 * i as f64, 1.0 + 0.3 * i as f64]);
        own.angular_velocity_rad_s = [1.0, -2.0, 0.5];
        world.add(&own).unwrap();
    }
    world
}

#[test]
fn a_snapshot_continues_bit_for_bit() {
    let mut whole = scene();
    run(&mut whole, 300);
    let snapshot = whole.save().unwrap();
    run(&mut whole, 300);
    let mut other = RigidBodies::new(&stairs(), BodiesConfig::default()).unwrap();
    other.restore(&snapshot).unwrap();
    assert_eq!(other.len(), whole.len());
    run(&mut other, 300);
    for body in 0..whole.len() {
        assert_eq!(whole.state(body).unwrap(), other.state(body).unwrap());
    }
    assert!(whole.save().unwrap() == other.save().unwrap());
}

#[test]
fn worlds_on_threads_are_those_in_sequence() {
    use rayon::prelude::*;
    let mut one = scene();
    run(&mut one, 200);
    let expected = one.save().unwrap();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(4)
        .build()
        .unwrap();
    let all = pool.install(|| {
        let worlds = (0..8).into_par_iter().map(|_| {
            let mut own = scene();
            run(&mut own, 200);
            own.save().unwrap()
        });
        worlds.collect::<Vec<_>>()
    });
    assert!(all.iter().all(|own| *own == expected));
}

#[test]
fn other_and_damaged_snapshots_are_refused() {
    let mut world = scene();
    run(&mut world, 50);
    let snapshot = world.save().unwrap();
    let before = world.save().unwrap();
    let found = |result: Result<(), SimulationError>| match result {
        Err(SimulationError::Snapshot { found, .. }) => found,
        other => panic!("{other:?}"),
    };
    for place in [0, 20, 60, snapshot.len() / 2, snapshot.len() - 1] {
        let mut damaged = snapshot.clone();
        damaged[place] ^= 1;
        assert_eq!(found(world.restore(&damaged)), "damaged bytes");
    }
    for length in [0, 10, 100, snapshot.len() - 1] {
        assert_eq!(found(world.restore(&snapshot[..length])), "damaged bytes");
    }
    // With a checksum of their own.
    let content = &snapshot[..snapshot.len() - blake3::OUT_LEN];
    let forged = |content: &[u8]| [content, blake3::hash(content).as_bytes()].concat();
    let other = [b"pawsrb99", &content[8..]].concat();
    assert!(found(world.restore(&forged(&other))).contains("version"));
    let longer = [content, &[0]].concat();
    assert_eq!(
        found(world.restore(&forged(&longer))),
        "1 bytes after the state"
    );
    assert!(
        world
            .restore(&forged(&content[..content.len() - 5]))
            .is_err()
    );
    assert!(world.save().unwrap() == before);
    let mut elsewhere = RigidBodies::new(&ramp(), BodiesConfig::default()).unwrap();
    assert!(found(elsewhere.restore(&snapshot)).contains("another ground"));
    let config = BodiesConfig {
        friction: 0.9,
        ..BodiesConfig::default()
    };
    let mut slippery = RigidBodies::new(&stairs(), config).unwrap();
    assert!(found(slippery.restore(&snapshot)).contains("configuration"));
}

#[test]
fn bad_input_is_refused_by_name_and_adds_nothing() {
    let mut world = RigidBodies::new(&stairs(), BodiesConfig::default()).unwrap();
    let ball = single(BodyShape::Ball { radius_m: 0.1 }, 1.0, [0.0; 3]);
    let name = |result: Result<usize, SimulationError>| match result {
        Err(SimulationError::Setting { name, .. }) => name,
        other => panic!("{other:?}"),
    };
    let mut bad = ball.clone();
    bad.mass_kg = f64::NAN;
    assert_eq!(name(world.add(&bad)), "body.mass_kg");
    let mut bad = ball.clone();
    bad.velocity_m_s[1] = f64::INFINITY;
    assert_eq!(name(world.add(&bad)), "body.velocity_m_s");
    let mut bad = ball.clone();
    bad.shapes.clear();
    assert_eq!(name(world.add(&bad)), "body.shapes");
    let bad = single(BodyShape::Ball { radius_m: 0.0 }, 1.0, [0.0; 3]);
    assert_eq!(name(world.add(&bad)), "ball.radius_m");
    let mut bad = ball.clone();
    bad.angular_velocity_rad_s[2] = 1e4;
    assert_eq!(name(world.add(&bad)), "body.angular_velocity_rad_s");
    for position_m in [[f64::NAN, 0.0, 0.0], [0.0, 1e7, 0.0]] {
        assert!(Body::new(ball.shapes[0].0, 1.0, position_m).is_err());
    }
    assert!(world.is_empty());
    assert!(world.state(0).is_err());
    let body = world.add(&ball).unwrap();
    assert!(world.push(body, [f64::NAN, 0.0, 0.0], [0.0; 3]).is_err());
    assert!(world.push(1, [0.0; 3], [0.0; 3]).is_err());
    let config = BodiesConfig {
        step_s: 0.0,
        ..BodiesConfig::default()
    };
    assert!(RigidBodies::new(&stairs(), config).is_err());
}

/// Parts without volume are counted, not collided with: four points of a plane, three, and two.
#[test]
fn flat_parts_are_left_out() {
    let mut ground = stairs();
    let flat = slab([0.0, 0.0, 1.0], [1.0, 1.0, 1.0]);
    for count in [8, 4, 3, 2] {
        let mut part = flat.clone();
        part.vertices_m.truncate(count);
        ground.parts.push(part);
    }
    let mut world = RigidBodies::new(&ground, BodiesConfig::default()).unwrap();
    assert_eq!(world.parts_left_out(), 4);
    let ball = single(BodyShape::Ball { radius_m: 0.1 }, 1.0, [0.5, 0.5, 1.5]);
    let body = world.add(&ball).unwrap();
    run(&mut world, STEPS);
    assert!((height_and_tilt(&world, body).0 - 0.1).abs() < 2e-3);
}

#[test]
fn bad_ground_is_refused_with_its_place() {
    let refused = |change: fn(&mut Collision)| {
        let mut ground = ramp();
        ground.parts = stairs().parts;
        change(&mut ground);
        match RigidBodies::new(&ground, BodiesConfig::default()) {
            Err(SimulationError::Scene { place, found, .. }) => format!("{place}: {found}"),
            Err(other) => panic!("{other}"),
            Ok(_) => panic!("not refused"),
        }
    };
    let vertex = refused(|own| own.parts[2].vertices_m[1][0] = f64::NAN);
    assert!(vertex.starts_with("collision part 2"), "{vertex}");
    for layer in [
        refused(|own| own.layers[0].heights_m.truncate(7)),
        refused(|own| own.layers[0].heights_m[3] = f32::INFINITY),
        refused(|own| own.layers[0].grid.cell_m = 0.0),
        refused(|own| own.layers[0].grid.columns = usize::MAX),
    ] {
        assert!(layer.starts_with("collision layer 0"), "{layer}");
    }
}

/// The engine takes a body out of the computation whose state is not finite. Each step from then on
/// is an error, and the others go on.
#[test]
fn a_body_that_is_lost_is_an_error_from_then_on() {
    let mut world = RigidBodies::new(&stairs(), BodiesConfig::default()).unwrap();
    let ball = BodyShape::Ball { radius_m: 0.1 };
    let whole = world.add(&single(ball, 1.0, [-1.0, 0.0, 0.2])).unwrap();
    let speck = BodyShape::Ball { radius_m: 1e-4 };
    let lost = world.add(&single(speck, 1e-4, [1.0, 0.0, 3.0])).unwrap();
    let before = world.save().unwrap();
    let far = [1.0, 1e6, 3.0];
    for _ in 0..100 {
        world.push(lost, [1e6, 0.0, 1e6], far).unwrap();
    }
    for _ in 0..3 {
        let error = world.step().unwrap_err().to_string();
        assert!(error.contains(&format!("body {lost}")), "{error}");
    }
    for _ in 0..STEPS {
        let _ = world.step();
    }
    assert!((height_and_tilt(&world, whole).0 - 0.1).abs() < 2e-3);
    world.restore(&before).unwrap();
    world.step().unwrap();
}
