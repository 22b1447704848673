//! The predicted PSNR of views on the scene: against its held-out views, and as a grid over the
//! ground with what it costs.
//!
//! Held-out views lie on the path. Views at poses of agents have a ground truth only in the
//! benchmark `sim_truth`, views off the path in `confidence`.

use std::ops::ControlFlow;

use anyhow::{Context, Result};
use rig_sim::random;
use serde_json::{Value, json};
use simulation::{EndReason, Task, World, WorldConfig, scaled_model};
use splats::Camera;

use super::opened_scene::OpenedScene;
use crate::meter::{median, timed};

/// Mean absolute error that a prediction may have, dB.
const GOAL_DB: f64 = 1.5;
/// Columns of the images that are judged.
const COLUMNS: u32 = 96;
/// Below this PSNR views count as bad, as in the benchmark `confidence`, dB.
const MIN_SUPPORT_DB: f64 = 18.0;
/// Agents on the map, and their steps.
const AGENTS: usize = 64;
const STEPS: usize = 300;
/// Look-ups that are timed, and steps with 1024 environments.
const LOOK_UPS: usize = 1_000_000;
const ENVIRONMENTS: usize = 1024;
const TIMED_STEPS: usize = 50;
const SEED: u64 = 61;

pub(super) fn measure(scene: &OpenedScene) -> Result<Value> {
    Ok(json!({
        "goal_mae_db": GOAL_DB,
        "held_out": held_out(scene)?,
        "grid": grid(scene)?,
        "map": map(scene)?,
    }))
}

/// Predicted and real PSNR of the held-out views.
fn held_out(scene: &OpenedScene) -> Result<Value> {
    let sector = &scene.scene.sectors[0];
    let gaussians = sector.gaussians.as_ref().context("no Gaussians")?;
    let observed = gaussians.observed()?;
    let observed = observed.context("the scene has no record of what its training saw")?;
    let mut samples = Vec::new();
    for view in &sector.recording.views {
        let Some(psnr_db) = view.held_out_psnr_db else {
            continue;
        };
        let cameras = sector.recording.cameras.iter();
        let camera = cameras.clone().find(|camera| camera.name == view.camera);
        let model = camera.context("a view of no camera")?.model;
        let rows = (COLUMNS * model.height).div_ceil(model.width);
        let model = scaled_model(&model, [COLUMNS, rows])?;
        let camera = Camera::new(model, view.world_from_camera.inverse())?;
        let found = observed.confidence(&scene.renderer, &scene.content.exact, &camera)?;
        samples.push((f64::from(found.psnr_db), psnr_db));
    }
    let count = samples.len().max(1) as f64;
    let mean = samples.iter().map(|own| own.1).sum::<f64>() / count;
    let of = |error: &dyn Fn(&(f64, f64)) -> f64| samples.iter().map(error).sum::<f64>() / count;
    let rows = samples.iter();
    let rows = rows.map(|(predicted, real)| json!({ "predicted_db": predicted, "psnr_db": real }));
    Ok(json!({
        "samples": rows.collect::<Vec<_>>(),
        "mae_db": of(&|own| (own.0 - own.1).abs()),
        "bias_db": of(&|own| own.0 - own.1),
        "mae_db_of_mean": of(&|own| (own.1 - mean).abs()),
    }))
}

