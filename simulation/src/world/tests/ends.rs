//! Exam 6.5: every reason of an end alone and in pairs.

use std::ops::ControlFlow;
use std::sync::Mutex;

use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::{FREE, KNOWN, MapLevel, OCCUPIED, UNKNOWN};

use super::*;
use crate::episode::task::goals::Goal;
use crate::geodesic::DistanceField;
use crate::scene::{Area, Recording, Sector};
use crate::support::SupportConfig;
use crate::support::tests::coarse;
use crate::world::episode::Target;

const BLOCKS: [EndReason; 3] = [
    EndReason::Collision,
    EndReason::LeftMap,
    EndReason::UnknownGround,
];

/// Level for x below 6 m, a slope of 0.2 up to 12 m. There is a wall at 9 m for y below 2 m, and
/// ground that was not seen from 9 to 10 m for y of 3 to 5 m. Cameras recorded from 1 to 5 m.
fn scene() -> Arc<SceneData> {
    let cell_m = 0.05;
    let grid = Grid {
        cell_m,
        origin_m: [0.5 * cell_m; 2],
        columns: 240,
        rows: 120,
    };
    let mut level = MapLevel::unknown(grid);
    for cell in 0..grid.cells() {
        let [x, y] = grid.center_m(cell);
        if (9.0..10.0).contains(&x) && (3.0..5.0).contains(&y) {
            level.occupancy[cell] = UNKNOWN;
            level.distance[cell] = -1.0;
            continue;
        }
        if (9.0..9.2).contains(&x) && y < 2.0 {
            level.occupancy[cell] = OCCUPIED;
            level.distance[cell] = -1.0;
            continue;
        }
        let slope = if x > 6.0 { 0.2 } else { 0.0 };
        let height = (slope * (x - 6.0)) as f32;
        let norm = (1.0 + slope * slope).sqrt();
        for layer in [&mut level.elevation, &mut level.lower, &mut level.upper] {
            layer[cell] = height;
        }
        level.normal[cell] = [-slope / norm, 0.0, 1.0 / norm].map(|v| v as f32);
        level.slope[cell] = libm::atan(slope) as f32;
        level.sigma[cell] = 0.002;
        level.step[cell] = 0.0;
        level.roughness[cell] = 0.0;
        level.traversability[cell] = 1.0;
        level.clearance[cell] = f32::INFINITY;
        let from_unknown = (9.0 - x)
            .max(x - 10.0)
            .max(0.0)
            .hypot((3.0 - y).max(y - 5.0).max(0.0));
        let from_wall = (9.0 - x).max(x - 9.2).max(0.0).hypot((y - 2.0).max(0.0));
        level.distance[cell] = from_unknown.min(from_wall) as f32;
        level.views[cell] = 9;
        level.flags[cell] = KNOWN;
        level.occupancy[cell] = FREE;
    }
    let pose = |i: u32| {
        let at = [1.0 + 0.1 * f64::from(i), 3.0, 1.4];
        RigidTransform::from_translation_m(at).unwrap() * RigidTransform::body_from_optical()
    };
    let sector = Sector {
        name: "slope".to_owned(),
        levels: Some(Arc::new(vec![level])),
        area: Area::new([0.0; 2], [12.0, 6.0]),
        references: Arc::new((0..41).map(pose).collect()),
        gaussians: None,
        recording: Arc::new(Recording::default()),
        edges: Vec::new(),
    };
    Arc::new(SceneData::new("slope", vec![sector]).unwrap())
}

/// Distances to a goal on the ground of [`scene`], computed once for each goal.
fn distances(world: &World, goal_m: [f64; 3]) -> DistanceField {
    static FIELDS: Mutex<Vec<DistanceField>> = Mutex::new(Vec::new());
    let mut fields = FIELDS.lock().unwrap();
    if let Some(field) = fields.iter().find(|field| field.goal_m() == goal_m) {
        return field.clone();
    }
    let ground = &world.shared.terrains[0].ground;
    let field = DistanceField::new(ground, &world.shared.config.agent, goal_m);
    fields.push(field.clone());
    field
}

