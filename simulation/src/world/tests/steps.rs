//! Determinism, errors and what a step reports.

use super::*;
use crate::{SimulationError, SupportConfig};

const TASKS: [Task; 3] = [Task::PointGoal, Task::FollowPath, Task::Velocity];

/// All that is seen of all environments over some steps.
fn history(world: &mut World, steps: usize) -> Vec<Vec<Vec<u64>>> {
    world.reset(None, None).unwrap();
    let mut history = Vec::new();
    for _ in 0..steps {
        history.push((0..world.environments()).map(|i| bits(world, i)).collect());
        step_and_reset(world);
    }
    history
}

#[test]
fn threads_and_batches_change_no_bit() {
    let scene = room();
    for task in TASKS {
        let all = 70;
        let mut world = World::new(scene.clone(), config(all, task)).unwrap();
        let expected = history(&mut world, 150);
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let mut world = World::new(scene.clone(), config(all, task)).unwrap();
            assert!(
                pool.install(|| history(&mut world, 150)) == expected,
                "{threads} threads"
            );
        }
        for environment in [0, 31, 69] {
            let mut alone = config(1, task);
            alone.seed += environment as u64;
            let mut world = World::new(scene.clone(), alone).unwrap();
            let found = history(&mut world, 150);
            let same = found
                .iter()
                .zip(&expected)
                .all(|(a, b)| a[0] == b[environment]);
            assert!(same, "{task:?}, environment {environment} alone");
        }
    }
}

#[test]
fn episodes_end_and_are_worth_their_terms() {
    for task in TASKS {
        let mut world = World::new(room(), config(40, task)).unwrap();
        world.reset(None, None).unwrap();
        let mut ends = 0;
        for _ in 0..300 {
            let actions = actions(&world);
            world.step(&actions).unwrap();
            let (result, config) = (world.result(), world.config());
            for i in 0..40 {
                let terms = &result.reward_terms[i];
                let sum: f64 = config
                    .reward
                    .weights()
                    .iter()
                    .zip(terms)
                    .map(|(w, t)| w * t)
                    .sum();
                assert!((result.rewards[i] - sum).abs() < 1e-9);
                let is_end = result.end_reasons[i] != 0;
                assert_eq!(is_end, result.terminated[i] != result.truncated[i]);
                assert_eq!(is_end, world.has_ended(i));
                ends += usize::from(is_end);
            }
            let ended: Vec<bool> = (0..40).map(|i| world.has_ended(i)).collect();
            world.reset(Some(&ended), None).unwrap();
        }
        assert!(ends > 80, "{task:?}: {ends}");
    }
}

#[test]
fn observations_are_within_their_bounds() {
    for task in TASKS {
        let mut world = World::new(room(), config(30, task)).unwrap();
        world.reset(None, None).unwrap();
        let names: Vec<_> = world.observation_fields().iter().map(|f| f.name).collect();
        let first = if task == Task::Velocity {
            "command"
        } else {
            "goal"
        };
        assert_eq!(names, [first, "velocity", "attitude", "heights", "rays"]);
        for _ in 0..200 {
            let (low, high) = world.observation_bounds();
            assert!(
                low.iter()
                    .zip(high)
                    .all(|(l, h)| l.is_finite() && h.is_finite() && l < h)
            );
            for observation in world.observations().chunks(low.len()) {
                for ((value, low), high) in observation.iter().zip(low).zip(high) {
                    assert!((low..=high).contains(&value), "{value}");
                }
            }
            step_and_reset(&mut world);
        }
    }
}

/// Values of a named part of the observation of the first environment.
fn observed(world: &World, name: &str) -> Vec<f32> {
    let field = world
        .observation_fields()
        .iter()
        .find(|field| field.name == name);
    world.observations()[field.unwrap().elements.clone()].to_vec()
}

#[test]
fn rays_and_heights_see_the_room() {
    let mut world = World::new(room(), config(1, Task::Velocity)).unwrap();
    world.reset(None, None).unwrap();
    // Facing the box from 1 m west of it; walls are 0.16 m thick, the room is 8 x 6 m.
    let state = AgentState {
        position_m: [2.52, 3.02, 0.0],
        yaw_rad: 0.0,
        ..world.states()[0]
    };
    world.place(0, 0, &state).unwrap();
    let rays = observed(&world, "rays");
    assert!((rays[0] - 1.0).abs() < 0.05, "{rays:?}");
    assert!((rays[4] - 2.82).abs() < 0.05, "{rays:?}");
    assert!((rays[8] - 2.36).abs() < 0.05, "{rays:?}");
    assert!((rays[12] - 2.86).abs() < 0.05, "{rays:?}");
    // The last row of the scan, 1 m ahead, is in the box, where no ground is known.
    let heights = observed(&world, "heights");
    assert!(heights[..9].iter().all(|v| v.abs() < 1e-6), "{heights:?}");
    assert_eq!(heights[10], -0.5);
}

