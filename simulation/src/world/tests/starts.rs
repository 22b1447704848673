//! Exam 6.4: draws of starts against their conditions, computed here again.

use super::*;
use crate::SimulationError;
use crate::episode::path::horizontal_m;
use crate::episode::start::Exclusions;
use crate::ground::Ground;
use crate::reference_poses::viewing_direction;
use crate::support::SupportGrid;
use crate::support::tests::coarse;
use scene_bundle::outputs::maps::{FREE, MapLevel};
use std::collections::BTreeSet;
use std::ops::ControlFlow;

fn level(scene: &SceneData, sector: usize, level: usize) -> &MapLevel {
    &scene.sectors[sector].levels.as_ref().unwrap()[level]
}

/// Cells, by level and number, of the largest connected part of a sector's ground in which the
/// center of an agent can be.
fn largest_component(
    scene: &SceneData,
    sector: usize,
    config: &WorldConfig,
) -> BTreeSet<[usize; 2]> {
    let levels = scene.sectors[sector].levels.as_ref().unwrap();
    let ground = Ground::new(levels.to_vec(), &config.agent).unwrap();
    // The height at the place of a cell in the raster of level 0, which all levels have.
    let height_m = |level: usize, cell: usize| -> Option<f64> {
        let at_m = levels[level].grid.center_m(cell);
        ground
            .block(at_m, level)
            .is_none()
            .then(|| f64::from(levels[level].elevation[cell]))
    };
    let grid = levels[0].grid;
    assert!(levels.iter().all(|level| level.grid == grid));
    let heights: Vec<Vec<Option<f64>>> = (0..levels.len())
        .map(|level| {
            (0..grid.cells())
                .map(|cell| height_m(level, cell))
                .collect()
        })
        .collect();
    let mut seen: BTreeSet<[usize; 2]> = BTreeSet::new();
    let (mut best, mut most) = (BTreeSet::new(), 0);
    for level in 0..levels.len() {
        for cell in 0..grid.cells() {
            if heights[level][cell].is_none() || seen.contains(&[level, cell]) {
                continue;
            }
            let (mut part, mut open) = (BTreeSet::from([[level, cell]]), vec![[level, cell]]);
            while let Some([level, cell]) = open.pop() {
                let z = heights[level][cell].unwrap();
                let (column, row) = (cell % grid.columns, cell / grid.columns);
                let straight = [(1, 0), (-1, 0), (0, 1), (0, -1)];
                for (dx, dy) in straight {
                    let (Some(x), Some(y)) =
                        (column.checked_add_signed(dx), row.checked_add_signed(dy))
                    else {
                        continue;
                    };
                    if x >= grid.columns || y >= grid.rows {
                        continue;
                    }
                    let to = y * grid.columns + x;
                    for (level, heights) in heights.iter().enumerate() {
                        let is_step = |to_m: f64| (to_m - z).abs() <= config.agent.max_step_m;
                        if heights[to].is_some_and(is_step) && part.insert([level, to]) {
                            open.push([level, to]);
                        }
                    }
                }
            }
            seen.extend(&part);
            let free = part
                .iter()
                .filter(|[level, cell]| levels[*level].occupancy[*cell] == FREE);
            let count = free.count();
            if count > most {
                (best, most) = (part, count);
            }
        }
    }
    best
}

/// Distance (m) and angle (rad) of a camera to a recorded one.
fn apart(pose: &RigidTransform, reference: &RigidTransform) -> [f64; 2] {
    let [a, b] = [pose, reference].map(RigidTransform::translation_m);
    let distance_m = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    let [a, b] = [pose, reference].map(viewing_direction);
    let cosine: f64 = (0..3).map(|k| a[k] * b[k]).sum();
    [distance_m, libm::acos(cosine.clamp(-1.0, 1.0))]
}

/// Predicted PSNR as a mean of the places by hat functions of 2 m and of a third of a turn.
fn support_db(grid: &SupportGrid, corner_m: [f64; 2], state: &AgentState) -> f64 {
    let [x, y, z] = state.position_m;
    let hat = |a: f64| (1.0 - a.abs()).max(0.0);
    let (mut sum, mut weights) = (0.0, 0.0);
    for node in grid.nodes() {
        if (node.position_m[2] - z).abs() > 1.0 {
            continue;
        }
        let away = |k: usize, at: f64| {
            let point = ((node.position_m[k] - corner_m[k]) / 2.0).round();
            hat((at - corner_m[k]) / 2.0 - point)
        };
        let weight = away(0, x) * away(1, y);
        if weight == 0.0 {
            continue;
        }
        for (heading, db) in node.psnr_db.iter().enumerate() {
            let turn = std::f64::consts::TAU / 3.0;
            let between = state.yaw_rad - heading as f64 * turn;
            let between = libm::remainder(between, std::f64::consts::TAU);
            sum += weight * hat(between / turn) * f64::from(*db);
            weights += weight * hat(between / turn);
        }
    }
    sum / weights
}

