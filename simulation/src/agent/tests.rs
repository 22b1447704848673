//! Exams of motion (closed form), footing (exact surfaces) and collisions.

use counter_random::uniform;
use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::{FREE, KNOWN, MapLevel, OCCUPIED};

use super::*;
use crate::ground::BlockReason;
use crate::testing::SyntheticScene;

pub(super) const CELL_M: f64 = 0.05;

/// A square of level ground around the origin.
pub(super) fn flat(half_m: f64) -> MapLevel {
    let count = (2.0 * half_m / CELL_M) as usize;
    let mut level = MapLevel::unknown(Grid {
        cell_m: CELL_M,
        origin_m: [-half_m + 0.5 * CELL_M; 2],
        columns: count,
        rows: count,
    });
    for cell in 0..level.grid.cells() {
        set(&mut level, cell, 0.0);
        level.distance[cell] = f32::INFINITY;
    }
    level
}

pub(super) fn set(level: &mut MapLevel, cell: usize, height_m: f32) {
    level.elevation[cell] = height_m;
    level.occupancy[cell] = FREE;
    level.flags[cell] = KNOWN;
    level.normal[cell] = [0.0, 0.0, 1.0];
    level.clearance[cell] = f32::INFINITY;
    level.sigma[cell] = 0.002;
}

/// Changes cells with centers where `is_in` holds.
pub(super) fn change(
    level: &mut MapLevel,
    is_in: impl Fn([f64; 2]) -> bool,
    to: impl Fn(&mut MapLevel, usize),
) {
    for cell in 0..level.grid.cells() {
        if is_in(level.grid.center_m(cell)) {
            to(level, cell);
        }
    }
}

pub(super) fn ground(level: MapLevel, config: &AgentConfig) -> Ground {
    Ground::new(vec![level], config).expect("ground")
}

#[test]
fn arcs_are_those_of_the_closed_form() {
    let config = AgentConfig {
        max_acceleration_m_s2: 1e9,
        max_yaw_acceleration_rad_s2: 1e9,
        ..AgentConfig::default()
    };
    let ground = ground(flat(6.0), &config);
    for k in 0..2000 {
        let draw = |stream: u64| 2.0 * uniform(11, stream, k) - 1.0;
        let (speed, rate) = (
            draw(0) * config.max_speed_m_s,
            draw(1) * config.max_yaw_rate_rad_s,
        );
        let yaw = std::f64::consts::PI * draw(2);
        let state = AgentState::on_ground(&ground, &config, [0.3, -0.2, 0.0], yaw).expect("ground");
        let action = [
            speed / config.max_speed_m_s,
            rate / config.max_yaw_rate_rad_s,
        ];
        let moved = advance(&ground, &config, Drive::Differential, &state, &action, 0.9).state;
        let turned = rate * 0.9;
        // Around the center of the arc.
        let radius = speed / rate;
        let expected = [
            0.3 + radius * ((yaw + turned).sin() - yaw.sin()),
            -0.2 - radius * ((yaw + turned).cos() - yaw.cos()),
        ];
        let off = [0, 1].map(|i| (moved.position_m[i] - expected[i]).abs());
        // The closed form loses digits where the rate is small.
        let bound = 1e-9_f64.max(1e-15 * radius.abs());
        assert!(off[0] < bound && off[1] < bound, "{k}: {off:?}");
        let yaw_off = (moved.yaw_rad - yaw - turned).rem_euclid(2.0 * std::f64::consts::PI);
        assert!(yaw_off.min(2.0 * std::f64::consts::PI - yaw_off) < 1e-12);
    }
    let straight = AgentState::on_ground(&ground, &config, [0.0; 3], 0.0).expect("ground");
    let moved = advance(
        &ground,
        &config,
        Drive::Differential,
        &straight,
        &[1.0, 0.0],
        1.0,
    )
    .state;
    assert_eq!(moved.position_m, [config.max_speed_m_s, 0.0, 0.0]);
    // Wheels with opposite speeds turn on the spot.
    let turned = advance(
        &ground,
        &config,
        Drive::Wheels,
        &straight,
        &[-0.2, 0.2],
        1.0,
    )
    .state;
    assert_eq!(turned.position_m, [0.0; 3]);
    assert!((turned.yaw_rad - 0.4 * config.max_speed_m_s / config.track_m).abs() < 1e-12);
    // Sideways, and not faster along the diagonal.
    let moved = advance(
        &ground,
        &config,
        Drive::Holonomic,
        &straight,
        &[1.0, 1.0, 0.0],
        1.0,
    )
    .state;
    let edge = config.max_speed_m_s / 2.0_f64.sqrt();
    assert!(
        (moved.position_m[0] - edge).abs() < 1e-12 && (moved.position_m[1] - edge).abs() < 1e-12
    );
}