#[test]
fn bad_actions_move_nothing() {
    let mut world = World::new(room(), config(3, Task::Velocity)).unwrap();
    let error = world.step(&[0.0; 6]).unwrap_err();
    assert!(
        matches!(&error, SimulationError::State(text) if text.contains("reset")),
        "{error}"
    );
    world.reset(None, None).unwrap();
    world.step(&[0.5; 6]).unwrap();
    let before: Vec<_> = (0..3).map(|i| bits(&world, i)).collect();
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let error = world.step(&[0.1, 0.0, 0.1, value, 0.1, 0.0]).unwrap_err();
        let is_named = matches!(
            &error,
            SimulationError::Action { environment: 1, found, .. } if found.contains("component 1")
        );
        assert!(is_named, "{error}");
    }
    for actions in [&[0.0; 5][..], &[0.0; 8], &[]] {
        let error = world.step(actions).unwrap_err();
        assert!(matches!(error, SimulationError::Action { .. }), "{error}");
    }
    let after: Vec<_> = (0..3).map(|i| bits(&world, i)).collect();
    assert!(before == after);
    world.step(&[0.5; 6]).unwrap();
}

#[test]
fn actions_beyond_one_are_clipped_and_counted() {
    let mut worlds = [1.0, 7.0].map(|scale| {
        let mut world = World::new(room(), config(1, Task::Velocity)).unwrap();
        world.reset(None, None).unwrap();
        world.step(&[scale, -scale]).unwrap();
        world
    });
    assert_eq!(
        worlds.each_ref().map(|world| world.result().clipped[0]),
        [0, 2]
    );
    assert_eq!(worlds[0].states(), worlds[1].states());
    worlds[1].step(&[-1.0001, 0.3]).unwrap();
    assert_eq!(worlds[1].result().clipped[0], 3);
}

#[test]
fn failed_resets_change_nothing() {
    let mut worlds = [0, 1].map(|_| World::new(room(), config(4, Task::PointGoal)).unwrap());
    for world in &mut worlds {
        world.reset(None, None).unwrap();
        world.step(&[0.5; 8]).unwrap();
    }
    let [mut world, mut twin] = worlds;
    let before: Vec<_> = (0..4).map(|i| bits(&world, i)).collect();
    assert!(world.reset(Some(&[true; 3]), None).is_err());
    assert!(world.reset(None, Some(&[Some(1); 5])).is_err());
    let after: Vec<_> = (0..4).map(|i| bits(&world, i)).collect();
    assert!(before == after);
    // Nor what comes after: draws of the next episode, and the steps in it.
    for world in [&mut world, &mut twin] {
        world.reset(None, None).unwrap();
        world.step(&[0.5; 8]).unwrap();
    }
    assert!((0..4).all(|i| bits(&world, i) == bits(&twin, i)));
}

#[test]
fn seeds_repeat_their_episodes() {
    let mut world = World::new(room(), config(2, Task::PointGoal)).unwrap();
    let mut run = |seeds: Option<&[u64]>| {
        let mut seen = Vec::new();
        let seeds = seeds.map(|seeds| seeds.iter().copied().map(Some).collect::<Vec<_>>());
        world.reset(None, seeds.as_deref()).unwrap();
        seen.push((bits(&world, 0), bits(&world, 1)));
        world.reset(None, None).unwrap();
        seen.push((bits(&world, 0), bits(&world, 1)));
        seen
    };
    let first = run(Some(&[8, 9]));
    assert_ne!(first[0], first[1]);
    assert_ne!(first[0].0, first[0].1);
    assert!(run(Some(&[8, 9])) == first);
    assert!(run(Some(&[9, 8]))[0].0 == first[0].1);
    assert!(run(None)[0] != first[0]);
}

#[test]
fn environments_without_a_seed_go_on_beside_those_with_one() {
    let mut worlds = [0, 1].map(|_| World::new(room(), config(2, Task::PointGoal)).unwrap());
    for world in &mut worlds {
        world.reset(None, None).unwrap();
    }
    let [mut world, mut without] = worlds;
    world.reset(None, Some(&[Some(8), None])).unwrap();
    without.reset(None, None).unwrap();
    assert_eq!(world.random_key(0), (8, 0));
    assert_eq!(world.random_key(1), without.random_key(1));
    assert!(bits(&world, 1) == bits(&without, 1));
    assert!(bits(&world, 0) != bits(&without, 0));
}

#[test]
fn settings_out_of_range_are_named() {
    let with = |change: fn(&mut WorldConfig)| {
        let mut config = config(1, Task::PointGoal);
        change(&mut config);
        World::new(room(), config).unwrap_err().to_string()
    };
    for (name, error) in [
        ("environments", with(|c| c.environments = 0)),
        ("dt_s", with(|c| c.dt_s = f64::NAN)),
        ("end.time_limit_s", with(|c| c.end.time_limit_s = 0.0)),
        ("start.max_tries", with(|c| c.start.max_tries = 0)),
        ("end.min_support_db", with(|c| c.end.min_support_db = -1.0)),
        (
            "randomization.speed_scale",
            with(|c| c.randomization.speed_scale = [1.2, 0.8]),
        ),
        (
            "camera.timing.latency_s",
            with(|c| c.timing.latency_s = [0.3, 0.1]),
        ),
        (
            "camera.timing.latency_s / dt_s",
            with(|c| c.timing.latency_s = [0.0, 1.7]),
        ),
        ("reward.goal", with(|c| c.reward.goal = f64::INFINITY)),
        ("observation.rays", with(|c| c.observation.rays = 1000)),
        (
            "reward.tracking_sigma",
            with(|c| c.reward.tracking_sigma = 1e-170),
        ),
        (
            "support.headings",
            with(|c| {
                c.support = Some(SupportConfig {
                    headings: 0,
                    ..SupportConfig::default()
                });
            }),
        ),
    ] {
        assert!(error.starts_with(name), "{name}: {error}");
    }
}

