//! Predictions of the PSNR all over the ground, against images judged one by one.

use std::sync::{Arc, Mutex};

use super::*;
use crate::agent::AgentState;
use crate::episode::task::Task;
use crate::scene::SceneData;
use crate::testing::SyntheticScene;
use crate::world::tests::{config, room};
use crate::{World, WorldConfig};

/// Few places and headings: each costs an image.
pub(crate) fn coarse() -> SupportConfig {
    SupportConfig {
        cell_m: 2.0,
        headings: 3,
        ..SupportConfig::default()
    }
}

/// A world that predicts the PSNR, as it is before its first reset.
fn world(scene: Arc<SceneData>) -> World {
    world_with(scene, coarse())
}

fn world_with(scene: Arc<SceneData>, support: SupportConfig) -> World {
    let config = WorldConfig {
        support: Some(support),
        ..config(1, Task::Velocity)
    };
    World::new(scene, config).unwrap()
}

/// Predicted PSNR of the image of an agent, without any grid.
fn judged_db(world: &World, judge: &ViewJudge, state: &AgentState) -> f64 {
    let world_from_camera = state.world_from_body() * world.shared.mount;
    f64::from(judge.psnr_db(&world_from_camera).unwrap())
}

fn judge_of(world: &World) -> ViewJudge {
    let judge = judge(&world.shared, 0, &coarse());
    judge.unwrap().unwrap()
}

fn standing(position_m: [f64; 3], yaw_rad: f64) -> AgentState {
    AgentState {
        position_m,
        yaw_rad,
        ..AgentState::default()
    }
}

#[test]
fn places_have_the_prediction_of_their_image() {
    let mut world = world(room());
    assert!(world.support().is_empty());
    let calls = Mutex::new(Vec::new());
    let progress = |done, count| {
        calls.lock().unwrap().push((done, count));
        ControlFlow::Continue(())
    };
    world.prepare(&progress).unwrap();
    let grid = &world.support()[0];
    let nodes: Vec<_> = grid.nodes().collect();
    let mut calls = calls.into_inner().unwrap();
    calls.sort_unstable();
    let count = 3 * nodes.len();
    let expected: Vec<_> = (1..=count).map(|done| (done, count)).collect();
    assert_eq!(calls, expected);
    // Points of the grid from 0 to 8 m and from 0 to 6 m; those on a wall have a place within 1 m.
    assert_eq!(nodes.len(), 5 * 4);
    let judge = judge_of(&world);
    for node in nodes.iter().step_by(7) {
        for (heading, predicted) in node.psnr_db.iter().enumerate() {
            let yaw_rad = std::f64::consts::TAU * heading as f64 / 3.0;
            let found = judged_db(&world, &judge, &standing(node.position_m, yaw_rad));
            assert_eq!(found as f32, *predicted, "{node:?} {heading}");
        }
    }
}

