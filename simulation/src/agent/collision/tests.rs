//! No motion passes what blocks it and none stops before it, on maps of random obstacles.

use counter_random::uniform;
use scene_bundle::outputs::maps::{MapLevel, OCCUPIED, UNKNOWN};

use crate::agent::tests::{CELL_M, change, flat, ground};
use crate::agent::{AgentConfig, AgentState, Drive, advance};
use crate::ground::BlockReason;
use crate::ground::Ground;

/// Without limits of acceleration: each motion has the commanded speeds.
fn config() -> AgentConfig {
    AgentConfig {
        radius_m: 0.1,
        max_acceleration_m_s2: 1e9,
        max_yaw_acceleration_rad_s2: 1e9,
        ..AgentConfig::default()
    }
}

fn occupy(level: &mut MapLevel, cell: usize) {
    level.occupancy[cell] = OCCUPIED;
    level.elevation[cell] = f32::NAN;
    level.flags[cell] = 0;
}

/// Single cells, 1 % of them obstacles and 2 % unknown, a step of 30 cm on a part.
fn random_level(seed: u64) -> MapLevel {
    let mut level = flat(2.0);
    for cell in 0..level.grid.cells() {
        let draw = uniform(seed, 40, cell as u64);
        if level.grid.center_m(cell)[0] > 1.2 {
            level.elevation[cell] = 0.3;
        }
        if draw < 0.01 {
            occupy(&mut level, cell);
        } else if draw < 0.03 {
            level.occupancy[cell] = UNKNOWN;
            level.elevation[cell] = f32::NAN;
            level.flags[cell] = 0;
        }
    }
    level
}

/// Whether all within a millimetre is blocked for a center on the lower ground.
fn is_blocked(ground: &Ground, at: [f64; 2], tolerance_m: f64) -> bool {
    [
        (0.0, 0.0),
        (1.0, 1.0),
        (1.0, -1.0),
        (-1.0, 1.0),
        (-1.0, -1.0),
    ]
    .iter()
    .all(|(x, y)| {
        let at = [at[0] + tolerance_m * x, at[1] + tolerance_m * y];
        ground.block(at, 0).is_some() || ground.surface(at, 0.0).is_some_and(|s| s.height_m > 0.2)
    })
}

#[test]
fn motions_end_where_the_first_blocked_cell_of_their_path_begins() {
    // Without bridges: each unknown cell blocks.
    let config = AgentConfig {
        max_hole_m2: 0.0,
        ..config()
    };
    let (mut stops, mut passes, mut count) = (0, 0, 0);
    for seed in 0..12 {
        let ground = ground(random_level(seed), &config);
        for k in 0..400 {
            let draw = |stream: u64| uniform(100 + seed, stream, k);
            let from = [3.0 * draw(0) - 1.9, 3.8 * draw(1) - 1.9, 0.0];
            if ground.block([from[0], from[1]], 0).is_some() {
                continue;
            }
            let yaw = std::f64::consts::TAU * (draw(2) - 0.5);
            let Some(state) = AgentState::on_ground(&ground, &config, from, yaw) else {
                continue;
            };
            let action = [2.0 * draw(3) - 1.0, 2.0 * draw(4) - 1.0];
            let dt_s = 0.02 + 1.5 * draw(5);
            let motion = advance(&ground, &config, Drive::Differential, &state, &action, dt_s);
            // The circle of the motion, by its center.
            let (speed, rate) = (
                action[0] * config.max_speed_m_s,
                action[1] * config.max_yaw_rate_rad_s,
            );
            let radius = speed / rate;
            let at = |along_m: f64| {
                let heading = yaw + along_m / speed.abs() * rate;
                [
                    from[0] + radius * (heading.sin() - yaw.sin()),
                    from[1] - radius * (heading.cos() - yaw.cos()),
                ]
            };
            count += 1;
            let samples = (motion.distance_m / 0.001) as usize;
            for sample in 0..=samples {
                passes += usize::from(is_blocked(&ground, at(0.001 * sample as f64), 0.001));
            }
            let end = at(motion.distance_m);
            let off = [0, 1].map(|k| (end[k] - motion.state.position_m[k]).abs());
            assert!(off[0] < 1e-9 && off[1] < 1e-9, "{seed} {k}: {off:?}");
            if motion.blocked.is_some() {
                stops += 1;
                let near = (0..=30).any(|sample| {
                    let at = at(motion.distance_m + 0.001 * f64::from(sample));
                    let around = [(-0.002, 0.0), (0.002, 0.0), (0.0, -0.002), (0.0, 0.002)];
                    around
                        .iter()
                        .any(|(x, y)| is_blocked(&ground, [at[0] + x, at[1] + y], 0.0))
                });
                assert!(near, "{seed} {k}: stopped before anything: {motion:?}");
            } else {
                assert!((motion.distance_m - speed.abs() * dt_s).abs() < 1e-9);
            }
        }
    }
    assert_eq!(passes, 0);
    assert!(count > 1000 && stops > count / 3, "{stops} of {count}");
}

