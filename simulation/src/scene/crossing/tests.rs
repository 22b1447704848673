//! Exam 6.6, the part without images: poses and collisions over the edges of a loop of sectors.

use std::f64::consts::{PI, TAU};

use super::*;
use crate::agent::{AgentConfig, AgentState, BlockReason, Drive, Motion, advance};
use crate::ground::Ground;
use crate::scene::Similarity;
use crate::testing::{CELL_M, SyntheticScene, levels};

/// Goals of the exam.
const MAX_POSITION_M: f64 = 0.01;
const MAX_ANGLE_DEG: f64 = 0.2;

/// The corridor loop, and the same as one map in the frame of its first side.
struct Loop {
    scene: SyntheticScene,
    grounds: Vec<Ground>,
    whole: Ground,
    first_from: Vec<Similarity>,
    config: AgentConfig,
}

impl Loop {
    fn new(config: AgentConfig) -> Self {
        let scene = SyntheticScene::corridor_loop().unwrap();
        let ground = |levels: &[_]| Ground::new(levels.to_vec(), &config).unwrap();
        let sectors = &scene.scene.sectors;
        let grounds = sectors
            .iter()
            .map(|sector| ground(sector.levels.as_ref().unwrap()));
        let whole = levels::levels(&scene.surfaces[0], [-1.0; 2], [13.0; 2], CELL_M);
        // Once around, edge by edge.
        let mut first_from = vec![Similarity::identity()];
        for side in 0..3 {
            let edge = sectors[side]
                .edges
                .iter()
                .find(|edge| edge.to == side + 1)
                .unwrap();
            first_from.push(first_from[side].compose(&edge.to_from_here.inverse()));
        }
        Self {
            grounds: grounds.collect(),
            whole: ground(&whole),
            scene,
            first_from,
            config,
        }
    }

    /// A step in the sectors, with the edges that it crosses.
    fn step(&self, sector: &mut usize, state: &AgentState, action: [f64; 2]) -> Motion {
        let mut motion = self.advance(&self.grounds[*sector], state, action);
        let place = self.scene.scene.cross(&Place {
            sector: *sector,
            sector_from_body: motion.state.world_from_body(),
        });
        let forward = place.sector_from_body.rotate([1.0, 0.0, 0.0]);
        motion.state.position_m = place.sector_from_body.translation_m();
        motion.state.yaw_rad = libm::atan2(forward[1], forward[0]);
        *sector = place.sector;
        motion
    }

    fn advance(&self, ground: &Ground, state: &AgentState, action: [f64; 2]) -> Motion {
        advance(
            ground,
            &self.config,
            Drive::Differential,
            state,
            &action,
            0.1,
        )
    }

    /// Distance in m and angle in degrees between a state in a sector and the true one.
    fn error(&self, sector: usize, state: &AgentState, truth: &AgentState) -> [f64; 2] {
        let found = self.first_from[sector].carry(&state.world_from_body());
        let difference = truth.world_from_body().inverse() * found;
        [difference.distance_m(), difference.angle_rad().to_degrees()]
    }

    fn start(&self, x: f64, y: f64, yaw: f64) -> AgentState {
        let start = AgentState::on_ground(&self.grounds[0], &self.config, [x, y, 0.0], yaw);
        start.unwrap()
    }
}

fn check(error: [f64; 2], place: &str) {
    assert!(
        error[0] <= MAX_POSITION_M && error[1] <= MAX_ANGLE_DEG,
        "{place}: {error:?}"
    );
}

#[test]
fn poses_are_the_same_there_and_back_at_20_angles_and_speeds() {
    for max_speed_m_s in [0.3, 0.8, 1.5, 3.0] {
        let all = Loop::new(AgentConfig {
            max_speed_m_s,
            max_acceleration_m_s2: 100.0,
            ..AgentConfig::default()
        });
        let mut worst = [0.0, 0.0];
        for number in 0..20 {
            // Up to 66.5 degrees off the normal of the border in the corner, which is diagonal.
            let yaw = 0.25 * PI + (f64::from(number) - 9.5) * 7.0_f64.to_radians();
            let (sin, cos) = (libm::sin(yaw), libm::cos(yaw));
            let mut state = all.start(10.5 - 0.5 * cos, 1.5 - 0.5 * sin, yaw);
            let (mut truth, mut sector) = (state, 0);
            let steps = (1.0 / (0.1 * max_speed_m_s)).round() as usize;
            let mut sectors = vec![sector];
            for action in [1.0, -1.0] {
                for _ in 0..steps {
                    let motion = all.step(&mut sector, &state, [action, 0.0]);
                    let of_truth = all.advance(&all.whole, &truth, [action, 0.0]);
                    assert!(motion.blocked.is_none() && of_truth.blocked.is_none());
                    (state, truth) = (motion.state, of_truth.state);
                    let error = all.error(sector, &state, &truth);
                    check(error, &format!("{max_speed_m_s} m/s, {yaw} rad"));
                    worst = [0, 1].map(|k| f64::max(worst[k], error[k]));
                }
                sectors.push(sector);
            }
            assert_eq!(sectors, [0, 1, 0], "{max_speed_m_s} m/s, {yaw} rad");
        }
        println!(
            "{max_speed_m_s} m/s: {:.2e} m, {:.2e} degrees",
            worst[0], worst[1]
        );
    }
}

