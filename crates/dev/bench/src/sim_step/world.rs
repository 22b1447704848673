//! The world that all parts measure, and its actions.

use std::sync::Arc;

use anyhow::Result;
use simulation::{EndConfig, SceneData, Task, TaskConfig, World, WorldConfig};

/// Steps of an episode at most.
const EPISODE_STEPS: f64 = 50.0;

/// The world that all parts measure.
pub(super) fn world(scene: &Arc<SceneData>, environments: usize) -> Result<World> {
    let dt_s = WorldConfig::default().dt_s;
    let mut task = TaskConfig::default();
    task.task = Task::PointGoal;
    let mut end = EndConfig::default();
    end.time_limit_s = EPISODE_STEPS * dt_s;
    let config = WorldConfig {
        environments,
        seed: 1,
        end,
        task,
        ..WorldConfig::default()
    };
    let mut world = World::new(scene.clone(), config)?;
    world.reset(None, None)?;
    Ok(world)
}

/// Random actions of many steps, so that making them is not measured.
pub(super) fn actions(environments: usize) -> Vec<Vec<f64>> {
    const STEPS: usize = 16;
    let draw = |index: usize| {
        let value = counter_random::uniform(1, 2, index as u64);
        // Rather ahead than back.
        match index % 2 {
            0 => 1.6 * value - 0.6,
            _ => 2.0 * value - 1.0,
        }
    };
    let of_step = |step: usize| {
        let first = step * 2 * environments;
        (first..first + 2 * environments).map(draw).collect()
    };
    (0..STEPS).map(of_step).collect()
}
