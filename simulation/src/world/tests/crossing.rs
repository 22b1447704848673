//! Exam 6.6, the part without images: poses and collisions of worlds over the edges of a loop of
//! sectors, and what is no ground to cross to.

use std::f64::consts::{PI, TAU};
use std::sync::OnceLock;

use scene_bundle::outputs::maps::{MapLevel, OCCUPIED};

use super::*;
use crate::agent::{AgentConfig, Motion, advance};
use crate::ground::Ground;
use crate::scene::Similarity;
use crate::testing::{self, CELL_M, levels};

/// Goals of the exam.
const MAX_POSITION_M: f64 = 0.01;
const MAX_ANGLE_DEG: f64 = 0.2;

/// A world of an agent that nothing but its steps moves, and no limit ends.
fn world(scene: &Arc<SceneData>, agent: AgentConfig, drive: Drive) -> World {
    let mut config = config(1, Task::Velocity);
    config.agent = agent;
    config.drive = drive;
    config.end.time_limit_s = 1e6;
    config.end.max_deviation_m = 1e6;
    config.end.left_map_ends = false;
    config.end.unknown_ground_ends = false;
    World::new(scene.clone(), config).unwrap()
}

/// Puts the agent into a state in the first sector, at rest.
fn put(world: &mut World, state: &AgentState) {
    // Starts are in any sector; agents are placed within one recording.
    for seed in 0.. {
        world.reset(None, Some(&[Some(seed)])).unwrap();
        if world.world_from_camera(0).0 == 0 {
            break;
        }
    }
    world.place(0, 0, state).unwrap();
}

fn sector(world: &World) -> usize {
    world.world_from_camera(0).0
}

/// The corridor loop, and the same as one map in the frame of its first side.
struct Loop {
    world: World,
    whole: Ground,
    first_from: Vec<Similarity>,
    config: AgentConfig,
}

impl Loop {
    fn new(config: AgentConfig) -> Self {
        let scene = testing::corridor();
        static WHOLE: OnceLock<Vec<MapLevel>> = OnceLock::new();
        let whole =
            WHOLE.get_or_init(|| levels::levels(&scene.surfaces[0], [-1.0; 2], [13.0; 2], CELL_M));
        let roots = scene.scene.roots_from_sectors();
        Self {
            world: world(&scene.scene, config, Drive::Differential),
            whole: Ground::new(whole.to_vec(), &config).unwrap(),
            first_from: roots
                .into_iter()
                .map(|(_, first_from)| first_from)
                .collect(),
            config,
        }
    }

    /// Begins at x, y of the first side; gives the true state.
    fn start(&mut self, x: f64, y: f64, yaw: f64) -> AgentState {
        let start = AgentState::on_ground(&self.whole, &self.config, [x, y, 0.0], yaw).unwrap();
        put(&mut self.world, &start);
        start
    }

    /// A step in the sectors, and from a true state on the whole map. What blocks both is the same.
    fn step(&mut self, truth: &AgentState, action: [f64; 2], place: &str) -> Motion {
        self.world.step(&action).unwrap();
        let motion = advance(
            &self.whole,
            &self.config,
            Drive::Differential,
            truth,
            &action,
            0.1,
        );
        let block = motion
            .blocked
            .map_or(0, |blocked| block_code(blocked.reason));
        assert_eq!(self.world.result().blocked[0], block, "{place}");
        motion
    }

    /// Distance in m and angle in degrees from the true state, which must not exceed the goals.
    fn error(&self, truth: &AgentState, place: &str) -> [f64; 2] {
        let state = &self.world.states()[0];
        let found = self.first_from[sector(&self.world)].carry(&state.world_from_body());
        let difference = truth.world_from_body().inverse() * found;
        let error = [difference.distance_m(), difference.angle_rad().to_degrees()];
        assert!(
            error[0] <= MAX_POSITION_M && error[1] <= MAX_ANGLE_DEG,
            "{place}: {error:?}"
        );
        error
    }
}

