//! Which sector owns a place. Steps over edges are examined in `world/tests/crossing.rs`.

use super::*;
use crate::testing;

#[test]
fn agents_on_the_border_do_not_flicker() {
    let scene = testing::corridor().scene.clone();
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
    let scene = testing::corridor().scene.clone();
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
