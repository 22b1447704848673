//! Exam 6.14: restored environments go on with the same bits; damaged snapshots are refused.

use std::sync::Arc;

use super::*;
use crate::camera::TimingConfig;
use crate::scene::SceneData;
use crate::testing::SyntheticScene;
use crate::world::WorldConfig;
use crate::world::tests::{bits, config, room, step_and_reset};

fn random(index: u64) -> u64 {
    counter_random::bits(21, 4, index)
}

fn world(scene: &Arc<SceneData>, config: WorldConfig) -> World {
    let mut world = World::new(scene.clone(), config).unwrap();
    world.reset(None, None).unwrap();
    world
}

#[test]
fn restored_environments_go_on_with_the_same_bits() {
    let scenes = [room(), SyntheticScene::corridor_loop().unwrap().scene];
    for (number, scene) in scenes.iter().enumerate() {
        for (t, task) in [Task::PointGoal, Task::FollowPath, Task::Velocity]
            .into_iter()
            .enumerate()
        {
            let mut config = config(40, task);
            config.randomization.speed_scale = [0.7, 1.3];
            config.randomization.mount_m = 0.02;
            if t != 1 {
                config.timing = TimingConfig::gauss_gym();
            }
            let key = (number * 3 + t) as u64;
            let mut original = world(scene, config.clone());
            for _ in 0..random(key) % 150 {
                step_and_reset(&mut original);
            }
            let from = (random(key + 100) % 40) as usize;
            let attachment = [7_u8; 100];
            let snapshot = original.save(from, &attachment).unwrap();
            assert!(snapshot.len() <= MAX_SNAPSHOT_BYTES);
            let mut history = Vec::new();
            for _ in 0..1000 {
                step_and_reset(&mut original);
                history.push(bits(&original, from));
            }
            // A world of another size with another seed, another index, another number of threads.
            config.environments = 70;
            config.seed = 999;
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(3)
                .build()
                .unwrap();
            pool.install(|| {
                let mut other = world(scene, config);
                let to = (random(key + 200) % 70) as usize;
                assert_eq!(other.restore(to, &snapshot).unwrap(), attachment);
                assert!(other.save(to, &attachment).unwrap() == snapshot);
                for (step, expected) in history.iter().enumerate() {
                    step_and_reset(&mut other);
                    assert!(bits(&other, to) == *expected, "{task:?}, {step} steps on");
                }
            });
        }
    }
}

#[test]
fn environments_that_ended_stay_ended() {
    let mut original = world(&room(), config(1, Task::Velocity));
    while !original.has_ended(0) {
        original.step(&[0.1, 0.5]).unwrap();
    }
    let snapshot = original.save(0, &[]).unwrap();
    let mut other = world(&room(), config(2, Task::Velocity));
    other.restore(1, &snapshot).unwrap();
    assert!(other.has_ended(1) && !other.has_ended(0));
    assert_eq!(other.states()[1], original.states()[0]);
    // One that was never reset is restored as such.
    let fresh = World::new(room(), config(1, Task::Velocity)).unwrap();
    other.restore(0, &fresh.save(0, &[]).unwrap()).unwrap();
    assert!(matches!(
        other.step(&[0.0; 4]),
        Err(SimulationError::State(_))
    ));
}

#[test]
fn restoring_an_environment_without_an_episode_makes_no_goals() {
    let mut fresh = World::new(room(), config(1, Task::PointGoal)).unwrap();
    let snapshot = fresh.save(0, &[]).unwrap();
    fresh.restore(0, &snapshot).unwrap();
    assert!(fresh.shared.goals.is_empty());
    assert!(fresh.save(0, &[]).unwrap() == snapshot);
}

#[test]
fn snapshots_of_others_are_refused_by_name() {
    let mut here = world(&room(), config(1, Task::Velocity));
    let before = bits(&here, 0);
    let mut changed = config(1, Task::Velocity);
    changed.dt_s = 0.2;
    let stairs = SyntheticScene::stairs().unwrap().scene;
    for (name, other) in [
        ("configuration", world(&room(), changed)),
        ("scene", world(&stairs, config(1, Task::Velocity))),
    ] {
        let error = here.restore(0, &other.save(0, &[]).unwrap()).unwrap_err();
        let is_named = matches!(
            &error,
            SimulationError::Snapshot { found, .. } if found.starts_with(&format!("the {name}"))
        );
        assert!(is_named, "{error}");
    }
    let mut old = here.save(0, &[]).unwrap();
    old[MAGIC.len()] = 200;
    let error = here.restore(0, &old).unwrap_err();
    assert!(error.to_string().contains("version 200"), "{error}");
    assert!(matches!(
        here.save(1, &[]),
        Err(SimulationError::Setting { .. })
    ));
    let error = here.save(0, &[0; 4000]).unwrap_err();
    assert!(matches!(error, SimulationError::Budget { .. }), "{error}");
    assert!(bits(&here, 0) == before);
}

