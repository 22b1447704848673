//! Strikes of feet that may have slid on the ground before they rest.
//!
//! Contract: a heel that is as high as where it then rests, but elsewhere, comes down flatly, or
//! has struck and slides. Frames do not tell which, so that the strike may have been at any time
//! since.

use nalgebra::Vector3;

use crate::config::EventConfig;
use crate::contact::{Event, FootStances, seconds};

/// Time of the first of the frames before a stance that show its heel on the ground elsewhere, s.
pub(super) fn slides_since_s(
    foot: &FootStances<'_>,
    index: usize,
    config: &EventConfig,
) -> Option<f64> {
    let stance = &foot.stances[index];
    let heel = [-foot.sole.heel_m, 0.0, 0.0];
    let at_rest = Vector3::from(stance.world_from_foot.apply(heel));
    let first_s = seconds(stance.times_ns[0]);
    let from = index
        .checked_sub(1)
        .map_or(0, |before| foot.stances[before].observations.end);
    let before = from.min(stance.observations.start)..stance.observations.start;
    let frames = foot.observations[before].iter().rev().map(|own| {
        let moved = Vector3::from(own.world_from_foot.apply(heel)) - at_rest;
        (seconds(own.time_ns), moved.xy().norm(), moved.z.abs())
    });
    let [least_m, largest_m] = config.slide_m;
    let on_ground = frames.take_while(|(time_s, shift_m, height_m)| {
        first_s - time_s < config.max_approach_s
            && *height_m < config.slide_height_m
            && *shift_m < largest_m
    });
    let elsewhere = on_ground.filter(|(_, shift_m, _)| *shift_m > least_m);
    elsewhere.last().map(|(time_s, ..)| time_s)
}

/// An event of a foot that may have slid since a time, s, as uncertain as that.
pub(super) fn with_slide(event: Event, since_s: Option<f64>) -> Event {
    let slide_s = since_s.map_or(0.0, |since_s| (event.time_s - since_s).max(0.0));
    Event {
        sigma_s: event.sigma_s.hypot(slide_s),
        ..event
    }
}

#[cfg(test)]
mod tests {
    use cad_transforms::{Covariance, RigidTransform};

    use super::*;
    use crate::contact::SoleEdges;
    use crate::stance::{FootObservation, Stance};

    /// Standard deviation of a strike at 0.28 s, 0.01 s without a slide, of a foot that is 0.02 m
    /// and 0.03 m from its place in two frames before, with its heel this high, m.
    fn sigma_s(height_m: f64) -> f64 {
        let covariance = Covariance::from_sigmas([2e-3; 3], [0.01; 3]).unwrap();
        let shifts_m = [0.5, 0.03, 0.02, 0.0, 0.0, 0.0];
        let frame = |(n, shift_m): (usize, f64)| {
            // Toe up until it rests.
            let pitch = if shift_m > 0.0 { -0.3 } else { 0.0 };
            let up = if shift_m > 0.0 { height_m } else { 0.0 };
            let turn = RigidTransform::from_rotation_vector([0.0, pitch, 0.0], [0.0; 3]).unwrap();
            let heel = turn.apply([-0.14, 0.0, 0.0]);
            let at = [-shift_m - 0.14 - heel[0], 0.0, up - heel[2]];
            FootObservation {
                time_ns: n as i64 * 66_666_667,
                world_from_foot: RigidTransform::from_rotation_vector([0.0, pitch, 0.0], at)
                    .unwrap(),
                covariance,
            }
        };
        let observations: Vec<FootObservation> =
            shifts_m.into_iter().enumerate().map(frame).collect();
        let stance = Stance {
            observations: 3..6,
            times_ns: [3, 5].map(|n| n * 66_666_667),
            world_from_foot: RigidTransform::identity(),
            covariance,
        };
        let foot = FootStances {
            observations: &observations,
            stances: &[stance],
            sole: SoleEdges {
                heel_m: 0.14,
                toe_m: 0.14,
            },
        };
        let strike = Event {
            time_s: 0.28,
            sigma_s: 0.01,
            is_seen: true,
        };
        with_slide(strike, slides_since_s(&foot, 0, &EventConfig::default())).sigma_s
    }

    #[test]
    fn a_low_heel_elsewhere_may_have_struck_then_and_one_that_comes_down_has_not() {
        // The frame of 0.03 m is the second one.
        let with_slide_s = 0.01_f64.hypot(0.28 - 1.0 / 15.0);
        assert!((sigma_s(0.002) - with_slide_s).abs() < 1e-6);
        assert!((sigma_s(0.02) - 0.01).abs() < 1e-12);
    }
}
