use super::gait::{HEEL_X, TOE_X};
use super::*;
use std::sync::Arc;

use crate::faults::{Fault, Faults, Kind as FaultKind};
use crate::scene::{Kind, by_day};

fn walk_in(kind: Kind, seconds: f64) -> (Arc<Scene>, Walker) {
    let scene = by_day(kind, 1);
    let walker = Walker::new(&scene, 1, seconds);
    (scene, walker)
}

fn walk(seconds: f64) -> (Arc<Scene>, Walker) {
    walk_in(Kind::Pavement, seconds)
}

#[test]
fn feet_are_at_rest_while_flat_and_never_sink_or_jump() {
    for kind in Kind::ALL {
        let (scene, walker) = walk_in(kind, 40.0);
        for side in [Side::Left, Side::Right] {
            let mut last: Option<FootState> = None;
            let mut flats = 0;
            for k in 0..8000 {
                let t = 0.005 * f64::from(k);
                let at = format!("{}, {side:?} at {t}", kind.name());
                let foot = walker.foot(side, t);
                if let Some(last) = last {
                    let moved = (foot.position - last.position).norm();
                    assert!(moved < 0.06, "{at}: {moved}");
                    if [foot.phase, last.phase] == [Phase::Flat; 2] {
                        assert!(moved < 1e-4, "{at}: {moved}");
                        flats += 1;
                    }
                }
                for x in [HEEL_X, TOE_X] {
                    let p = foot.position + foot.rotation * Vector3::new(x, 0.0, 0.0);
                    let ground = scene.ground(p.x, p.y, p.z + 0.4).unwrap();
                    assert!(
                        p.z - ground.height > -0.03,
                        "{at}: {p}, ground {}",
                        ground.height
                    );
                }
                last = Some(foot);
            }
            assert!(flats > 2000, "{}: {flats}", kind.name());
        }
    }
}

/// Most of a sole at rest touches the ground, and no ground penetrates the sole.
#[test]
fn soles_rest_on_supporting_ground() {
    for kind in Kind::ALL {
        let (scene, walker) = walk_in(kind, 60.0);
        for side in [Side::Left, Side::Right] {
            for fall in walker.contacts(side) {
                let (mut on, mut all) = (0, 0);
                for i in 0..=14 {
                    for y in [-gait::HALF_WIDTH, 0.0, gait::HALF_WIDTH] {
                        let x = HEEL_X + 0.02 * f64::from(i);
                        let p = fall.position + fall.rotation * Vector3::new(x, y, 0.0);
                        let ground = scene.ground(p.x, p.y, p.z + 0.4).unwrap();
                        let gap = p.z - ground.height;
                        // Protrusions between the sample points of a sole sink in.
                        let soft = if kind == Kind::Trail { 0.02 } else { 0.005 };
                        assert!(gap > -soft, "{}: {fall:?}: {gap}", kind.name());
                        all += 1;
                        on += i32::from(gap < 0.015);
                    }
                }
                // On roots and stones a few points support the sole.
                let share = if kind == Kind::Trail { 1 } else { 6 };
                assert!(
                    on * 10 > all * share,
                    "{}: {on} of {all}: {fall:?}",
                    kind.name()
                );
            }
        }
    }
}

#[test]
fn each_step_takes_one_stair() {
    let (_, walker) = walk_in(Kind::Stairs, 60.0);
    let mut falls = [Side::Left, Side::Right]
        .map(|s| walker.contacts(s).to_vec())
        .concat();
    falls.sort_by(|a, b| a.strike_s.total_cmp(&b.strike_s));
    let (mut up, mut down) = (0, 0);
    for pair in falls.windows(2) {
        let rise = pair[1].position.z - pair[0].position.z;
        assert!(rise.abs() < 0.18, "{rise}: {pair:?}");
        up += i32::from(rise > 0.16);
        down += i32::from(rise < -0.16);
    }
    // Eleven up and down in each lap, of which 60 s hold at least one.
    assert!(up >= 11 && down >= 11, "{up} {down}");
}

#[test]
fn walk_includes_standing_and_jogging_with_the_rig_above_the_feet() {
    for kind in Kind::ALL {
        let (_, walker) = walk_in(kind, 60.0);
        let (mut fastest, mut slowest) = (0.0_f64, f64::MAX);
        for k in 100..6000 {
            let t = 0.01 * f64::from(k);
            let at = format!("{} at {t}", kind.name());
            let state = walker.rig(t);
            let speed = state.velocity.xy().norm();
            (fastest, slowest) = (fastest.max(speed), slowest.min(speed));
            assert!(
                state.acceleration.norm() < 40.0,
                "{at}: {}",
                state.acceleration
            );
            assert!(
                state.angular_rate.norm() < 4.0,
                "{at}: {}",
                state.angular_rate
            );
            let feet = [Side::Left, Side::Right].map(|side| walker.foot(side, t).position);
            let between = (feet[0] + feet[1]) * 0.5;
            assert!((state.position - between).xy().norm() < 0.75, "{at}");
            let height = state.position.z - feet[0].z.min(feet[1].z);
            assert!((1.05..1.55).contains(&height), "{at}: {height}");
        }
        let jogs = matches!(kind, Kind::Pavement | Kind::Corridor);
        let expected = if jogs { 2.3 } else { 1.0 };
        assert!(slowest < 0.05 && fastest > expected, "{slowest} {fastest}");
    }
}