#[test]
fn a_straight_walk_to_the_goal_has_spl_one() {
    let mut config = config(64, Task::PointGoal);
    config.task.goals = 8;
    config.drive = Drive::Differential;
    let mut world = World::new(room(), config).unwrap();
    world.reset(None, None).unwrap();
    let len = world.observation_bounds().0.len();
    let mut successes = 0;
    for _ in 0..80 {
        // Turns to the goal, then walks.
        let observations = world.observations().to_vec();
        let actions: Vec<f64> = observations
            .chunks(len)
            .flat_map(|observation| {
                let bearing = f64::from(observation[1]);
                let speed = if bearing.abs() < 0.1 { 1.0 } else { 0.0 };
                [speed, (4.0 * bearing).clamp(-1.0, 1.0)]
            })
            .collect();
        let result = world.step(&actions).unwrap();
        for i in 0..64 {
            if result.end_reasons[i] == EndReason::Goal as i8 {
                successes += 1;
                assert!(result.terminated[i] && result.reward_terms[i][1] == 1.0);
                // Walks that are not around the box are straight; they end within the radius.
                assert!(result.spl[i] > 0.9, "{}", result.spl[i]);
            }
        }
    }
    assert!(successes > 20, "{successes}");
}

#[test]
fn sectors_are_crossed_around_the_corridor() {
    let scene = SyntheticScene::corridor_loop().unwrap().scene;
    let mut config = config(1, Task::Velocity);
    config.end.time_limit_s = 100.0;
    config.end.max_deviation_m = 100.0;
    config.start.mode = StartMode::Recorded;
    let mut world = World::new(scene, config).unwrap();
    world.reset(None, None).unwrap();
    let mut crossings = Vec::new();
    // Along the middle of each side, a quarter turn at its end.
    let mut state = AgentState {
        position_m: [1.0, 1.0, world.states()[0].position_m[2]],
        yaw_rad: 0.0,
        ..world.states()[0]
    };
    state.position_m[2] = -0.25 * world.world_from_camera(0).0 as f64;
    let sector = world.world_from_camera(0).0;
    world.place(0, sector, &state).unwrap();
    for _ in 0..600 {
        let (sector, pose) = world.world_from_camera(0);
        let [x, y, _] = pose.translation_m();
        let yaw = world.states()[0].yaw_rad;
        let heading = if x > 11.0 - 0.05 {
            std::f64::consts::FRAC_PI_2
        } else {
            0.3 * (1.0 - y)
        };
        let turn = (2.0 * (heading - yaw)).clamp(-1.0, 1.0);
        let speed = if turn.abs() > 0.5 { 0.0 } else { 0.7 };
        world.step(&[speed, turn]).unwrap();
        assert!(!world.has_ended(0), "after {crossings:?}");
        let next = world.world_from_camera(0).0;
        if next != sector {
            crossings.push([sector, next]);
        }
    }
    // Around in one episode, each border once and in its order.
    assert!(crossings.len() >= 4, "{crossings:?}");
    assert!(
        crossings.iter().all(|[from, to]| *to == (from + 1) % 4),
        "{crossings:?}"
    );
}

#[test]
fn goals_are_carried_over_edges() {
    let scene = SyntheticScene::corridor_loop().unwrap().scene;
    let mut config = config(40, Task::PointGoal);
    config.end.time_limit_s = 100.0;
    config.end.max_deviation_m = 100.0;
    config.task.success_radius_m = 1e-6;
    let mut world = World::new(scene, config).unwrap();
    world.reset(None, None).unwrap();
    let len = world.observation_bounds().0.len();
    let mut crossings = 0;
    for step in 0..400 {
        let before: Vec<_> = (0..40)
            .map(|i| (world.world_from_camera(i).0, i * len))
            .collect();
        let observed = world.observations().to_vec();
        let actions: Vec<f64> = (0..80)
            .map(|i| match i % 2 {
                0 => 0.8,
                _ => counter_random::uniform(9, i, step) - 0.5,
            })
            .collect();
        world.step(&actions).unwrap();
        for (i, (sector, first)) in before.into_iter().enumerate() {
            // The distance to the goal changes by the length of a step, whatever the frame.
            let change_m = (world.observations()[first] - observed[first]).abs();
            assert!(world.has_ended(i) || change_m < 0.16, "{change_m}");
            crossings += usize::from(world.world_from_camera(i).0 != sector);
        }
    }
    assert!(crossings > 3, "{crossings}");
}