/// Draws starts in resets of many environments and checks each.
fn draw(
    scene: &Arc<SceneData>,
    config: WorldConfig,
    grids: &[SupportGrid],
    resets: usize,
) -> Vec<[f64; 2]> {
    let mut world = World::new(scene.clone(), config).unwrap();
    // Made once for all worlds of a scene.
    world.shared.support = grids.to_vec();
    let mut positions = Vec::new();
    let sectors = 0..scene.sectors.len();
    let components: Vec<_> = sectors
        .map(|sector| largest_component(scene, sector, world.config()))
        .collect();
    for _ in 0..resets {
        world.reset(None, None).unwrap();
        for i in 0..world.environments() {
            let (sector, pose) = world.world_from_camera(i);
            let (state, config) = (&world.states()[i], world.config());
            let [x, y, z] = state.position_m;
            let number = state.level;
            let level = level(scene, sector, number);
            let cell = level.grid.cell([x, y]).expect("in the map");
            assert!(components[sector].contains(&[number, cell]), "connected");
            assert_eq!(level.occupancy[cell], FREE);
            assert!(
                (f64::from(level.elevation[cell]) - z).abs() <= config.agent.max_residual_m,
                "on the ground"
            );
            assert!(state.is_on_ground && state.velocity == [0.0; 3]);
            // Exact up to the half diagonal of the cell, in which the distance is interpolated.
            let distance = f64::from(level.distance[cell]);
            assert!(
                distance > config.start.min_clearance_m - 0.03,
                "clearance {distance}"
            );
            let result = world.result();
            // The recorded camera that counts is the nearest one, or one up to 10 cm farther that
            // looks in the same direction.
            let references = scene.sectors[sector].references.iter();
            let all: Vec<[f64; 2]> = references
                .map(|reference| apart(&pose, reference))
                .collect();
            let nearest_m = all.iter().map(|own| own[0]).fold(f64::INFINITY, f64::min);
            let found = [result.deviation_m[i], result.deviation_rad[i]].map(f64::from);
            let is_found = |own: &[f64; 2]| (0..2).all(|k| (own[k] - found[k]).abs() < 1e-4);
            assert!(all.iter().any(is_found), "{found:?} of no recorded camera");
            assert!(
                found[0] <= nearest_m.hypot(0.1) + 1e-4,
                "{found:?} {nearest_m}"
            );
            assert!(nearest_m <= config.end.max_deviation_m);
            if let Some(grid) = world.support().get(sector) {
                let expected_db = support_db(grid, level.grid.corner_m(), state);
                assert!((f64::from(result.support_db[i]) - expected_db).abs() < 1e-4);
                assert!(
                    expected_db >= config.start.min_support_db - 1e-9,
                    "{expected_db} dB"
                );
            }
            if config.start.mode == StartMode::Recorded {
                let [max_m, max_rad] = [config.start.max_offset_m, config.start.max_offset_rad];
                let is_within = scene.sectors[sector].references.iter().any(|reference| {
                    let [a, b] = [&pose, reference].map(viewing_direction);
                    let azimuth = |v: [f64; 3]| v[1].atan2(v[0]);
                    let yaw = (azimuth(a) - azimuth(b)).rem_euclid(std::f64::consts::TAU);
                    let yaw = yaw.min(std::f64::consts::TAU - yaw);
                    horizontal_m(pose.translation_m(), reference.translation_m()) <= max_m + 1e-9
                        && yaw <= max_rad + 1e-9
                });
                assert!(is_within, "near a recorded camera");
            }
            positions.push([x, y]);
        }
    }
    positions
}

/// Predictions in a scene, and their median, dB: a condition that half of the starts do not hold.
fn predictions(scene: &Arc<SceneData>) -> (Vec<SupportGrid>, f64) {
    let config = WorldConfig {
        support: Some(coarse()),
        ..config(1, Task::Velocity)
    };
    let mut world = World::new(scene.clone(), config).unwrap();
    world.prepare(&|_, _| ControlFlow::Continue(())).unwrap();
    let nodes = world.support().iter().flat_map(SupportGrid::nodes);
    let mut all: Vec<f32> = nodes.flat_map(|node| node.psnr_db.to_vec()).collect();
    all.sort_by(f32::total_cmp);
    assert!(all[all.len() / 10] < all[all.len() / 2]);
    (world.support().to_vec(), f64::from(all[all.len() / 2]))
}