#[test]
fn speeds_change_within_their_limits() {
    let config = AgentConfig::default();
    let ground = ground(flat(6.0), &config);
    let mut state = AgentState::on_ground(&ground, &config, [0.0; 3], 0.0).expect("ground");
    for k in 0..200 {
        let action = [0, 1].map(|c| 2.0 * uniform(3, c, k / 5) - 1.0);
        let next = advance(&ground, &config, Drive::Differential, &state, &action, 0.05).state;
        let change = (next.velocity[0] - state.velocity[0]).abs();
        let turn = (next.velocity[2] - state.velocity[2]).abs();
        assert!(change <= config.max_acceleration_m_s2 * 0.05 + 1e-12);
        assert!(turn <= config.max_yaw_acceleration_rad_s2 * 0.05 + 1e-12);
        assert!(next.velocity[0].abs() <= config.max_speed_m_s + 1e-12);
        state = next;
    }
}

#[test]
fn height_roll_and_pitch_are_those_of_the_plane_for_every_heading() {
    let config = AgentConfig::default();
    let slopes = [0.2, -0.1];
    let scene = SyntheticScene::tilted_plane(slopes).expect("a scene");
    let levels = scene.scene.sectors[0]
        .levels
        .as_ref()
        .expect("levels")
        .to_vec();
    let ground = Ground::new(levels, &config).expect("ground");
    for degrees in 0..360 {
        let yaw = f64::from(degrees).to_radians();
        let at = [
            3.0 + 1.5 * (uniform(5, 0, degrees as u64) - 0.5),
            3.0 + 1.5 * (uniform(5, 1, degrees as u64) - 0.5),
        ];
        let truth = scene.surfaces[0].ground(at, 0.3).expect("ground");
        let state = AgentState::on_ground(&ground, &config, [at[0], at[1], truth.0], yaw);
        let state = state.expect("ground");
        assert!(state.is_on_ground);
        assert!(
            (state.position_m[2] - truth.0).abs() < 0.002,
            "{degrees}: {state:?}"
        );
        // The upward axis of the body is the normal of the plane.
        let up = state.world_from_body().rotate([0.0, 0.0, 1.0]);
        let cosine: f64 = (0..3).map(|k| up[k] * truth.1[k]).sum();
        assert!(
            cosine.min(1.0).acos().to_degrees() < 0.05,
            "{degrees}: {up:?} {:?}",
            truth.1
        );
    }
}

#[test]
fn a_wall_of_one_cell_stops_every_motion() {
    let config = AgentConfig {
        max_speed_m_s: 5.0,
        max_acceleration_m_s2: 1e9,
        max_yaw_acceleration_rad_s2: 1e9,
        ..AgentConfig::default()
    };
    let mut level = flat(4.0);
    change(
        &mut level,
        |at| (at[0] - 1.025).abs() < 0.02,
        |level, cell| {
            level.occupancy[cell] = OCCUPIED;
            level.flags[cell] = 0;
            level.elevation[cell] = f32::NAN;
        },
    );
    let ground = ground(level, &config);
    let mut reached = 0;
    for k in 0..3000 {
        let draw = |stream: u64| uniform(17, stream, k);
        let from = [-1.5 + 2.0 * draw(0), -2.0 + 4.0 * draw(1), 0.0];
        let yaw = std::f64::consts::PI * (draw(2) - 0.5);
        let state = AgentState::on_ground(&ground, &config, from, yaw).expect("ground");
        let action = [0.02 + 0.98 * draw(3), 2.0 * draw(4) - 1.0];
        let dt_s = 0.02 + 2.0 * draw(5);
        let motion = advance(&ground, &config, Drive::Differential, &state, &action, dt_s);
        let x = motion.state.position_m[0];
        // A center keeps a radius from the wall, but for the cells' size.
        assert!(x < 1.0 - config.radius_m + CELL_M, "{k}: {x}");
        if let Some(block) = motion.blocked {
            let reason = block.reason;
            let near_border = motion.state.position_m[1].abs() > 3.9 || x < -3.9;
            assert!(
                reason == BlockReason::Obstacle || near_border,
                "{k}: {block:?}"
            );
            assert_eq!(motion.state.velocity, [0.0; 3]);
            if reason == BlockReason::Obstacle {
                reached += 1;
                // No false stop: it came as near as the cells permit.
                assert!(x > 1.0 - config.radius_m - 3.0 * CELL_M, "{k}: {x}");
            }
        }
    }
    assert!(reached > 500, "{reached}");
}