/// Independent check of ground truth: integration of an ideal IMU at the rig's origin.
#[test]
fn perfect_imu_integrates_to_the_pose() {
    let (_, walker) = walk(20.0);
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let (from, to, steps) = (5.0, 15.0, 100_000);
    let dt = (to - from) / f64::from(steps);
    let start = walker.rig(from);
    let (mut p, mut v, mut r) = (start.position, start.velocity, start.rotation);
    for k in 0..steps {
        let t = from + dt * (f64::from(k) + 0.5);
        let state = walker.rig(t);
        let force = state.rotation.inverse() * (state.acceleration - gravity);
        // Midpoint rule; the rotation at the middle includes half of the step.
        let middle = r * so3::exp(state.angular_rate * (0.5 * dt));
        let a = middle * force + gravity;
        p += v * dt + a * (0.5 * dt * dt);
        v += a * dt;
        r *= so3::exp(state.angular_rate * dt);
    }
    let end = walker.rig(to);
    let off = (p - end.position).norm();
    let rotation_deg = r.angle_to(&end.rotation).to_degrees();
    assert!(
        off < 1e-3 && rotation_deg < 0.01,
        "{off} m, {rotation_deg} degrees"
    );
}

/// Published figures of walking at a usual speed (Winter 1991; Moosabhoy and Gard 2006): the toe
/// passes the ground by 1 to 3 cm at mid-swing, the heel rises by a quarter of a meter, and the
/// foot is three to four times as fast as the body.
#[test]
fn swings_on_flat_ground_are_like_those_of_people() {
    let scene = by_day(Kind::Pavement, 1);
    let mut clearances = Vec::new();
    for seed in 1..=6 {
        let walker = Walker::new(&scene, seed, 30.0);
        for side in [Side::Left, Side::Right] {
            for pair in walker.contacts(side).windows(2) {
                let [from, to] = pair else { unreachable!() };
                let level = (from.position.z - to.position.z).abs() < 0.01;
                let usual = (1.2..1.5).contains(&from.speed) && (1.2..1.5).contains(&to.speed);
                if !level || !usual || to.strike_s > 30.0 {
                    continue;
                }
                let swing = to.strike_s - from.off_s;
                let at = |t: f64| walker.foot(side, from.off_s + t * swing);
                let point = |t: f64, x: f64| {
                    let foot = at(t);
                    foot.position + foot.rotation * Vector3::new(x, 0.0, 0.0)
                };
                let over = |t: f64, x: f64| {
                    let p = point(t, x);
                    p.z - scene.ground(p.x, p.y, p.z + 0.4).unwrap().height
                };
                let middle = (35..=60).map(|k| over(0.01 * f64::from(k), TOE_X));
                clearances.push(middle.fold(f64::MAX, f64::min));
                let heel = (0..=50).map(|k| over(0.01 * f64::from(k), HEEL_X));
                let heel = heel.fold(0.0, f64::max);
                assert!((0.18..0.34).contains(&heel), "{from:?} {to:?}: {heel}");
                let speed = |k: i32| {
                    let [a, b] = [0.01 * f64::from(k), 0.01 * f64::from(k + 1)];
                    (at(b).position - at(a).position).norm() / (0.01 * swing)
                };
                let fastest = (0..100).map(speed).fold(0.0, f64::max);
                assert!((3.6..6.0).contains(&fastest), "{from:?} {to:?}: {fastest}");
                // The foot goes on as it was when the toe leaves the ground.
                let h = 1e-4;
                let before = walker.foot(side, from.off_s - h).position;
                let now = walker.foot(side, from.off_s).position;
                let after = walker.foot(side, from.off_s + h).position;
                let jump = (after - now - (now - before)).norm() / h;
                assert!(jump < 0.05, "{from:?}: {jump} m/s");
            }
        }
    }
    clearances.sort_by(f64::total_cmp);
    let of = |share: f64| clearances[(share * (clearances.len() - 1) as f64) as usize];
    let found = [of(0.05), of(0.5), of(0.95)];
    assert!(clearances.len() > 100, "{}", clearances.len());
    assert!(found[0] > 0.008 && found[2] < 0.045, "{found:?}");
    assert!((0.012..0.03).contains(&found[1]), "{found:?}");
}

