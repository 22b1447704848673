use super::*;
use crate::scene::mesh::Triangle;
use crate::scene::surface::Class;

/// Three people on a small loop under a uniform sky.
fn some() -> (Builder, Vec<Moving>) {
    let mut b = Builder::new(3);
    let wardrobe = Wardrobe::new(&mut b);
    for speed in [0.8, 1.2, 1.5] {
        let stroll = Stroll {
            points: vec![[0.0, 0.0], [6.0, 0.0], [6.0, 5.0], [0.0, 5.0]],
            start: 0.2,
            speed,
        };
        add(&mut b, &wardrobe, &stroll);
    }
    let light = Light {
        sun: None,
        sky: 1.0,
        lamps: Vec::new(),
        tint: [1.0; 3],
        flicker: None,
    };
    let moving = std::mem::take(&mut b.parts)
        .into_iter()
        .map(|part| part.lit(&light))
        .collect();
    (b, moving)
}

fn lowest(body: &Moving, time_s: f64) -> f64 {
    let (position, rotation) = body.pose(time_s);
    let corners = body
        .body
        .triangles
        .iter()
        .flat_map(|t: &Triangle| &t.corners);
    corners
        .map(|c| (rotation * c.position + position).z)
        .fold(f64::MAX, f64::min)
}

#[test]
fn people_are_upright_and_on_the_ground() {
    let (_, moving) = some();
    for person in moving.chunks(Limb::ALL.len()) {
        for k in 0..200 {
            let time = 0.037 * f64::from(k);
            let foot = person
                .iter()
                .map(|limb| lowest(limb, time))
                .fold(f64::MAX, f64::min);
            assert!(foot.abs() < 0.02, "{time}: {foot}");
            for limb in &person[..2] {
                let up = limb.pose(time).1 * Vector3::z();
                assert!(up.z > 0.98, "{:?} at {time}: {up}", limb.limb);
            }
            let head = person[1].pose(time).0.z;
            assert!((1.2..1.7).contains(&head), "{time}: {head}");
        }
    }
}

/// Poses are continuous, also across laps, and limbs remain at their joints.
#[test]
fn poses_are_continuous_and_limbs_are_joined() {
    let (_, moving) = some();
    let step = 0.002;
    for body in &moving {
        let mut last = body.pose(0.0);
        for k in 1..20_000 {
            let time = step * f64::from(k);
            let (position, rotation) = body.pose(time);
            let speed = (position - last.0).norm() / step;
            let rate = rotation.angle_to(&last.1) / step;
            assert!(
                speed < 6.0 && rate < 12.0,
                "{:?} at {time}: {speed} {rate}",
                body.limb
            );
            last = (position, rotation);
        }
    }
    let [_, _, thigh, _, shin, ..] = &moving[..] else {
        panic!("twelve limbs each");
    };
    let (hip, turn) = thigh.pose(1.0);
    let below = turn.inverse() * (shin.pose(1.0).0 - hip);
    assert!(
        below.xy().norm() < 1e-12 && (-0.5..-0.35).contains(&below.z),
        "{below}"
    );
}

/// Legs reach the feet, and heel or ball of a standing foot is fixed.
#[test]
fn standing_foot_does_not_slide() {
    let (_, moving) = some();
    for person in moving.chunks(Limb::ALL.len()) {
        let walk = &person[0].walk;
        let (gait, scale) = (walk.gait, walk.gait.scale);
        for (side, shin, foot) in [
            (Side::Left, &person[4], &person[6]),
            (Side::Right, &person[5], &person[7]),
        ] {
            assert_eq!((shin.limb, foot.limb), (Limb::Shin(side), Limb::Foot(side)));
            let points = |time: f64| {
                let (position, rotation) = foot.pose(time);
                [HEEL, BALL].map(|x| position + rotation * Vector3::new(x, 0.0, -SOLE) * scale)
            };
            let mut standing = 0;
            for k in 0..2000 {
                let time = 0.005 * f64::from(k);
                let (knee, turn) = shin.pose(time);
                let ankle = knee - turn * Vector3::z() * (SHIN * scale);
                let apart = (ankle - foot.pose(time).0).norm();
                assert!(apart < 0.01, "{side:?} at {time}: {apart}");
                let walked_m = |t: f64| walk.start_m + walk.speed * t;
                let (now, next) = (walked_m(time), walked_m(time + 0.005));
                if !gait.stands(side, now) || !gait.stands(side, next) {
                    continue;
                }
                standing += 1;
                let (from, to) = (points(time), points(time + 0.005));
                let slid = [0, 1].map(|i| (to[i] - from[i]).norm());
                assert!(slid[0].min(slid[1]) < 1e-4, "{side:?} at {time}: {slid:?}");
                let lowest = to[0].z.min(to[1].z);
                assert!(lowest.abs() < 1e-6, "{side:?} at {time}: {lowest}");
            }
            assert!((1100..1300).contains(&standing), "{standing}");
        }
    }
}

#[test]
fn each_person_is_one_instance() {
    let (b, moving) = some();
    let mut instances = Vec::new();
    for body in &moving {
        assert_eq!(body.body.chunks.len(), 1, "{:?}", body.limb);
        for surface in &body.body.surfaces {
            let material = &b.materials[surface.material as usize];
            assert_eq!(material.class, Class::Person);
            assert!(!material.walkable && surface.instance > 0);
            instances.push(surface.instance);
        }
    }
    instances.dedup();
    assert_eq!(instances.len(), 3, "{instances:?}");
}
