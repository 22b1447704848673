use nalgebra::Vector3;

use crate::camera::placed;
use crate::scene::people::Limb;
use std::sync::Arc;

use crate::scene::{Kind, Lighting, Scene, by_day};
use crate::walker::Walker;
use crate::walker::path::Path;

fn scene() -> Arc<Scene> {
    by_day(Kind::Plaza, 1)
}

#[test]
fn route_has_ground_and_no_obstacles() {
    let scene = scene();
    let path = Path::closed(&scene.route.points);
    for k in 0..(path.length_m() / 0.05) as u32 {
        let ([x, y], [dx, dy]) = path.at(0.05 * f64::from(k));
        for side in [-0.3, 0.0, 0.3] {
            let (x, y) = (x - dy * side, y + dx * side);
            let ground = scene.ground(x, y, 1.0).unwrap();
            assert!(
                ground.height.abs() < 0.01 && ground.normal.z > 0.99,
                "{x} {y}"
            );
            let above = Vector3::new(x, y, ground.height + 0.01);
            let free = scene.first_hit(&above, &Vector3::z());
            assert!(
                free.is_none_or(|hit| hit.distance > 2.0),
                "{x} {y}: {free:?}"
            );
        }
    }
}

#[test]
fn people_pass_close_without_collisions() {
    let scene = scene();
    let walker = Walker::new(&scene, 1, 90.0);
    let torsos: Vec<_> = scene
        .moving
        .iter()
        .filter(|m| m.limb == Limb::Torso)
        .collect();
    assert!((8..=12).contains(&torsos.len()), "{}", torsos.len());
    let mut nearest = f64::MAX;
    for k in 0..450 {
        let time = 0.2 * f64::from(k);
        let at: Vec<Vector3<f64>> = torsos.iter().map(|m| m.pose(time).0).collect();
        let rig = walker.rig(time).position;
        for (i, a) in at.iter().enumerate() {
            let apart = (a - rig).xy().norm();
            nearest = nearest.min(apart);
            assert!(apart > 0.6, "{time}: person {i} and the walker at {rig}");
            for (j, b) in at[..i].iter().enumerate() {
                assert!((a - b).xy().norm() > 0.7, "{time}: {i} and {j} at {a}");
            }
            for angle in 0..16 {
                let (s, c) = (f64::from(angle) * 0.4).sin_cos();
                let hit = scene.first_hit(a, &Vector3::new(c, s, 0.0));
                assert!(hit.is_none_or(|h| h.distance > 0.4), "{time}: {i} at {a}");
            }
        }
    }
    assert!(nearest < 1.3, "{nearest}");
}

#[test]
fn all_bodies_are_drawn_with_consecutive_numbers() {
    let scene = scene();
    let placed = placed(&scene);
    assert_eq!(placed.len(), 1 + scene.moving.len());
    let mut next = 0;
    for body in &placed {
        assert_eq!(body.first, next);
        assert_eq!(body.next() - next, body.body.surfaces.len() as u32);
        next = body.next();
    }
}

#[test]
fn same_seed_gives_the_same_plaza() {
    let (a, b) = (scene(), Scene::new(Kind::Plaza, Lighting::Day, 1));
    assert_eq!(a.fixed.triangles, b.fixed.triangles);
    for (a, b) in a.moving.iter().zip(&b.moving) {
        assert_eq!(a.body.triangles, b.body.triangles);
        assert_eq!(a.pose(12.3), b.pose(12.3));
    }
    let other = by_day(Kind::Plaza, 2);
    assert_ne!(a.fixed.triangles, other.fixed.triangles);
}