#[test]
fn no_collision_is_missed_beyond_a_crossing() {
    let all = Loop::new(AgentConfig::default());
    let mut kinds = Vec::new();
    for number in 0..60 {
        let yaw = TAU * f64::from(number) / 60.0 + 0.01;
        let mut state = all.start(11.0, 0.9, yaw);
        let (mut truth, mut sector) = (state, 0);
        let mut path = 0.0;
        for _ in 0..120 {
            let motion = all.step(&mut sector, &state, [1.0, 0.0]);
            let of_truth = all.advance(&all.whole, &truth, [1.0, 0.0]);
            let reasons = [motion, of_truth].map(|motion| motion.blocked.map(|of| of.reason));
            assert_eq!(reasons[0], reasons[1], "{yaw} rad after {path} m");
            (state, truth) = (motion.state, of_truth.state);
            check(
                all.error(sector, &state, &truth),
                &format!("{yaw} rad after {path} m"),
            );
            path += of_truth.distance_m;
            if of_truth.blocked.is_some() {
                kinds.push((sector, reasons[0].unwrap()));
                break;
            }
        }
    }
    // All stopped at walls, in both sectors.
    assert_eq!(kinds.len(), 60);
    assert!(
        kinds
            .iter()
            .all(|(_, reason)| *reason == BlockReason::Obstacle),
        "{kinds:?}"
    );
    assert!(
        [0, 1]
            .iter()
            .all(|sector| kinds.iter().any(|(of, _)| of == sector))
    );
}

#[test]
fn a_lap_ends_where_it_began() {
    let all = Loop::new(AgentConfig::default());
    let mut state = all.start(2.0, 1.0, 0.0);
    let (mut truth, mut sector) = (state, 0);
    let corners = [
        [11.0, 1.0],
        [11.0, 11.0],
        [1.0, 11.0],
        [1.0, 1.0],
        [2.0, 1.0],
    ];
    let mut sectors = vec![sector];
    for [x, y] in corners {
        for _ in 0..200 {
            let [dx, dy] = [x - truth.position_m[0], y - truth.position_m[1]];
            if dx.hypot(dy) < 0.1 {
                break;
            }
            let turn = libm::atan2(dy, dx) - truth.yaw_rad;
            let turn = libm::atan2(libm::sin(turn), libm::cos(turn));
            let action = [
                if turn.abs() < 0.3 { 1.0 } else { 0.0 },
                turn.clamp(-1.0, 1.0),
            ];
            let motion = all.step(&mut sector, &state, action);
            let of_truth = all.advance(&all.whole, &truth, action);
            assert!(motion.blocked.is_none() && of_truth.blocked.is_none());
            (state, truth) = (motion.state, of_truth.state);
            check(
                all.error(sector, &state, &truth),
                &format!("{:?}", truth.position_m),
            );
            if sectors.last() != Some(&sector) {
                sectors.push(sector);
            }
        }
    }
    assert_eq!(sectors, [0, 1, 2, 3, 0]);
    let error = all.error(sector, &state, &truth);
    println!("after a lap: {:.2e} m, {:.2e} degrees", error[0], error[1]);
}

#[test]
fn agents_on_the_border_do_not_flicker() {
    let scene = SyntheticScene::corridor_loop().unwrap().scene;
    let (mut place, mut changes) = (at(0, 11.0, 1.0), 0);
    for step in 0..1000 {
        // Five centimetres along the normal to either side: less than the hysteresis.
        let away = 0.05 * libm::sin(f64::from(step));
        let along = away * std::f64::consts::FRAC_1_SQRT_2;
        let here = at(0, 11.0 + along, 1.0 + along);
        let sector = place.sector;
        let pose = match sector {
            0 => here.sector_from_body,
            _ => scene.sectors[0].edges[0]
                .to_from_here
                .carry(&here.sector_from_body),
        };
        place = scene.cross(&Place {
            sector,
            sector_from_body: pose,
        });
        changes += usize::from(place.sector != sector);
    }
    assert_eq!(changes, 0);
}

fn at(sector: usize, x: f64, y: f64) -> Place {
    Place {
        sector,
        sector_from_body: RigidTransform::from_translation_m([x, y, 0.0]).unwrap(),
    }
}

#[test]
fn weights_of_a_fade_are_complements() {
    let scene = SyntheticScene::corridor_loop().unwrap().scene;
    let edge = &scene.sectors[0].edges[0];
    for step in -60..60 {
        let along = 0.01 * f64::from(step) * std::f64::consts::FRAC_1_SQRT_2;
        let here = [11.0 + along, 1.0 + along, 0.5];
        let there = edge.to_from_here.apply(here);
        let weight = |sector, at| scene.fade(sector, at).map_or(0.0, |(_, weight)| weight);
        let (a, b) = (weight(0, here), weight(1, there));
        assert!(
            (a + b - 1.0).abs() < 1e-9 || (a == 0.0 && b == 1.0),
            "{a} {b}"
        );
        assert!(
            (a - 0.5).abs() < 1e-9 || (a > 0.5) == (step > 0),
            "{step} {a}"
        );
    }
    assert!(scene.fade(0, [6.0, 1.0, 0.5]).is_none());
}