#[test]
fn starts_hold_all_their_conditions() {
    let scenes = [
        SyntheticScene::room(),
        SyntheticScene::bridge(),
        SyntheticScene::stairs(),
        SyntheticScene::corridor_loop(),
    ];
    let mut count = 0;
    for scene in scenes.map(|scene| scene.unwrap().scene) {
        let (grids, least_db) = predictions(&scene);
        for mode in [StartMode::FreeSpace, StartMode::Recorded] {
            let mut config = config(500, Task::Velocity);
            config.start.mode = mode;
            config.support = Some(coarse());
            config.start.min_support_db = least_db;
            count += draw(&scene, config, &grids, 26).len();
        }
    }
    assert_eq!(count, 104_000);
}

#[test]
fn starts_in_free_space_are_uniform_by_area() {
    let scene = room();
    let mut config = config(1000, Task::Velocity);
    config.start.mode = StartMode::FreeSpace;
    config.end.max_deviation_m = 100.0;
    let clearance_m = config.start.min_clearance_m;
    let positions = draw(&scene, config, &[], 20);
    // Squares of 0.5 m with their area of enough clearance, by a fine raster of the exact room.
    let is_clear = |x: f64, y: f64| {
        let walls = [x - 0.16, 7.84 - x, y - 0.16, 5.84 - y];
        let from_box = (3.52 - x)
            .max(x - 4.52)
            .max(0.0)
            .hypot((2.52 - y).max(y - 3.52).max(0.0));
        walls.into_iter().fold(from_box, f64::min) >= clearance_m
    };
    let (columns, rows) = (16, 12);
    let mut areas = vec![0.0; columns * rows];
    let fine = 0.01;
    for i in 0..800 {
        for j in 0..600 {
            let [x, y] = [f64::from(i), f64::from(j)].map(|v| (v + 0.5) * fine);
            if is_clear(x, y) {
                areas[(y / 0.5) as usize * columns + (x / 0.5) as usize] += fine * fine;
            }
        }
    }
    let mut counts = vec![0.0; columns * rows];
    for [x, y] in &positions {
        counts[(y / 0.5) as usize * columns + (x / 0.5) as usize] += 1.0;
    }
    let all: f64 = areas.iter().sum();
    let (mut chi_square, mut degrees) = (0.0, -1.0);
    for (area, count) in areas.iter().zip(&counts) {
        // Squares of which borders leave slivers depend on the raster of the map.
        if *area > 0.249 {
            let expected = positions.len() as f64 * area / all;
            chi_square += (count - expected) * (count - expected) / expected;
            degrees += 1.0;
        }
    }
    // Normal approximation: 4 standard deviations, and 0.5 % for the border of the map's cells.
    assert!(degrees > 60.0);
    let limit = degrees + 4.0 * (2.0_f64 * degrees).sqrt() + 0.005_f64.powi(2) * 2e4;
    assert!(
        chi_square < limit,
        "{chi_square} with {degrees} degrees of freedom"
    );
}

#[test]
fn what_excluded_all_starts_is_named() {
    let scene = room();
    let error = |change: fn(&mut WorldConfig)| {
        let mut config = config(2, Task::PointGoal);
        config.start.max_tries = 50;
        change(&mut config);
        let mut world = World::new(scene.clone(), config).unwrap();
        world.reset(None, None).unwrap_err()
    };
    let found = error(|config| config.start.min_clearance_m = 4.0);
    assert!(
        matches!(found, SimulationError::Start { tries: 0, .. }),
        "{found}"
    );
    let found = error(|config| {
        config.start.mode = StartMode::Recorded;
        config.end.max_deviation_m = 1e-9;
        config.task.task = Task::Velocity;
    });
    let SimulationError::Start { tries, reasons } = &found else {
        panic!("{found}");
    };
    assert_eq!(*tries, 50);
    assert!(reasons.contains("too far from recorded cameras"), "{found}");
    let found = error(|config| {
        config.end.max_deviation_m = 100.0;
        config.task.goal_distance_m = [40.0, 45.0];
    });
    assert!(found.to_string().contains("no goal in range 50"), "{found}");
    let found = error(|config| {
        config.end.max_deviation_m = 100.0;
        config.support = Some(coarse());
        config.start.min_support_db = 199.0;
        config.task.task = Task::Velocity;
    });
    assert!(found.to_string().contains("support 50"), "{found}");
    let mut none = Exclusions::default();
    none.count(crate::episode::start::Condition::Clearance);
    none.count(crate::episode::start::Condition::Clearance);
    none.count(crate::episode::start::Condition::Goal);
    let text = none.error(3).to_string();
    assert!(text.ends_with("clearance 2, no goal in range 1"), "{text}");
}
