use std::sync::Arc;

use super::*;
use crate::agent::Drive;
use crate::episode::{EndConfig, EndReason, StartMode, TaskConfig};
use crate::testing::SyntheticScene;

mod crossing;
mod ends;
mod randomization;
mod starts;
mod steps;
mod timing;

pub(crate) fn room() -> Arc<SceneData> {
    SyntheticScene::room().unwrap().scene
}

/// A world for tests: short episodes, many ends.
pub(crate) fn config(environments: usize, task: Task) -> WorldConfig {
    WorldConfig {
        environments,
        seed: 5,
        end: EndConfig {
            time_limit_s: 8.0,
            ..EndConfig::default()
        },
        task: TaskConfig {
            task,
            goals: 4,
            ..TaskConfig::default()
        },
        ..WorldConfig::default()
    }
}

/// Random actions of all environments at a step, as a function of seed, episode and its step, so
/// that environments of different worlds act alike.
pub(crate) fn actions(world: &World) -> Vec<f64> {
    let size = world.config().drive.action_size();
    let mut actions = Vec::new();
    for environment in 0..world.environments() {
        let (seed, number) = world.random_key(environment);
        let step = u64::from(world.result().steps[environment]);
        for component in 0..size as u64 {
            let index = step * size as u64 + component;
            let value = counter_random::uniform(seed.wrapping_add(977 * number), 99, index);
            actions.push(2.4 * value - if component == 0 { 0.9 } else { 1.2 });
        }
    }
    actions
}

/// Advances by a step and resets what ended.
pub(crate) fn step_and_reset(world: &mut World) {
    let actions = actions(world);
    world.step(&actions).unwrap();
    let ended: Vec<bool> = (0..world.environments())
        .map(|i| world.has_ended(i))
        .collect();
    if ended.contains(&true) {
        world.reset(Some(&ended), None).unwrap();
    }
}

/// A frame as bits.
pub(crate) fn frame_bits(frame: &FrameRequest) -> Vec<u64> {
    let noise = frame.noise;
    let mut bits = vec![frame.sector as u64, noise.seed, noise.episode, noise.frame];
    let pose = frame.world_from_camera;
    bits.extend(pose.translation_m().map(f64::to_bits));
    bits.extend(pose.rotation_wxyz().map(f64::to_bits));
    bits.extend(frame.velocity_m_s.map(f64::to_bits));
    bits.extend(frame.rate_rad_s.map(f64::to_bits));
    bits
}

/// Everything that is seen of an environment, as bits.
pub(crate) fn bits(world: &World, environment: usize) -> Vec<u64> {
    let result = world.result();
    let state = &world.states()[environment];
    let mut bits: Vec<u64> = Vec::new();
    bits.extend(
        state
            .position_m
            .iter()
            .chain(&state.velocity)
            .map(|v| v.to_bits()),
    );
    bits.extend([state.yaw_rad, state.pitch_rad, state.roll_rad].map(f64::to_bits));
    bits.push(state.level as u64);
    bits.push(result.rewards[environment].to_bits());
    bits.extend(result.reward_terms[environment].map(f64::to_bits));
    bits.extend(
        [
            result.deviation_m[environment],
            result.deviation_rad[environment],
            result.support_db[environment],
            result.path_length_m[environment],
            result.remaining_m[environment],
            result.spl[environment],
            result.soft_spl[environment],
            result.frame_age_s[environment],
        ]
        .map(|v| u64::from(v.to_bits())),
    );
    bits.extend(
        [
            result.collisions[environment],
            result.clipped[environment],
            result.steps[environment],
        ]
        .map(u64::from),
    );
    bits.extend([
        u64::from(result.terminated[environment]),
        u64::from(result.truncated[environment]),
        result.end_reasons[environment] as u64,
        result.blocked[environment] as u64,
    ]);
    let len = world.observations().len() / world.environments();
    let observation = &world.observations()[environment * len..][..len];
    bits.extend(observation.iter().map(|v| u64::from(v.to_bits())));
    let (sector, pose) = world.world_from_camera(environment);
    bits.push(sector as u64);
    bits.extend(pose.translation_m().map(f64::to_bits));
    bits.extend(pose.rotation_wxyz().map(f64::to_bits));
    bits.extend(frame_bits(&world.frame_request(environment)));
    bits
}