#[test]
fn steps_within_the_limit_are_taken_and_others_not() {
    let config = AgentConfig::default();
    for (step_m, expected) in [
        (0.19, None),
        (-0.19, None),
        (0.21, Some(BlockReason::Step)),
        (-0.21, Some(BlockReason::Drop)),
    ] {
        let mut level = flat(3.0);
        change(
            &mut level,
            |at| at[0] > 0.5,
            |level, cell| level.elevation[cell] = step_m,
        );
        let ground = ground(level, &config);
        for k in 0..200 {
            let yaw = 1.2 * (uniform(23, 0, k) - 0.5);
            let from = [-0.4, 0.5 * (uniform(23, 1, k) - 0.5), 0.0];
            let mut state = AgentState::on_ground(&ground, &config, from, yaw).expect("ground");
            let mut blocked = None;
            for _ in 0..12 {
                let motion = advance(
                    &ground,
                    &config,
                    Drive::Differential,
                    &state,
                    &[1.0, 0.0],
                    0.1,
                );
                state = motion.state;
                blocked = blocked.or(motion.blocked.map(|block| block.reason));
            }
            assert_eq!(blocked, expected, "{step_m} {k}");
            assert_eq!(
                state.position_m[0] > 0.5,
                expected.is_none(),
                "{step_m} {k}"
            );
        }
    }
}

#[test]
fn gaps_ceilings_and_borders_stop_with_their_reason() {
    let config = AgentConfig::default();
    let unknown = |level: &mut MapLevel, cell: usize| {
        level.occupancy[cell] = scene_bundle::outputs::maps::UNKNOWN;
        level.flags[cell] = 0;
        level.elevation[cell] = f32::NAN;
    };
    let run = |level: MapLevel| {
        let ground = ground(level, &config);
        let mut state = AgentState::on_ground(&ground, &config, [0.0; 3], 0.0).expect("ground");
        for _ in 0..40 {
            let motion = advance(
                &ground,
                &config,
                Drive::Differential,
                &state,
                &[1.0, 0.0],
                0.1,
            );
            state = motion.state;
            if let Some(block) = motion.blocked {
                return (Some(block.reason), state.position_m[0]);
            }
        }
        (None, state.position_m[0])
    };
    let mut gap = flat(2.0);
    change(&mut gap, |at| (at[0] - 1.025).abs() < 0.02, unknown);
    let (reason, x) = run(gap);
    assert_eq!(reason, Some(BlockReason::Unknown));
    assert!((0.9..1.0).contains(&x), "{x}");
    for (clearance_m, expected) in [
        (1.81, BlockReason::OutsideMap),
        (1.79, BlockReason::Ceiling),
    ] {
        let mut low = flat(2.0);
        change(
            &mut low,
            |at| at[0] > 1.0,
            |level, cell| level.clearance[cell] = clearance_m,
        );
        let (reason, x) = run(low);
        assert_eq!(reason, Some(expected));
        assert_eq!(x > 1.0, expected == BlockReason::OutsideMap, "{x}");
    }
}

#[test]
fn two_levels_above_each_other_are_kept_apart() {
    let config = AgentConfig::default();
    let scene = SyntheticScene::bridge().expect("a scene");
    let levels = scene.scene.sectors[0]
        .levels
        .as_ref()
        .expect("levels")
        .to_vec();
    let ground = Ground::new(levels, &config).expect("ground");
    let mut found = [0, 0];
    for k in 0..5000 {
        let at = [12.0 * uniform(2, 0, k) - 1.0, 12.0 * uniform(2, 1, k) - 1.0];
        for (level, near) in [0.0, 3.0].into_iter().enumerate() {
            let Some((height, _)) = scene.surfaces[0].ground(at, near) else {
                continue;
            };
            if let Some(surface) = ground.surface(at, near) {
                let error_m = (surface.height_m - height).abs();
                // Cells at the rim of the bridge are up to half a cell away, never a level.
                assert!(error_m < 1.0, "{at:?} near {near}: {}", surface.height_m);
                found[level] += usize::from(error_m < 0.03);
            }
        }
    }
    assert!(found.iter().all(|count| *count > 500), "{found:?}");
}

#[test]
fn a_free_camera_moves_along_its_own_axes() {
    let config = AgentConfig::default();
    let ground = ground(flat(1.0), &config);
    let state = AgentState {
        position_m: [5.0, 6.0, 7.0],
        yaw_rad: std::f64::consts::FRAC_PI_2,
        ..AgentState::default()
    };
    let motion = advance(
        &ground,
        &config,
        Drive::Free,
        &state,
        &[1.0, 0.0, 0.0, 0.0, 0.0, 0.5],
        1.0,
    );
    let [x, y, z] = motion.state.position_m;
    assert!((x - 5.0).abs() < 1e-12 && (y - 7.5).abs() < 1e-12 && (z - 7.0).abs() < 1e-12);
    assert!((motion.state.yaw_rad - std::f64::consts::FRAC_PI_2 - 1.0).abs() < 1e-12);
    assert_eq!(motion.blocked, None);
}