/// A world in which exactly these reasons happen in the next step, by the action that goes ahead.
fn provoke(scene: &Arc<SceneData>, reasons: &[EndReason], ends: EndConfig) -> World {
    let happens = |reason| reasons.contains(&reason);
    let mut config = config(1, Task::PointGoal);
    config.dt_s = 1.0;
    config.task.success_radius_m = 2.0;
    config.task.goal_distance_m = [2.1, 40.0];
    config.task.max_goal_height_m = 5.0;
    config.end = EndConfig {
        time_limit_s: if happens(EndReason::TimeLimit) {
            1.0
        } else {
            99.0
        },
        max_deviation_m: if happens(EndReason::Deviation) {
            1.5
        } else {
            99.0
        },
        max_tilt_rad: if happens(EndReason::Fall) { 0.05 } else { 0.7 },
        collision_ends: true,
        ..ends
    };
    let mut world = World::new(scene.clone(), config).unwrap();
    let ([x, y], yaw_rad) = match reasons.iter().find(|reason| BLOCKS.contains(reason)) {
        Some(EndReason::Collision) => ([8.5, 1.0], 0.0),
        Some(EndReason::UnknownGround) => ([8.5, 4.0], 0.0),
        Some(_) => ([11.5, 5.0], 0.0),
        None => ([8.3, 2.5], std::f64::consts::PI),
    };
    let position_m = [x, y, 0.2 * (x - 6.0)];
    let goal_m = match happens(EndReason::Goal) {
        true => position_m,
        false => [1.0, 1.0, 0.0],
    };
    // Instead of those that the first reset draws.
    world.shared.goals = vec![Goal {
        frame: world.shared.terrains[0].frame,
        position_m: goal_m,
        field: distances(&world, goal_m),
    }];
    world.reset(None, None).unwrap();
    world.environments.episode[0].target = Target::Goal {
        index: 0,
        position_m: goal_m,
    };
    let state = AgentState {
        position_m,
        yaw_rad,
        velocity: [1.5, 0.0, 0.0],
        ..world.states()[0]
    };
    world.place(0, 0, &state).unwrap();
    if happens(EndReason::PhysicsFault) {
        let broken = AgentState {
            position_m: [f64::NAN; 3],
            ..state
        };
        world.place(0, 0, &broken).unwrap();
        assert_eq!(world.states()[0].position_m, position_m);
    }
    world
}

#[test]
fn states_that_no_agent_has_are_physics_faults() {
    let mut world = World::new(room(), config(1, Task::Velocity)).unwrap();
    let far = AgentState {
        position_m: [1e6, 0.0, 0.0],
        ..AgentState::default()
    };
    let fast = AgentState {
        velocity: [1e9, 0.0, 0.0],
        ..AgentState::default()
    };
    for state in [far, fast] {
        world.reset(None, None).unwrap();
        world.place(0, 0, &state).unwrap();
        world.step(&[0.0, 0.0]).unwrap();
        assert_eq!(world.result().end_reasons[0], EndReason::PhysicsFault as i8);
    }
}

/// Steps, and checks reason, flags and the final observation.
fn check(scene: &Arc<SceneData>, reasons: &[EndReason], ends: EndConfig) {
    let mut world = provoke(scene, reasons, ends);
    world.step(&[1.0, 0.0]).unwrap();
    let terminates = |reason: &EndReason| world.config().end.terminates(*reason);
    let ordered = || {
        EndReason::BY_PRECEDENCE
            .into_iter()
            .filter(|r| reasons.contains(r))
    };
    let expected = ordered().find(terminates).or(ordered().next());
    let expected = expected.unwrap_or(EndReason::None);
    let result = world.result();
    let found = EndReason::from_code(result.end_reasons[0]).unwrap();
    assert_eq!(
        found, expected,
        "{reasons:?}, blocked {}",
        result.blocked[0]
    );
    let is_terminated = terminates(&expected);
    assert_eq!(result.terminated[0], is_terminated, "{reasons:?}");
    let is_truncated = expected != EndReason::None && !is_terminated;
    assert_eq!(result.truncated[0], is_truncated, "{reasons:?}");
    let is_failure = is_terminated && expected != EndReason::Goal;
    assert_eq!(result.reward_terms[0][7], f64::from(u8::from(is_failure)));
    // The final observation is that of an agent that stands there in a world of its own.
    let (state, camera) = (world.states()[0], world.world_from_camera(0));
    let observation = world.observations().to_vec();
    let mut alone = provoke(scene, &[], EndConfig::default());
    alone.environments.episode[0].target = world.environments.episode[0].target;
    alone.place(0, 0, &state).unwrap();
    assert!(alone.observations() == observation, "{reasons:?}");
    assert_eq!(alone.world_from_camera(0), camera);
    // What ended does not change.
    if expected != EndReason::None {
        let path_length_m = world.result().path_length_m[0];
        world.step(&[1.0, 0.0]).unwrap();
        let result = world.result();
        assert_eq!((result.rewards[0], result.end_reasons[0]), (0.0, 0));
        assert!(!result.terminated[0] && !result.truncated[0]);
        assert_eq!(result.path_length_m[0], path_length_m);
        assert_eq!(world.states()[0], state);
        assert!(world.observations() == observation);
    }
}

#[test]
fn every_reason_ends_alone_and_in_pairs() {
    let scene = scene();
    let both = [false, true].map(|terminates| EndConfig {
        left_map_terminates: terminates,
        unknown_ground_terminates: terminates,
        ..EndConfig::default()
    });
    let mut count = 0;
    for ends in both {
        check(&scene, &[], ends);
        for (i, a) in EndReason::BY_PRECEDENCE.into_iter().enumerate() {
            check(&scene, &[a], ends);
            count += 1;
            for b in &EndReason::BY_PRECEDENCE[i + 1..] {
                // A motion is stopped by one of these.
                if !(BLOCKS.contains(&a) && BLOCKS.contains(b)) {
                    check(&scene, &[a, *b], ends);
                    count += 1;
                }
            }
        }
    }
    assert_eq!(count, 2 * (8 + 28 - 3));
}