#[test]
fn between_places_and_headings_the_prediction_is_interpolated() {
    let mut world = world(room());
    world.prepare(&|_, _| ControlFlow::Continue(())).unwrap();
    let grid = &world.support()[0];
    let nodes: Vec<_> = grid.nodes().collect();
    // Four places around (3, 3) m in the open, at the cells of 4 cm next to their points.
    let at = |x: f64, y: f64| {
        let is_there = |at: [f64; 3]| libm::hypot(at[0] - x, at[1] - y) < 0.03;
        nodes.iter().find(|node| is_there(node.position_m)).unwrap()
    };
    let corners = [at(2.0, 2.0), at(4.0, 2.0), at(2.0, 4.0), at(4.0, 4.0)];
    let of = |heading: usize, weights: [f64; 4]| -> f64 {
        let both = corners.iter().zip(weights);
        both.map(|(node, weight)| weight * f64::from(node.psnr_db[heading]))
            .sum()
    };
    let found = grid.psnr_db([3.0, 3.0, 0.0], 0.0);
    assert!((found - of(0, [0.25; 4])).abs() < 1e-9);
    let weights = [0.6 * 0.9, 0.4 * 0.9, 0.6 * 0.1, 0.4 * 0.1];
    let yaw_rad = std::f64::consts::TAU * 2.3 / 3.0;
    for turns in [-1.0, 0.0, 3.0] {
        let yaw_rad = yaw_rad + turns * std::f64::consts::TAU;
        let found = grid.psnr_db([2.8, 2.2, 0.4], yaw_rad);
        let expected = 0.7 * of(2, weights) + 0.3 * of(0, weights);
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }
    // In the air, below the ground, outside of the map, and for what is no number.
    for (position_m, yaw_rad) in [
        ([1.25, 1.25, 1.1], 0.0),
        ([1.25, 1.25, -1.1], 0.0),
        ([-3.0, 1.0, 0.0], 0.0),
        ([1.0, 40.0, 0.0], 0.0),
        ([f64::NAN, 1.0, 0.0], 0.0),
        ([1.25, 1.25, 0.0], f64::NAN),
    ] {
        assert_eq!(grid.psnr_db(position_m, yaw_rad), 0.0, "{position_m:?}");
    }
}

/// The stairs were walked in one direction: what is ahead was seen, what is behind was not.
#[test]
fn views_along_the_walk_are_predicted_to_be_better_than_those_back() {
    let two = SupportConfig {
        cell_m: 1.0,
        headings: 2,
        ..SupportConfig::default()
    };
    let mut world = world_with(SyntheticScene::stairs().unwrap().scene, two);
    world.prepare(&|_, _| ControlFlow::Continue(())).unwrap();
    let grid = &world.support()[0];
    let mut differences = Vec::new();
    for node in grid.nodes() {
        differences.push(f64::from(node.psnr_db[0] - node.psnr_db[1]));
    }
    let mean = differences.iter().sum::<f64>() / differences.len() as f64;
    assert!(mean > 0.3, "{mean} dB");
    // The places are on the steps.
    let heights: Vec<f64> = grid.nodes().map(|node| node.position_m[2]).collect();
    assert!(heights.contains(&0.0) && heights.iter().any(|z| (z - 1.2).abs() < 1e-6));
}

#[test]
fn the_grid_does_not_depend_on_threads() {
    let of = |threads: usize| -> Vec<u32> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap().install(|| {
            let mut world = world(room());
            world.prepare(&|_, _| ControlFlow::Continue(())).unwrap();
            let grid = &world.support()[0];
            let values = grid.nodes().flat_map(|node| node.psnr_db.to_vec());
            values.map(f32::to_bits).collect()
        })
    };
    assert!(of(1) == of(3));
}

#[test]
fn the_callback_ends_it_and_the_next_call_begins_again() {
    let mut world = world(room());
    let error = world.prepare(&|done, _| match done {
        3 => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    });
    let error = error.unwrap_err().to_string();
    assert!(error.contains("was ended"), "{error}");
    assert!(world.support().is_empty());
    world.reset(None, None).unwrap();
    assert_eq!(world.support().len(), 1);
}

#[test]
fn both_levels_have_places() {
    let mut bridge = world(SyntheticScene::bridge().unwrap().scene);
    bridge.prepare(&|_, _| ControlFlow::Continue(())).unwrap();
    let grid = &bridge.support()[0];
    let [below, above] = [0.0, 2.4].map(|z| grid.psnr_db([12.0, 4.0, z], 0.0));
    assert!(below > 0.0 && above > 0.0 && below != above);
}

#[test]
fn each_sector_has_places() {
    let mut corridor = world(crate::testing::corridor().scene.clone());
    corridor.prepare(&|_, _| ControlFlow::Continue(())).unwrap();
    assert_eq!(corridor.support().len(), 4);
    for grid in corridor.support() {
        assert!(grid.nodes().count() > 5);
        assert!(grid.psnr_db([6.0, 1.0, grid.nodes().next().unwrap().position_m[2]], 0.0) > 0.0);
    }
}
