//! Processor time of single calls on one thread.

use std::hint::black_box;
use std::sync::Arc;

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use serde_json::{Value, json};
use simulation::{
    AgentState, DistanceField, Drive, Ground, ReferencePoses, SceneData, World, WorldConfig,
    advance,
};

use super::world::world;
use crate::meter::thread_cpu_s;

/// Agents and cameras at which calls are made.
const PLACES: usize = 512;

pub(super) fn measure(scene: &Arc<SceneData>, quick: bool) -> Result<Value> {
    let rounds = if quick { 4 } else { 200 };
    let world = world(scene, PLACES)?;
    let config = WorldConfig::default();
    let sector = &scene.sectors[0];
    let levels = sector.levels.as_ref().context("a scene without maps")?;
    let ground = Ground::new(levels.to_vec(), &config.agent)?;
    let references = ReferencePoses::new(sector.references.to_vec(), &config.end.units())?;
    let here: Vec<usize> = (0..PLACES)
        .filter(|place| world.world_from_camera(*place).0 == 0)
        .collect();
    let states: Vec<AgentState> = here.iter().map(|place| world.states()[*place]).collect();
    let cameras: Vec<RigidTransform> = here
        .iter()
        .map(|place| world.world_from_camera(*place).1)
        .collect();
    let goal = states.first().context("no agent in the first sector")?;
    let field = DistanceField::new(&ground, &config.agent, goal.position_m);
    let at = |state: &AgentState| [state.position_m[0], state.position_m[1]];
    let ns = |work: &dyn Fn(usize)| {
        let begin = thread_cpu_s();
        for _ in 0..rounds {
            (0..here.len()).for_each(work);
        }
        1e9 * (thread_cpu_s() - begin) / (rounds * here.len()) as f64
    };
    let height_ns = ns(&|k| {
        black_box(ground.surface(black_box(at(&states[k])), states[k].position_m[2]));
    });
    let nearest_ns = ns(&|k| {
        black_box(references.nearest(black_box(&cameras[k])));
    });
    let distance_ns = ns(&|k| {
        black_box(field.distance_m(black_box(states[k].position_m)));
    });
    let motion_ns = ns(&|k| {
        let action = black_box([0.7, 0.2]);
        black_box(advance(
            &ground,
            &config.agent,
            Drive::Differential,
            &states[k],
            &action,
            config.dt_s,
        ));
    });
    let (reset_us, save_us, restore_us, snapshot_bytes) = episodes(world, rounds)?;
    Ok(json!({
        "reference_poses": references.poses().len(),
        "cells": ground.levels().iter().map(|level| level.grid.cells()).sum::<usize>(),
        "height_ns": height_ns,
        "nearest_recorded_pose_ns": nearest_ns,
        "distance_to_goal_ns": distance_ns,
        "motion_us": motion_ns / 1e3,
        "reset_us": reset_us,
        "save_us": save_us,
        "restore_us": restore_us,
        "snapshot_bytes": snapshot_bytes,
        "goals": {
            "height_ns": 50, "nearest_recorded_pose_ns": 2000, "distance_to_goal_ns": 1000,
            "motion_us": 20, "reset_us": 1000, "save_us": 50, "restore_us": 50,
            "snapshot_bytes": 4096,
        },
    }))
}

/// Processor time of a reset, of saving and of restoring an environment, us, and the length of a
/// snapshot.
fn episodes(mut world: World, rounds: usize) -> Result<(f64, f64, f64, usize)> {
    // On this thread alone, whose processor time is measured.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| {
        let calls = (rounds / 10).max(1);
        let per_call = |begin: f64| 1e6 * (thread_cpu_s() - begin) / (calls * PLACES) as f64;
        let begin = thread_cpu_s();
        for _ in 0..calls {
            world.reset(None, None)?;
        }
        let reset_us = per_call(begin);
        let begin = thread_cpu_s();
        let mut snapshots = Vec::new();
        for _ in 0..calls {
            snapshots = (0..PLACES)
                .map(|place| world.save(place, &[]))
                .collect::<Result<Vec<_>, _>>()?;
        }
        let save_us = per_call(begin);
        let begin = thread_cpu_s();
        for _ in 0..calls {
            for (place, snapshot) in snapshots.iter().enumerate() {
                world.restore(PLACES - 1 - place, snapshot)?;
            }
        }
        let restore_us = per_call(begin);
        let bytes = snapshots.iter().map(Vec::len).max().unwrap_or(0);
        Ok((reset_us, save_us, restore_us, bytes))
    })
}
