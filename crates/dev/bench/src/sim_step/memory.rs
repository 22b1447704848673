//! Exam 6.15: resident memory, files and threads over 10^6 steps of 64 environments.

use std::sync::Arc;

use anyhow::Result;
use serde_json::{Value, json};
use simulation::SceneData;

use super::throughput::step_and_reset;
use super::world::{actions, world};
use crate::resident::Samples;

const ENVIRONMENTS: usize = 64;
/// Steps of all environments: calls times environments.
const STEPS: usize = 1_000_000;
const QUICK_STEPS: usize = 100_000;
const SAMPLES: usize = 100;

pub(super) fn measure(scene: &Arc<SceneData>, quick: bool) -> Result<Value> {
    let steps = if quick { QUICK_STEPS } else { STEPS };
    let mut world = world(scene, ENVIRONMENTS)?;
    let actions = actions(ENVIRONMENTS);
    let mut ended = vec![false; ENVIRONMENTS];
    let calls_per_sample = steps / ENVIRONMENTS / SAMPLES;
    let mut samples = Samples::default();
    let (mut resets, mut crossings) = (0, 0);
    let mut sectors: Vec<usize> = (0..ENVIRONMENTS)
        .map(|environment| world.world_from_camera(environment).0)
        .collect();
    for sample in 0..SAMPLES {
        for call in 0..calls_per_sample {
            let number = sample * calls_per_sample + call;
            let action = &actions[number % actions.len()];
            resets += step_and_reset(&mut world, action, &mut ended)?;
            for (environment, before) in sectors.iter_mut().enumerate() {
                let sector = world.world_from_camera(environment).0;
                // A reset may begin in another sector, which is no crossing.
                crossings += usize::from(sector != *before && !ended[environment]);
                *before = sector;
            }
        }
        samples.take()?;
    }
    let steps_per_sample = (calls_per_sample * ENVIRONMENTS) as f64;
    Ok(json!({
        "steps": calls_per_sample * SAMPLES * ENVIRONMENTS,
        "resets": resets,
        "crossings": crossings,
        "resident_bytes": samples.resident_bytes(),
        "bytes_per_10000_steps": 1e4 * samples.bytes_per_unit(steps_per_sample),
        "files": samples.files(),
        "threads": samples.threads(),
        "goal": { "bytes_per_10000_steps": 1024 },
    }))
}