#[test]
fn wearers_differ() {
    let scene = by_day(Kind::Pavement, 1);
    let walkers = [1, 2, 3].map(|seed| Walker::new(&scene, seed, 20.0));
    let heights = walkers.each_ref().map(|w| w.rig(10.0).position.z);
    let steps = walkers.each_ref().map(|w| w.contacts(Side::Left)[4]);
    for (k, other) in [(0, 1), (1, 2), (0, 2)] {
        assert!((heights[k] - heights[other]).abs() > 0.005, "{heights:?}");
        assert!(steps[k].strike_pitch_rad != steps[other].strike_pitch_rad);
        assert!(steps[k].strike_s != steps[other].strike_s);
    }
}

/// A walk with a fault on both feet from 3 s on.
fn walk_with(kind: FaultKind, strength: f64) -> (Arc<Scene>, Walker) {
    let fault = Fault {
        kind,
        strength,
        from_s: 3.0,
        to_s: f64::INFINITY,
        camera: None,
        foot: None,
    };
    let faults = Faults {
        list: vec![fault],
        seed: 1,
    };
    let scene = by_day(Kind::Pavement, 1);
    let walker = Walker::with_faults(&scene, 1, 15.0, &faults.of_wearer());
    (scene, walker)
}

#[test]
fn feet_slide_and_sink_in_every_stance() {
    let (_, exact) = walk(15.0);
    let (_, slides) = walk_with(FaultKind::FootSlip, 0.05);
    let (_, sinks) = walk_with(FaultKind::SoftGround, 0.04);
    for side in [Side::Left, Side::Right] {
        let falls = exact.contacts(side);
        for (fall, next) in falls.iter().zip(&falls[1..]) {
            let (flat, heel_off) = fall.flat_phase();
            let acts = fall.strike_s >= 3.0;
            let moved = slides.foot(side, heel_off).position - exact.foot(side, heel_off).position;
            let expected = if acts { 0.05 } else { 0.0 };
            if heel_off - flat > SLIDE_S {
                assert!(
                    (moved.norm() - expected).abs() < 1e-9,
                    "{} {moved}",
                    fall.strike_s
                );
            }
            let sunk = exact.foot(side, flat).position.z - sinks.foot(side, flat).position.z;
            let expected = if acts { 0.04 } else { 0.0 };
            assert!((sunk - expected).abs() < 1e-9, "{} {sunk}", fall.strike_s);
            // Feet move without jumps between stances.
            for walker in [&slides, &sinks] {
                let mut last = walker.foot(side, fall.strike_s).position;
                let steps = ((next.strike_s - fall.strike_s) / 0.005) as i32;
                for k in 0..=steps {
                    let here = walker
                        .foot(side, fall.strike_s + 0.005 * f64::from(k))
                        .position;
                    assert!((here - last).norm() < 0.06, "{} {k}", fall.strike_s);
                    last = here;
                }
            }
        }
    }
}

#[test]
fn wearer_stops_and_jumps_with_both_feet() {
    let (_, walker) = walk_with(FaultKind::Jump, 0.2);
    let flight = (8.0_f64 * 0.2 / 9.81).sqrt();
    let is_air =
        |t: f64| [Side::Left, Side::Right].map(|s| walker.foot(s, t).phase == Phase::Swing);
    let air: Vec<f64> = (0..3000)
        .map(|k| 0.005 * f64::from(k))
        .filter(|&t| is_air(t) == [true; 2])
        .collect();
    // The wearer of this seed does not run before.
    let (from, to) = (air[0], air[air.len() - 1]);
    assert!(
        (to - from - flight).abs() < 0.02 && from > 4.0,
        "{from} {to}"
    );
    let top = 0.5 * (from + to);
    for side in [Side::Left, Side::Right] {
        let rise = walker.foot(side, top).position.z - walker.foot(side, from - 0.02).position.z;
        assert!((rise - 0.2).abs() < 0.002, "{rise}");
        let falls = walker.contacts(side);
        assert!(falls.iter().any(|f| (f.off_s - from).abs() < 0.01));
        assert!(falls.iter().any(|f| (f.strike_s - to).abs() < 0.01));
    }
    let chest = walker.rig(top).position.z - walker.rig(from - 1.0).position.z;
    assert!((0.17..0.23).contains(&chest), "{chest}");
    // Nearly weightless in flight.
    let weight = walker.rig(top).acceleration.z + 9.81;
    assert!(weight.abs() < 1.0, "{weight}");
    assert!(walker.rig(15.0).position.xy() != walker.rig(to + 0.5).position.xy());
}
