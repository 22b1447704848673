//! Steps per second, share of resets and latency.

use std::sync::Arc;

use anyhow::Result;
use serde_json::{Value, json};
use simulation::{SceneData, World};

use super::world::{actions, world};
use crate::meter::{Timing, quantile, timed};

const ENVIRONMENTS: [usize; 7] = [1, 4, 16, 64, 256, 1024, 4096];
const THREADS: [usize; 2] = [1, 2];
/// Steps of all environments of a measurement, at least.
const STEPS: usize = 400_000;
const QUICK_STEPS: usize = 20_000;
/// Calls before the measurement.
const WARM_UP: usize = 20;
/// Fewer have no 99.9th percentile but their maximum.
const MIN_CALLS_OF_P999: usize = 10_000;

pub(super) fn measure(scene: &Arc<SceneData>, quick: bool) -> Result<Value> {
    let steps = if quick { QUICK_STEPS } else { STEPS };
    let mut rows = Vec::new();
    for threads in THREADS {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()?;
        for environments in ENVIRONMENTS {
            let row = pool.install(|| run(scene, environments, steps))?;
            rows.push(json!({ "threads": threads, "environments": environments, "speed": row }));
        }
    }
    Ok(Value::Array(rows))
}

fn run(scene: &Arc<SceneData>, environments: usize, steps: usize) -> Result<Value> {
    let mut world = world(scene, environments)?;
    let actions = actions(environments);
    let mut ended = vec![false; environments];
    let calls = steps.div_ceil(environments);
    for call in 0..WARM_UP {
        step_and_reset(&mut world, &actions[call % actions.len()], &mut ended)?;
    }
    let mut latencies = Vec::with_capacity(calls);
    let mut resets = 0;
    let (result, timing): (Result<()>, Timing) = timed(|| {
        for call in 0..calls {
            let action = &actions[call % actions.len()];
            let (found, timing) = timed(|| step_and_reset(&mut world, action, &mut ended));
            resets += found?;
            latencies.push(timing.wall_s);
        }
        Ok(())
    });
    result?;
    latencies.sort_by(f64::total_cmp);
    let count = (calls * environments) as f64;
    let us = |share: f64| 1e6 * quantile(&latencies, share);
    Ok(json!({
        "steps_per_s": count / timing.wall_s,
        "cpu_us_per_step": 1e6 * timing.cpu_s / count,
        "reset_share": resets as f64 / count,
        "call_us": { "p50": us(0.5), "p95": us(0.95), "p99": us(0.99),
            "p999": (calls >= MIN_CALLS_OF_P999).then(|| us(0.999)) },
    }))
}

/// A step of all environments, and a reset of those that ended: how many.
pub(super) fn step_and_reset(
    world: &mut World,
    action: &[f64],
    ended: &mut [bool],
) -> Result<usize> {
    world.step(action)?;
    let mut count = 0;
    for (environment, ended) in ended.iter_mut().enumerate() {
        *ended = world.has_ended(environment);
        count += usize::from(*ended);
    }
    if count > 0 {
        world.reset(Some(ended), None)?;
    }
    Ok(count)
}