/// What the grid costs.
fn grid(scene: &OpenedScene) -> Result<Value> {
    let config = |environments: usize, is_predicted: bool| {
        let mut config = WorldConfig {
            environments,
            seed: SEED,
            support: is_predicted.then(Default::default),
            ..WorldConfig::default()
        };
        config.task.task = Task::Velocity;
        config
    };
    let mut world = World::new(scene.scene.clone(), config(1, true))?;
    let (made, time) = timed(|| world.prepare(&|_, _| ControlFlow::Continue(())));
    made?;
    let grid = &world.support()[0];
    let places = grid.nodes().count();
    let at = grid
        .nodes()
        .next()
        .context("a scene without ground")?
        .position_m;
    let (sum, look_ups) = timed(|| {
        let yaws = (0..LOOK_UPS).map(|k| k as f64 * 1e-3);
        yaws.map(|yaw_rad| grid.psnr_db(at, yaw_rad)).sum::<f64>()
    });
    // Alternating, so that other load of the machine slows both.
    let mut worlds = [false, true].map(|is_predicted| {
        let mut world = World::new(scene.scene.clone(), config(ENVIRONMENTS, is_predicted))?;
        world.reset(None, None)?;
        anyhow::Ok((world, Vec::new()))
    });
    for step in 0..TIMED_STEPS {
        for of in &mut worlds {
            let (world, times) = of.as_mut().map_err(|error| anyhow::anyhow!("{error}"))?;
            let actions = actions(world, step);
            let (done, time) = timed(|| world.step(&actions).map(|_| ()));
            done?;
            times.push(time.cpu_s);
        }
    }
    let [without, with] = worlds.map(|of| of.map(|(_, times)| 1e3 * median(times)));
    Ok(json!({
        "places": places,
        "images": grid.nodes().map(|node| node.psnr_db.len()).sum::<usize>(),
        "wall_s": time.wall_s,
        "cpu_s": time.cpu_s,
        "bytes": grid.bytes(),
        "look_up_ns": 1e9 * look_ups.cpu_s / LOOK_UPS as f64,
        "mean_db": sum / LOOK_UPS as f64,
        "environments": ENVIRONMENTS,
        "step_cpu_ms_without_and_with": [without?, with?],
    }))
}

/// Predictions from above, where episodes start with a threshold, and where it ends them.
fn map(scene: &OpenedScene) -> Result<Value> {
    let mut config = WorldConfig {
        environments: AGENTS,
        seed: SEED,
        ..WorldConfig::default()
    };
    config.task.task = Task::Velocity;
    config.start.min_support_db = MIN_SUPPORT_DB;
    config.end.min_support_db = MIN_SUPPORT_DB;
    config.end.unknown_ground_ends = false;
    config.end.left_map_ends = false;
    let mut world = World::new(scene.scene.clone(), config)?;
    world.reset(None, None)?;
    let position = |at: [f64; 3]| [at[0], at[1]];
    let of_world = |world: &World| -> Vec<[f64; 2]> {
        world
            .states()
            .iter()
            .map(|state| position(state.position_m))
            .collect()
    };
    let starts = of_world(&world);
    let mut truncated = Vec::new();
    for step in 0..STEPS {
        let actions = actions(&world, step);
        let result = world.step(&actions)?;
        let is_deviation = |reason: &i8| *reason == EndReason::Deviation as i8;
        let ended: Vec<bool> = result.end_reasons.iter().map(is_deviation).collect();
        let states = of_world(&world);
        truncated.extend(
            states
                .iter()
                .zip(&ended)
                .filter(|(_, is)| **is)
                .map(|(at, _)| *at),
        );
    }
    let places = world.support()[0].nodes().map(|node| {
        let values = node.psnr_db.iter().map(|db| f64::from(*db));
        let [x, y] = position(node.position_m);
        let mean = values.clone().sum::<f64>() / node.psnr_db.len() as f64;
        json!([x, y, mean, values.fold(0.0, f64::max)])
    });
    let trajectory = scene.scene.sectors[0].recording.trajectory.as_ref();
    let poses = trajectory
        .into_iter()
        .flat_map(|trajectory| trajectory.usable());
    let path = poses.map(|pose| position(pose.world_from_rig.translation_m()));
    Ok(json!({
        "min_support_db": MIN_SUPPORT_DB,
        "places_x_y_mean_best_db": places.collect::<Vec<_>>(),
        "path": path.collect::<Vec<_>>(),
        "starts": starts,
        "truncated": truncated,
    }))
}

/// Agents that walk ahead and turn at random.
fn actions(world: &World, step: usize) -> Vec<f64> {
    let count = world.environments() as u64;
    let agents = 0..count;
    let both = agents.flat_map(|agent| {
        let number = step as u64 / 10 * count + agent;
        [0.8, 1.6 * random::uniform(SEED, 0, number) - 0.8]
    });
    both.collect()
}