#[test]
fn poses_are_the_same_there_and_back_at_20_angles_and_speeds() {
    for max_speed_m_s in [0.3, 0.8, 1.5, 3.0] {
        let mut all = Loop::new(AgentConfig {
            max_speed_m_s,
            max_acceleration_m_s2: 100.0,
            ..AgentConfig::default()
        });
        let mut worst = [0.0, 0.0];
        for number in 0..20 {
            // Up to 66.5 degrees off the normal of the border in the corner, which is diagonal.
            let yaw = 0.25 * PI + (f64::from(number) - 9.5) * 7.0_f64.to_radians();
            let place = format!("{max_speed_m_s} m/s, {yaw} rad");
            let (sin, cos) = (libm::sin(yaw), libm::cos(yaw));
            let mut truth = all.start(10.5 - 0.5 * cos, 1.5 - 0.5 * sin, yaw);
            let steps = (1.0 / (0.1 * max_speed_m_s)).round() as usize;
            let mut sectors = vec![sector(&all.world)];
            for action in [1.0, -1.0] {
                for _ in 0..steps {
                    let motion = all.step(&truth, [action, 0.0], &place);
                    assert!(motion.blocked.is_none());
                    truth = motion.state;
                    let error = all.error(&truth, &place);
                    worst = [0, 1].map(|k| f64::max(worst[k], error[k]));
                }
                sectors.push(sector(&all.world));
            }
            assert_eq!(sectors, [0, 1, 0], "{place}");
        }
        println!(
            "{max_speed_m_s} m/s: {:.2e} m, {:.2e} degrees",
            worst[0], worst[1]
        );
    }
}

#[test]
fn no_collision_is_missed_beyond_a_crossing() {
    let mut all = Loop::new(AgentConfig::default());
    let mut sectors = Vec::new();
    for number in 0..60 {
        let yaw = TAU * f64::from(number) / 60.0 + 0.01;
        let mut truth = all.start(11.0, 0.9, yaw);
        let mut path_m = 0.0;
        for _ in 0..120 {
            let place = format!("{yaw} rad after {path_m} m");
            let motion = all.step(&truth, [1.0, 0.0], &place);
            truth = motion.state;
            all.error(&truth, &place);
            path_m += motion.distance_m;
            if let Some(blocked) = motion.blocked {
                assert_eq!(blocked.reason, crate::ground::BlockReason::Obstacle);
                sectors.push(sector(&all.world));
                break;
            }
        }
    }
    // All stopped at walls, in both sectors.
    assert_eq!(sectors.len(), 60);
    assert!([0, 1].iter().all(|sector| sectors.contains(sector)));
}

#[test]
fn a_lap_ends_where_it_began() {
    let mut all = Loop::new(AgentConfig::default());
    let mut truth = all.start(2.0, 1.0, 0.0);
    let corners = [
        [11.0, 1.0],
        [11.0, 11.0],
        [1.0, 11.0],
        [1.0, 1.0],
        [2.0, 1.0],
    ];
    let mut sectors = vec![0];
    for [x, y] in corners {
        for _ in 0..200 {
            let [dx, dy] = [x - truth.position_m[0], y - truth.position_m[1]];
            if dx.hypot(dy) < 0.1 {
                break;
            }
            let turn = libm::atan2(dy, dx) - truth.yaw_rad;
            let turn = libm::atan2(libm::sin(turn), libm::cos(turn));
            let action = [
                if turn.abs() < 0.3 { 1.0 } else { 0.0 },
                turn.clamp(-1.0, 1.0),
            ];
            let place = format!("{:?}", truth.position_m);
            let motion = all.step(&truth, action, &place);
            assert!(motion.blocked.is_none());
            truth = motion.state;
            all.error(&truth, &place);
            if sectors.last() != Some(&sector(&all.world)) {
                sectors.push(sector(&all.world));
            }
        }
    }
    assert_eq!(sectors, [0, 1, 2, 3, 0]);
    let error = all.error(&truth, "after a lap");
    println!("after a lap: {:.2e} m, {:.2e} degrees", error[0], error[1]);
}