#[test]
fn a_wall_of_two_half_steps_is_a_wall() {
    // The riser of 0.36 m passes through a cell, whose height is half of it.
    let config = AgentConfig::default();
    let mut level = flat(3.0);
    change(
        &mut level,
        |at| at[0] > 0.5,
        |level, cell| level.elevation[cell] = 0.36,
    );
    change(
        &mut level,
        |at| (at[0] - 0.525).abs() < 0.02,
        |level, cell| level.elevation[cell] = 0.18,
    );
    let ground = ground(level, &config);
    let run = |x: f64, z: f64, yaw: f64| {
        let mut state = AgentState::on_ground(&ground, &config, [x, 0.0, z], yaw).expect("ground");
        for _ in 0..20 {
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
                return (block.reason, state.position_m[0]);
            }
        }
        panic!("not blocked");
    };
    // From below it keeps its radius, since its side would touch; from above its center stops.
    let (reason, x) = run(-0.5, 0.0, 0.0);
    assert_eq!(reason, BlockReason::Step);
    assert!(x < 0.5 - config.radius_m + 1.5 * CELL_M && x > 0.5 - config.radius_m - 2.0 * CELL_M);
    let (reason, x) = run(1.5, 0.36, std::f64::consts::PI);
    assert!(
        matches!(reason, BlockReason::Drop | BlockReason::Step),
        "{reason:?}"
    );
    assert!(x > 0.5, "{x}");
}

#[test]
fn an_agent_that_slides_goes_on_along_a_wall() {
    let stops = config();
    let slides = AgentConfig {
        slides: true,
        ..stops
    };
    let mut level = flat(3.0);
    change(&mut level, |at| at[0] > 1.0, occupy);
    let ground = ground(level, &stops);
    for k in 0..100 {
        let yaw = 0.2 + 1.1 * uniform(51, 0, k);
        let from = [0.5 + 0.3 * uniform(51, 1, k), -1.5, 0.0];
        let state = AgentState::on_ground(&ground, &stops, from, yaw).expect("ground");
        let act = |config: &AgentConfig| {
            advance(
                &ground,
                config,
                Drive::Differential,
                &state,
                &[1.0, 0.0],
                1.5,
            )
        };
        let (stopped, slid) = (act(&stops), act(&slides));
        assert_eq!(stopped.blocked, slid.blocked);
        if stopped.blocked.is_none() {
            assert_eq!(stopped, slid);
            continue;
        }
        // The path along the wall is that part of the motion that is parallel to it.
        let expected = from[1] + stops.max_speed_m_s * 1.5 * yaw.sin();
        assert!(
            (slid.state.position_m[1] - expected).abs() < 1e-6,
            "{k}: {slid:?}"
        );
        assert!(slid.state.position_m[0] < 0.95, "{slid:?}");
        assert!(slid.distance_m > stopped.distance_m && slid.distance_m < 2.25);
        assert!(
            (slid.state.velocity[0] * 1.5).hypot(slid.state.velocity[1] * 1.5)
                <= slid.distance_m + 1e-9
        );
    }
}
