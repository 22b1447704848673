//! Exam 6.15: resident memory, files and threads over 10^6 steps of 64 environments.

use std::fs;
use std::sync::Arc;

use anyhow::{Context, Result};
use harness::soak::memory;
use serde_json::{Value, json};
use simulation::SceneData;

use super::throughput::step_and_reset;
use super::world::{actions, world};

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
    let mut samples = Vec::with_capacity(SAMPLES);
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
        samples.push((memory()?.resident, entries("fd")?, entries("task")?));
    }
    // The first tenth warms up caches of the allocator.
    let settled = &samples[SAMPLES / 10..];
    let steps_per_sample = (calls_per_sample * ENVIRONMENTS) as f64;
    let points: Vec<(f64, f64)> = settled
        .iter()
        .enumerate()
        .map(|(at, (bytes, ..))| (at as f64 * steps_per_sample, *bytes as f64))
        .collect();
    let range = |of: fn(&(u64, usize, usize)) -> usize| {
        let values = || settled.iter().map(of);
        json!([values().min(), values().max()])
    };
    Ok(json!({
        "steps": calls_per_sample * SAMPLES * ENVIRONMENTS,
        "resets": resets,
        "crossings": crossings,
        "resident_bytes": [samples[0].0, samples[SAMPLES - 1].0],
        "bytes_per_10000_steps": 1e4 * slope(&points),
        "files": range(|(_, files, _)| *files),
        "threads": range(|(.., threads)| *threads),
        "goal": { "bytes_per_10000_steps": 1024 },
    }))
}

/// Slope of the line of least squares.
fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let covariance: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    let variance: f64 = points.iter().map(|p| (p.0 - x) * (p.0 - x)).sum();
    covariance / variance
}

/// Entries of a folder of `/proc/self`.
fn entries(folder: &str) -> Result<usize> {
    let path = format!("/proc/self/{folder}");
    let listed = fs::read_dir(&path).with_context(|| format!("reading {path}"))?;
    Ok(listed.count())
}
