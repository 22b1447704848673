//! Exam 6.14 in another process: an environment that was saved goes on there with the same bits,
//! its late frames too.

use std::env;
use std::fs;
use std::process::Command;

use simulation::testing::SyntheticScene;
use simulation::{Task, TimingConfig, World, WorldConfig};

/// Names the snapshot in the process that goes on from it.
const SNAPSHOT: &str = "PAWS_TEST_SNAPSHOT";
const NAME: &str = "processes::snapshots_continue_in_another_process";
const STEPS: u64 = 1000;

/// A world on the corridor of four sectors.
fn world(environments: usize, seed: u64) -> World {
    let scene = SyntheticScene::corridor_loop().unwrap().scene;
    let mut config = WorldConfig {
        environments,
        seed,
        ..WorldConfig::default()
    };
    config.task.task = Task::PointGoal;
    config.end.time_limit_s = 8.0;
    config.randomization.speed_scale = [0.7, 1.3];
    config.timing = TimingConfig::regular(10.0, 0.15);
    let mut world = World::new(scene, config).unwrap();
    world.reset(None, None).unwrap();
    world
}

/// Steps, and a hash of all that an environment said of them. Actions are those of the step for all
/// environments, and those that end are reset.
fn history(world: &mut World, of: usize, from: u64) -> String {
    let count = world.states().len();
    let mut hasher = blake3::Hasher::new();
    for step in from..from + STEPS {
        let action = [0, 1].map(|k| 2.0 * counter_random::uniform(5, k, step) - 0.9);
        let result = world.step(&action.repeat(count)).unwrap();
        hasher.update(&result.rewards[of].to_le_bytes());
        hasher.update(&result.frame_age_s[of].to_le_bytes());
        let observations = world.observations();
        let length = observations.len() / count;
        for value in &observations[of * length..(of + 1) * length] {
            hasher.update(&value.to_le_bytes());
        }
        let shown = world.frame_request(of);
        let (sector, pose) = (shown.sector, shown.world_from_camera);
        hasher.update(&sector.to_le_bytes());
        for value in pose.rotation_wxyz().into_iter().chain(pose.translation_m()) {
            hasher.update(&value.to_le_bytes());
        }
        let ended: Vec<bool> = (0..count).map(|k| world.has_ended(k)).collect();
        if ended.contains(&true) {
            world.reset(Some(&ended), None).unwrap();
        }
    }
    hasher.finalize().to_string()
}

#[test]
fn snapshots_continue_in_another_process() {
    const BEFORE: u64 = 137;
    if let Some(path) = env::var_os(SNAPSHOT) {
        // The other process: another number of environments, another seed, another index.
        let mut world = world(3, 77);
        world.restore(2, &fs::read(path).unwrap()).unwrap();
        println!("history {}", history(&mut world, 2, BEFORE + STEPS));
        return;
    }
    let mut world = world(5, 4);
    history(&mut world, 1, BEFORE);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("snapshot");
    fs::write(&path, world.save(1, &[]).unwrap()).unwrap();
    let expected = history(&mut world, 1, BEFORE + STEPS);
    let other = Command::new(env::current_exe().unwrap())
        .args(["--exact", NAME, "--nocapture"])
        .env(SNAPSHOT, &path)
        .output()
        .unwrap();
    assert!(other.status.success(), "{other:?}");
    let text = String::from_utf8(other.stdout).unwrap();
    let line = format!("history {expected}");
    assert!(text.contains(&line), "expected {line}, found {text}");
}
