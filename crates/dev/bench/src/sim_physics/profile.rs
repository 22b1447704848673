//! The collision surface along a course against the true ground, by what is highest there.

use nalgebra::Vector3;
use scene_bundle::outputs::collision::Collision;
use serde_json::{Map, Value, json};

use super::course::Course;
use super::probe::{KINDS, Probe};
use crate::terrain::scores::Quantiles;
use crate::terrain::truth::Truth;

/// Spacing of the places along a course, and of its parallels, m.
const ALONG_M: f64 = 0.01;
const ASIDE_M: f64 = 0.05;
/// Parallels on either side: the feet of the robot are 15 cm from its middle, which starts up to
/// 5 cm aside.
const PARALLELS: i32 = 4;
/// Within this distance of a step any height between both sides of it is right, m.
const STEP_REACH_M: f64 = 0.03;
/// Height difference of a step, m.
const STEP_M: f64 = 0.03;
/// Surfaces higher above the true ground are of another level, m.
const ABOVE_M: f64 = 0.4;
/// A foot that meets ground higher or lower by more than it expects stumbles, m.
const STUMBLE_M: f64 = 0.015;
/// Errors of the surface at places farther than 3 cm from steps.
pub(super) fn of_course(collision: &Collision, truth: &Truth<'_>, course: &Course) -> Value {
    let probe = Probe::new(collision);
    let (mut errors, mut near_steps, mut holes) = (Vec::new(), 0_usize, 0_usize);
    for place in course.places(truth, ALONG_M, ASIDE_M, PARALLELS) {
        let Some(ground) = open_ground(truth, place) else {
            near_steps += 1;
            continue;
        };
        match probe.highest(place.xy(), ground, ABOVE_M) {
            Some((height, kind)) => errors.push((height - ground, kind)),
            None => holes += 1,
        }
    }
    let count = errors.len().max(1) as f64;
    let of_kinds = |is: &dyn Fn(f64) -> bool| {
        let share = |kind: &str| {
            let own = errors
                .iter()
                .filter(|(error, own)| is(*error) && KINDS[*own] == kind);
            own.count() as f64 / count
        };
        let shares = KINDS.map(|kind| (kind.to_owned(), share(kind).into()));
        Map::from_iter(shares)
    };
    let share = |is: &dyn Fn(f64) -> bool| {
        let own = errors.iter().filter(|(error, _)| is(*error));
        own.count() as f64 / count
    };
    let (is_high, is_low) = (
        |error: f64| error >= STUMBLE_M,
        |error: f64| error <= -STUMBLE_M,
    );
    json!({
        "places": errors.len(),
        "near_steps": near_steps,
        "holes": holes,
        "height": Quantiles::of(errors.iter().map(|(error, _)| *error)),
        "share_high": share(&is_high),
        "share_low": share(&is_low),
        "high_by_kind": of_kinds(&is_high),
        "highest_by_kind": of_kinds(&|_| true),
    })
}

/// True height at a place that is farther than 3 cm from steps.
fn open_ground(truth: &Truth<'_>, place: Vector3<f64>) -> Option<f64> {
    let ground = |away: [f64; 2]| {
        let at = [place.x + away[0], place.y + away[1], place.z];
        truth.ground(at, ABOVE_M)
    };
    let own = ground([0.0; 2])?;
    let diagonal = STEP_REACH_M * std::f64::consts::FRAC_1_SQRT_2;
    let around = [
        [STEP_REACH_M, 0.0],
        [-STEP_REACH_M, 0.0],
        [0.0, STEP_REACH_M],
        [0.0, -STEP_REACH_M],
        [diagonal, diagonal],
        [diagonal, -diagonal],
        [-diagonal, diagonal],
        [-diagonal, -diagonal],
    ];
    let is_level = |away| ground(away).is_some_and(|height| (height - own).abs() < STEP_M);
    around.into_iter().all(is_level).then_some(own)
}
