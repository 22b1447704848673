//! Exam 6.4: draws of starts against their conditions, computed here again.

use super::*;
use crate::SimulationError;
use crate::episode::path::horizontal_m;
use crate::episode::start::Exclusions;
use crate::reference_poses::{SupportMap, SupportSample, viewing_direction};
use scene_bundle::outputs::maps::{FREE, MapLevel};

/// 30 dB at recorded cameras, 4 dB less per m.
fn support() -> SupportMap {
    let sample = |i: u32| {
        let distance_m = 0.05 * f64::from(i);
        SupportSample {
            distance_m,
            angle_rad: 0.0,
            psnr_db: 30.0 - 4.0 * distance_m,
        }
    };
    SupportMap::fit(&(0..60).map(sample).collect::<Vec<_>>()).unwrap()
}

fn level(scene: &SceneData, sector: usize, level: usize) -> &MapLevel {
    &scene.sectors[sector].levels.as_ref().unwrap()[level]
}

/// Draws starts in resets of many environments and checks each.
fn draw(scene: &Arc<SceneData>, config: WorldConfig, resets: usize) -> Vec<[f64; 2]> {
    let mut world = World::new(scene.clone(), config).unwrap();
    let mut positions = Vec::new();
    for _ in 0..resets {
        world.reset(None, None).unwrap();
        for i in 0..world.environments() {
            let (sector, pose) = world.world_from_camera(i);
            let (state, config) = (&world.states()[i], world.config());
            let [x, y, z] = state.position_m;
            let level = level(scene, sector, state.level);
            let cell = level.grid.cell([x, y]).expect("in the map");
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
            assert!(f64::from(result.deviation_m[i]) <= config.end.max_deviation_m);
            assert!(f64::from(result.support_db[i]) >= config.start.min_support_db - 1e-4);
            assert!(config.support.is_none() || result.support_db[i] > 0.0);
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
        for mode in [StartMode::FreeSpace, StartMode::Recorded] {
            let mut config = config(500, Task::Velocity);
            config.start.mode = mode;
            config.support = Some(support());
            config.start.min_support_db = 22.0;
            count += draw(&scene, config, 26).len();
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
    let positions = draw(&scene, config, 20);
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
    let mut none = Exclusions::default();
    none.count(crate::episode::start::Condition::Clearance);
    none.count(crate::episode::start::Condition::Clearance);
    none.count(crate::episode::start::Condition::Goal);
    let text = none.error(3).to_string();
    assert!(text.ends_with("clearance 2, no goal in range 1"), "{text}");
}
