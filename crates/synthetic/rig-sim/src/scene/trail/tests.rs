use std::sync::Arc;

use crate::scene::{Kind, Lighting, Scene, by_day};
use crate::walker::path::Path;
use crate::walker::{Side, Walker};

fn scene() -> Arc<Scene> {
    by_day(Kind::Trail, 1)
}

#[test]
fn route_has_ground_and_no_obstacles() {
    let scene = scene();
    let path = Path::closed(&scene.route.points);
    let (mut low, mut high) = (f64::MAX, f64::MIN);
    let mut last = scene.route.start_below;
    let mut things = Vec::new();
    for k in 0..(path.length_m() / 0.05) as u32 {
        let ([x, y], [dx, dy]) = path.at(0.05 * f64::from(k));
        for side in [-0.3, -0.1, 0.0, 0.1, 0.3] {
            let (x, y) = (x - dy * side, y + dx * side);
            let ground = scene.ground(x, y, last + 0.6).unwrap();
            assert!(ground.normal.z > 0.0, "{x} {y}");
            (low, high) = (low.min(ground.height), high.max(ground.height));
            // Free space from the knees to above the head.
            let knee = nalgebra::Vector3::new(x, y, ground.height + 0.4);
            let free = scene.first_hit(&knee, &nalgebra::Vector3::z());
            assert!(
                free.is_none_or(|hit| hit.distance > 1.6),
                "{x} {y}: {free:?}"
            );
            things.push(scene.fixed.surfaces[ground.triangle as usize].instance);
            if side == 0.0 {
                last = ground.height;
            }
        }
    }
    // Footholds have to be found between roots and stones.
    things.sort_unstable();
    things.dedup();
    assert!(things.len() > 50, "{}", things.len());
    assert!((1.5..8.0).contains(&(high - low)), "{low} {high}");
}

/// Roots and stones are stepped on or over; the sole neither floats nor penetrates them.
#[test]
fn soles_rest_on_rough_ground() {
    let scene = scene();
    let walker = Walker::new(&scene, 1, 70.0);
    for side in [Side::Left, Side::Right] {
        for fall in walker.contacts(side) {
            let mut gaps = Vec::new();
            for (x, y) in [
                (-0.13, 0.0),
                (0.0, -0.045),
                (0.0, 0.045),
                (0.0, 0.0),
                (0.07, 0.0),
                (0.15, 0.0),
            ] {
                let p = fall.position + fall.rotation * nalgebra::Vector3::new(x, y, 0.0);
                let ground = scene.ground(p.x, p.y, p.z + 0.3).unwrap();
                gaps.push(p.z - ground.height);
            }
            let (least, most) = gaps
                .iter()
                .fold((f64::MAX, f64::MIN), |(l, m), &g| (l.min(g), m.max(g)));
            assert!(least > -0.025 && least < 0.03, "{fall:?}: {gaps:?}");
            assert!(most < 0.09, "{fall:?}: {gaps:?}");
        }
    }
}

#[test]
fn same_seed_gives_the_same_trail() {
    let (a, b) = (scene(), Scene::new(Kind::Trail, Lighting::Day, 1));
    assert_eq!(a.fixed.triangles, b.fixed.triangles);
    assert_eq!(a.route, b.route);
    let other = by_day(Kind::Trail, 2);
    assert_ne!(a.route, other.route);
}
