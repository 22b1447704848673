use rig_sim::scene::{Kind, Lighting, Scene};
use rig_sim::walker::Walker;

use super::super::walks::WALKS;
use super::*;

/// Walks of all wearers on flat ground and stairs.
fn walkers() -> Vec<(&'static str, Walker)> {
    let wearers = WALKS
        .iter()
        .filter_map(|walk| Some((walk.name, walk.wearer?)));
    let scenes = [Kind::Pavement, Kind::Stairs].map(|kind| Scene::new(kind, Lighting::Day, 7));
    let of = |(name, wearer): (&'static str, JointGait)| {
        let walk = |scene: &Scene| (name, Walker::with_gait(scene, 7, 8.0, &wearer));
        scenes.iter().map(walk).collect::<Vec<_>>()
    };
    wearers.flat_map(of).collect()
}

#[test]
fn feet_move_steadily_and_as_fast_as_those_of_people() {
    for (name, walker) in walkers() {
        let mut fastest = 0.0_f64;
        for side in [Side::Left, Side::Right] {
            let mut last = walker.foot(side, 1.0);
            for n in 1..7_000 {
                let time_s = 1.0 + 1e-3 * f64::from(n);
                let foot = walker.foot(side, time_s);
                let step = (foot.position - last.position).norm();
                let turn = foot.rotation.angle_to(&last.rotation);
                assert!(step < 0.008, "{} {side:?} {time_s}: {step}", name);
                assert!(turn < 0.025, "{} {side:?} {time_s}: {turn}", name);
                fastest = fastest.max(1e3 * step);
                last = foot;
            }
        }
        // The simulator's route asks for a quick long step before stairs.
        assert!((2.5..7.0).contains(&fastest), "{}: {fastest}", name);
    }
}

#[test]
fn feet_are_still_while_flat_and_no_sole_is_below_the_ground() {
    let scene = Scene::new(Kind::Pavement, Lighting::Day, 7);
    for walk in &WALKS {
        let (name, Some(wearer)) = (walk.name, walk.wearer) else {
            continue;
        };
        let walker = Walker::with_gait(&scene, 7, 8.0, &wearer);
        let mut lowest_toe = Vec::new();
        for side in [Side::Left, Side::Right] {
            let falls = walker.contacts(side);
            for (fall, next) in falls.iter().zip(&falls[1..]) {
                let (from_s, to_s) = fall.flat_phase();
                let middle = walker.foot(side, 0.5 * (from_s.max(0.0) + to_s));
                assert!((middle.position - fall.position).norm() < 1e-12);
                let mut lowest = f64::INFINITY;
                for n in 0..=60 {
                    let share = f64::from(n) / 60.0;
                    let time_s = to_s + share * (next.strike_s - to_s);
                    let foot = walker.foot(side, time_s);
                    let swing = (time_s - fall.off_s) / (next.strike_s - fall.off_s);
                    for x in SOLE_M {
                        let point = foot.position + foot.rotation * (Vector3::x() * x);
                        let ground = scene.ground(point.x, point.y, point.z + 0.3);
                        let above = point.z - ground.map_or(f64::NEG_INFINITY, |g| g.height);
                        assert!(above > -0.02, "{} {side:?} {time_s} {x}: {above}", name);
                        if (0.4..0.7).contains(&swing) {
                            lowest = lowest.min(above);
                        }
                    }
                }
                if (next.position - fall.position).norm() > 1.0 {
                    lowest_toe.push(lowest);
                }
            }
        }
        let mean = lowest_toe.iter().sum::<f64>() / lowest_toe.len() as f64;
        let least = 0.8 * wearer.clearance_m;
        assert!(
            (least..wearer.clearance_m + 0.02).contains(&mean),
            "{name}: {mean} of {lowest_toe:?}"
        );
    }
}

#[test]
fn curves_are_periodic_and_smooth() {
    for samples in [&THIGH, &KNEE, &ANKLE] {
        for n in 0..1000 {
            let phase = f64::from(n) / 1000.0;
            let step = (curve(samples, phase + 1e-3) - curve(samples, phase)).abs();
            assert!(step < 0.01, "{phase}: {step}");
        }
        assert!((curve(samples, 1.05) - samples[1].to_radians()).abs() < 1e-9);
    }
}