/// Steps once in a world whose ends are all out of reach but those that are changed.
fn ended(scene: &Arc<SceneData>, state: &AgentState, change: impl Fn(&mut EndConfig)) -> EndReason {
    let mut config = config(1, Task::Velocity);
    config.end.max_deviation_m = 99.0;
    config.support = scene.sectors[0].gaussians.is_some().then(coarse);
    let mut world = World::new(scene.clone(), config.clone()).unwrap();
    world.reset(None, None).unwrap();
    let mut ends = config.end;
    change(&mut ends);
    // Only the step is under the changed limits, not the start.
    world.shared.config.end = ends;
    world.shared.limits = ends.units();
    world.place(0, 0, state).unwrap();
    world.step(&[0.0, 0.0]).unwrap();
    let result = world.result();
    let reason = EndReason::from_code(result.end_reasons[0]).unwrap();
    assert_eq!(result.truncated[0], reason != EndReason::None);
    assert!(!result.terminated[0]);
    reason
}

#[test]
fn the_angle_to_recorded_cameras_ends_alone() {
    // The recorded cameras look along x.
    let state = |yaw_rad| AgentState {
        position_m: [3.0, 3.0, 0.0],
        yaw_rad,
        is_on_ground: true,
        ..AgentState::default()
    };
    let scene = scene();
    for (yaw_rad, limit_rad, expected) in [
        (0.5, 0.51, EndReason::None),
        (0.5, 0.49, EndReason::Deviation),
        (-0.5, 0.49, EndReason::Deviation),
        (3.1, 3.11, EndReason::None),
    ] {
        let found = ended(&scene, &state(yaw_rad), |ends| {
            ends.max_deviation_rad = limit_rad;
        });
        assert_eq!(found, expected, "{yaw_rad} {limit_rad}");
    }
}

#[test]
fn the_predicted_psnr_ends_alone() {
    let scene = SyntheticScene::stairs().unwrap().scene;
    let mut world = World::new(
        scene.clone(),
        WorldConfig {
            support: Some(coarse()),
            ..config(1, Task::Velocity)
        },
    )
    .unwrap();
    world.prepare(&|_, _| ControlFlow::Continue(())).unwrap();
    for yaw_rad in [0.0, 1.3, std::f64::consts::PI] {
        let state = AgentState {
            position_m: [1.0, 1.5, 0.0],
            yaw_rad,
            is_on_ground: true,
            ..AgentState::default()
        };
        let predicted_db = world.support()[0].psnr_db(state.position_m, yaw_rad);
        assert!(predicted_db > 1.0);
        for (limit_db, expected) in [
            (predicted_db - 0.01, EndReason::None),
            (predicted_db + 0.01, EndReason::Deviation),
        ] {
            let found = ended(&scene, &state, |ends| ends.min_support_db = limit_db);
            assert_eq!(found, expected, "{yaw_rad} {limit_db}");
        }
    }
}

#[test]
fn a_scene_of_which_nothing_is_known_refuses_limits_of_the_psnr() {
    let scene = scene();
    for (name, change) in [
        (
            "end.min_support_db",
            (|c| c.end.min_support_db = 15.0) as fn(&mut WorldConfig),
        ),
        ("start.min_support_db", |c| c.start.min_support_db = 15.0),
        ("support", |c| c.support = Some(SupportConfig::default())),
    ] {
        let mut config = config(1, Task::Velocity);
        change(&mut config);
        let error = World::new(scene.clone(), config).unwrap_err().to_string();
        assert!(error.starts_with(name), "{error}");
        assert!(error.contains("sector slope has no record"), "{error}");
    }
}

#[test]
fn blocks_that_end_nothing_stop_the_agent() {
    let scene = scene();
    let ends = EndConfig {
        left_map_ends: false,
        unknown_ground_ends: false,
        ..EndConfig::default()
    };
    for reason in [EndReason::LeftMap, EndReason::UnknownGround] {
        let mut world = provoke(&scene, &[reason], ends);
        let before = world.states()[0].position_m;
        for _ in 0..3 {
            world.step(&[1.0, 0.0]).unwrap();
        }
        assert!(!world.has_ended(0));
        assert_eq!(world.result().collisions[0], 3);
        let moved = world.states()[0].position_m[0] - before[0];
        assert!((0.0..0.6).contains(&moved), "{moved}");
    }
}

#[test]
fn agents_are_placed_where_there_is_something() {
    let mut world = World::new(room(), config(1, Task::Velocity)).unwrap();
    let state = AgentState::default();
    assert!(matches!(
        world.place(0, 0, &state),
        Err(SimulationError::State(_))
    ));
    world.reset(None, None).unwrap();
    let above = AgentState { level: 9, ..state };
    for error in [
        world.place(1, 0, &state).unwrap_err(),
        world.place(0, 7, &state).unwrap_err(),
        world.place(0, 0, &above).unwrap_err(),
    ] {
        assert!(matches!(error, SimulationError::Setting { .. }), "{error}");
    }
}
