//! Feet that slide on the ground before they rest.
//!
//! Contract: a foot strikes with its heel, toe up. One that is flat and as high as where it then
//! rests, but elsewhere, has struck before and slides.

use crate::config::SlideConfig;
use crate::contact::{Contact, FootContacts, seconds};
use crate::poses::motion;

/// Lengths of the slides that frames show, m.
pub fn slides(foot: &FootContacts<'_>, config: &SlideConfig) -> Vec<f64> {
    let of_contact = |contact: &Contact| {
        let stance = &contact.stance;
        let first_s = seconds(stance.times_ns[0]);
        let before = foot.observations[..stance.observations.start].iter().rev();
        let near = before.take_while(|own| first_s - seconds(own.time_ns) < config.max_time_s);
        let motions = near.map(|own| motion(&stance.world_from_foot, &own.world_from_foot));
        let [least, largest] = config.shift_m;
        let shifts = motions.map_while(|motion| {
            let is_flat = motion[3].hypot(motion[4]) < config.max_tilt_rad;
            let shift = motion[0].hypot(motion[1]);
            let is_low = motion[2].abs() < config.max_height_m;
            (is_flat && is_low && shift < largest).then_some(shift)
        });
        let longest = shifts.fold(0.0, f64::max);
        (longest > least).then_some(longest)
    };
    foot.contacts.iter().filter_map(of_contact).collect()
}

#[cfg(test)]
mod tests {
    use cad_transforms::{Covariance, RigidTransform};

    use super::*;
    use crate::contact::{Event, SoleEdges};
    use crate::ground::GroundHeights;
    use crate::shoe::Side;
    use crate::stance::{FootObservation, Stance};

    /// Frames of a foot that comes to the origin with a speed, m/s, and a pitch, rad, 15 Hz.
    fn found(speed: f64, pitch: f64) -> Vec<f64> {
        let covariance = Covariance::from_sigmas([2e-3; 3], [0.01; 3]).unwrap();
        let frame = |n: i64| {
            let left_s = ((6 - n).max(0)) as f64 / 15.0;
            let turn = if n < 6 { -pitch } else { 0.0 };
            let at = [-speed * left_s, 0.0, 0.0];
            FootObservation {
                time_ns: n * 66_666_667,
                world_from_foot: RigidTransform::from_rotation_vector([0.0, turn, 0.0], at)
                    .unwrap(),
                covariance,
            }
        };
        let observations: Vec<FootObservation> = (0..12).map(frame).collect();
        let event = Event {
            time_s: 0.4,
            sigma_s: 0.01,
            is_seen: true,
        };
        let contact = Contact {
            stance: Stance {
                observations: 6..12,
                times_ns: [6, 11].map(|n| n * 66_666_667),
                world_from_foot: RigidTransform::identity(),
                covariance,
            },
            heel_strike: event,
            foot_flat: event,
            heel_off: event,
            toe_off: event,
        };
        let foot = FootContacts {
            side: Side::Left,
            observations: &observations,
            contacts: &[contact],
            sole: SoleEdges {
                heel_m: 0.13,
                toe_m: 0.15,
            },
            ground: &GroundHeights::default(),
        };
        slides(&foot, &SlideConfig::default())
    }

    #[test]
    fn flat_feet_that_come_to_rest_slide_and_those_that_strike_do_not() {
        let slid = found(0.5, 0.0);
        assert_eq!(slid.len(), 1);
        assert!((slid[0] - 5.0 / 30.0).abs() < 1e-6, "{slid:?}");
        assert!(found(0.5, 0.3).is_empty(), "toe up");
        assert!(found(0.0, 0.0).is_empty(), "at rest");
    }
}