/// The pose after the first step into the second side, and where the edge carries the pose that
/// the step would have had without it. Fails where the step does not cross.
fn across(world: &mut World, start: &AgentState, action: &[f64]) -> [RigidTransform; 2] {
    let scene = world.scene().clone();
    let edge = &scene.sectors[0].edges[0];
    put(world, start);
    for _ in 0..40 {
        let before = world.states()[0];
        world.step(action).unwrap();
        assert!(!world.has_ended(0));
        if sector(world) == 1 {
            let config = world.config();
            let levels = scene.sectors[0].levels.as_ref().unwrap();
            let ground = Ground::new(levels.to_vec(), &config.agent).unwrap();
            let stayed = advance(&ground, &config.agent, config.drive, &before, action, 0.1).state;
            let expected = edge.to_from_here.carry(&stayed.world_from_body());
            return [world.states()[0].world_from_body(), expected];
        }
    }
    panic!("no crossing, at {:?}", world.states()[0]);
}

#[test]
fn edges_with_a_scale_carry_agents_and_free_cameras() {
    let scaled = SyntheticScene::corridor_loop_scaled(0.2, 1.02)
        .unwrap()
        .scene;
    for scene in [&testing::corridor().scene, &scaled] {
        let start = AgentState {
            position_m: [10.6, 1.4, 0.0],
            yaw_rad: 0.25 * PI,
            ..AgentState::default()
        };
        let mut walker = world(scene, AgentConfig::default(), Drive::Differential);
        let [found, expected] = across(&mut walker, &start, &[1.0, 0.0]);
        let difference = found.inverse() * expected;
        assert!(difference.distance_m() < 1e-6 && difference.angle_rad() < 1e-6);
        assert!(walker.states()[0].is_on_ground);

        // In flight it keeps its height, pitch and roll.
        let mut camera = world(scene, AgentConfig::default(), Drive::Free);
        let start = AgentState {
            position_m: [10.6, 1.4, 1.6],
            pitch_rad: 0.3,
            roll_rad: -0.2,
            ..start
        };
        let [found, expected] = across(&mut camera, &start, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let difference = found.inverse() * expected;
        assert!(difference.distance_m() < 1e-9 && difference.angle_rad() < 1e-6);
    }
}

#[test]
fn agents_stay_where_the_other_recording_has_no_ground_for_them() {
    let scene = &testing::corridor().scene;
    type Change = fn(&mut MapLevel);
    let changes: [(&str, Change); 3] = [
        ("3 m below", |level| {
            for layer in [&mut level.elevation, &mut level.lower, &mut level.upper] {
                layer.iter_mut().for_each(|height_m| *height_m -= 3.0);
            }
        }),
        ("unknown", |level| *level = MapLevel::unknown(level.grid)),
        ("occupied", |level| level.occupancy.fill(OCCUPIED)),
    ];
    for (name, change) in changes {
        let mut sectors = scene.sectors.clone();
        let levels = sectors[1].levels.as_mut().unwrap();
        Arc::make_mut(levels).iter_mut().for_each(change);
        let changed = Arc::new(SceneData::new(name, sectors).unwrap());
        let mut world = world(&changed, AgentConfig::default(), Drive::Differential);
        let start = AgentState {
            position_m: [10.6, 1.0, 0.0],
            is_on_ground: true,
            ..AgentState::default()
        };
        put(&mut world, &start);
        let mut blocks = 0;
        for _ in 0..40 {
            world.step(&[1.0, 0.0]).unwrap();
            let state = &world.states()[0];
            assert!(
                !world.has_ended(0) && sector(&world) == 0,
                "{name}: {state:?}"
            );
            assert!(
                state.is_on_ground && state.position_m[2].abs() < 1e-6,
                "{name}: {state:?}"
            );
            blocks += u32::from(world.result().blocked[0] != 0);
        }
        // The wall at the end of its own side stops it, as without the other one.
        assert!(
            blocks > 0 && world.states()[0].position_m[0] > 11.5,
            "{name}"
        );
    }
}