/// Damages a snapshot in one of several manners.
fn damage(snapshot: &[u8], number: u64) -> Vec<u8> {
    let mut bytes = snapshot.to_vec();
    let at = (random(3 * number) % bytes.len() as u64) as usize;
    let value = random(3 * number + 1);
    match number % 5 {
        0 => bytes[at] ^= 1 << (value % 8),
        1 => bytes.truncate(at),
        2 => bytes.insert(at, value as u8),
        3 => {
            bytes.remove(at);
        }
        _ => {
            for (k, byte) in bytes[at..].iter_mut().take(16).enumerate() {
                *byte = random(number * 16 + k as u64 + 1_000_000) as u8;
            }
        }
    }
    bytes
}

#[test]
fn damaged_snapshots_are_refused() {
    let mut here = world(&room(), config(1, Task::PointGoal));
    let snapshot = here.save(0, &[1, 2, 3]).unwrap();
    let before = bits(&here, 0);
    for number in 0..100_000 {
        let damaged = damage(&snapshot, number);
        if damaged == snapshot {
            continue;
        }
        let error = here.restore(0, &damaged).unwrap_err();
        assert!(
            matches!(error, SimulationError::Snapshot { .. }),
            "{number}: {error}"
        );
    }
    assert!(bits(&here, 0) == before);
    here.restore(0, &snapshot).unwrap();
}

#[test]
fn forged_snapshots_do_not_panic() {
    for timing in [TimingConfig::default(), TimingConfig::gauss_gym()] {
        forge(timing);
    }
}

fn forge(timing: TimingConfig) {
    // With a correct checksum, so that every check after it is reached.
    let mut config = config(1, Task::PointGoal);
    config.timing = timing;
    let mut here = world(&room(), config);
    for _ in 0..5 {
        here.step(&[0.3, 0.1]).unwrap();
    }
    let snapshot = here.save(0, &[]).unwrap();
    let content = &snapshot[..snapshot.len() - CHECKSUM_BYTES];
    let (mut refused, mut restored) = (0, 0);
    for number in 0..20_000 {
        let mut forged = damage(content, number);
        let checksum = blake3::hash(&forged);
        forged.extend_from_slice(&checksum.as_bytes()[..CHECKSUM_BYTES]);
        match here.restore(0, &forged) {
            Err(SimulationError::Snapshot { .. }) => refused += 1,
            Err(other) => panic!("{number}: {other}"),
            Ok(_) => {
                restored += 1;
                match here.step(&[0.3, 0.1]) {
                    Ok(_) | Err(SimulationError::State(_)) => {}
                    Err(other) => panic!("{number}: {other}"),
                }
            }
        }
    }
    assert!(refused > 1000 && restored > 1000, "{refused} {restored}");
}

#[test]
fn the_longest_queue_fits() {
    let mut config = config(1, Task::PointGoal);
    // A latency of 16 intervals of 0.1 s.
    config.timing = TimingConfig::regular(10.0, 1.6);
    config.dt_s = 0.07;
    let mut here = world(&room(), config);
    let mut most = 0;
    for step in 0..40 {
        // The first time right after the reset.
        if step > 0 {
            here.step(&[0.1, 0.4]).unwrap();
        }
        let queue = here.environments.queue[0].as_ref().unwrap();
        most = most.max(queue.in_transit.len());
        let snapshot = here.save(0, &[0; 1024]).unwrap();
        let before = here.environments.queue[0].clone();
        here.restore(0, &snapshot).unwrap();
        assert!(here.environments.queue[0] == before);
    }
    assert!((15..=17).contains(&most), "{most}");
    // A queue with another number of frames than its steps allow.
    let snapshot = here.save(0, &[]).unwrap();
    let current = here.environments.queue[0].as_ref().unwrap().current.number;
    let content = &snapshot[..snapshot.len() - CHECKSUM_BYTES];
    let bytes = current.to_le_bytes();
    let at = (0..content.len() - 8)
        .rfind(|at| content[*at..*at + 8] == bytes)
        .unwrap();
    let mut forged = content.to_vec();
    forged[at..at + 8].copy_from_slice(&(current + 1000).to_le_bytes());
    let checksum = blake3::hash(&forged);
    forged.extend_from_slice(&checksum.as_bytes()[..CHECKSUM_BYTES]);
    let error = here.restore(0, &forged).unwrap_err().to_string();
    assert!(
        error.contains(&format!("frame {}", current + 1000)),
        "{error}"
    );
}
