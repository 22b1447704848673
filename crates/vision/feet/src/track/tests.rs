use super::*;
use crate::GaitConfig;
use crate::contact::SoleEdges;
use crate::events::{Event, FootStances, RigHeights, contacts};
use crate::ground::GroundHeights;
use crate::poses::motion;
use crate::shoe::Side;
use crate::stance::stances;
use crate::test_noise::Noise;

const SOLE: SoleEdges = SoleEdges {
    heel_m: 0.13,
    toe_m: 0.15,
};
const STRIDE_S: f64 = 1.1;

/// Another swing than the usual one: its progress is a cosine, its height half a sine, and its
/// pitch goes from -0.8 to 0.4.
fn truth(t: f64) -> RigidTransform {
    // No frame is at the begin of a stride.
    let t = t + 1e-4;
    let (stride, since) = ((t / STRIDE_S).floor(), t.rem_euclid(STRIDE_S));
    let share = ((since - 0.65) / (STRIDE_S - 0.65)).clamp(0.0, 1.0);
    let rise = |from: f64, to: f64| ((since - from) / (to - from)).clamp(0.0, 1.0);
    let along = 0.5 - 0.5 * libm::cos(std::f64::consts::PI * share);
    let pitch = match since {
        0.0..0.07 => 0.4 * (1.0 - since / 0.07),
        0.07..0.4 => 0.0,
        0.4..0.65 => -0.8 * rise(0.4, 0.65).powi(2),
        _ => -0.8 + 1.2 * share,
    };
    let edge = if since < 0.3 {
        -SOLE.heel_m
    } else {
        SOLE.toe_m
    };
    let toe_end = SOLE.toe_m - 0.28 * (1.0 - libm::cos(0.4)) - SOLE.toe_m;
    let height =
        0.06 * libm::sin(std::f64::consts::PI * share) + 0.28 * libm::sin(0.4) * share.powi(3);
    let x = 1.4 * stride + edge + (1.4 + toe_end) * along * f64::from(u8::from(since > 0.3));
    let turn = RigidTransform::from_rotation_vector([0.0, -pitch, 0.0], [0.0; 3]).unwrap();
    let middle = turn.apply([edge, 0.0, 0.0]);
    let z = if since > 0.65 { height } else { 0.0 };
    RigidTransform::from_rotation_vector([0.0, -pitch, 0.0], [x - middle[0], 0.1, z - middle[2]])
        .unwrap()
}

fn is_visible(t: f64) -> bool {
    !(0.43..0.95).contains(&t.rem_euclid(STRIDE_S))
}

fn seen(rate_hz: f64) -> Vec<FootObservation> {
    let covariance = Covariance::from_sigmas([0.004; 3], [0.015; 3]).unwrap();
    let mut noise = Noise::new(3);
    let frames = (0..(11.0 * rate_hz) as i64).map(|n| n as f64 / rate_hz);
    let frames = frames.filter(|t| is_visible(*t));
    frames
        .map(|t| {
            let [shift, turn] = [0.004, 0.015].map(|sigma| [0, 1, 2].map(|_| sigma * noise.next()));
            let error = RigidTransform::from_rotation_vector(turn, shift).unwrap();
            FootObservation {
                time_ns: (t * 1e9).round() as i64,
                world_from_foot: truth(t) * error,
                covariance,
            }
        })
        .collect()
}

#[test]
fn hidden_swings_are_bridged_with_honest_covariance() {
    let config = GaitConfig::default();
    let observations = seen(30.0);
    let stances = stances(&observations, &config.stance);
    assert_eq!(stances.len(), 10);
    let other = FootStances {
        observations: &[],
        stances: &[],
        sole: SOLE,
    };
    let own = FootStances {
        observations: &observations,
        stances: &stances,
        sole: SOLE,
    };
    let [contacts, _] = contacts([own, other], &RigHeights::default(), &config.events);
    let foot = FootContacts {
        side: Side::Left,
        observations: &observations,
        contacts: &contacts,
        sole: SOLE,
        ground: &GroundHeights::default(),
    };
    let none = FootContacts {
        side: Side::Right,
        observations: &[],
        contacts: &[],
        sole: SOLE,
        ground: &GroundHeights::default(),
    };
    let habit = SwingHabit::learned(&[foot, none], &config.swing);
    let times: Vec<i64> = (150..1000).map(|n| n * 10_000_000).collect();
    let poses = foot_poses(&foot, &habit, &times, &config.swing);
    assert_eq!(poses.len(), times.len());
    // A pose does not depend on the times of others: long walks are computed in parts.
    let in_parts = times.chunks(37);
    let in_parts = in_parts.flat_map(|part| foot_poses(&foot, &habit, part, &config.swing));
    assert!(in_parts.eq(poses.iter().copied()));
    let (mut squares, mut nees, mut count, mut within) = (0.0, 0.0, 0.0, 0.0);
    for pose in &poses {
        let t = 1e-9 * pose.time_ns as f64;
        let error = motion(&truth(t), &pose.world_from_foot);
        let covariance = pose
            .covariance
            .expect("between contacts")
            .matrix()
            .to_owned();
        match pose.status {
            FootStatus::Observed => {
                let size = error.fixed_rows::<3>(0).norm();
                assert!(size < 0.08, "{t}: {size}");
            }
            FootStatus::Held => {
                assert!(error.norm() < 0.3, "{t}: {error}");
            }
            FootStatus::Bridged => {
                let shift = error.fixed_rows::<3>(0);
                squares += shift.norm_squared();
                let own = covariance.fixed_view::<3, 3>(0, 0).into_owned();
                let square = shift.dot(&(own.try_inverse().unwrap() * shift));
                nees += square / 3.0;
                // 95 % of a chi-squared distribution with three degrees of freedom.
                within += f64::from(u8::from(square < 7.81));
                count += 1.0;
            }
            FootStatus::Lost => panic!("lost at {t}"),
        }
    }
    let rms: f64 = (squares / count).sqrt();
    assert!(count > 300.0, "{count}");
    assert!(rms < 0.12, "{rms}");
    // These swings are closer to the usual motion than those of people.
    assert!((0.03..2.0).contains(&(nees / count)), "{}", nees / count);
    assert!(within / count > 0.85, "{}", within / count);
}

#[test]
fn a_foot_without_a_next_contact_is_lost() {
    let event = |time_s: f64| Event {
        time_s,
        sigma_s: 0.01,
        is_seen: true,
    };
    let observations = seen(15.0);
    let stances = stances(&observations, &GaitConfig::default().stance);
    let contact = Contact {
        stance: stances[1].clone(),
        heel_strike: event(1.1),
        foot_flat: event(1.17),
        heel_off: event(1.5),
        toe_off: event(1.75),
    };
    let foot = FootContacts {
        side: Side::Left,
        observations: &observations,
        contacts: std::slice::from_ref(&contact),
        sole: SOLE,
        ground: &GroundHeights::default(),
    };
    let times = [500_000_000, 1_300_000_000, 2_000_000_000];
    let config = GaitConfig::default().swing;
    let found = foot_poses(&foot, &SwingHabit::generic(&config), &times, &config);
    let statuses: Vec<FootStatus> = found.iter().map(|pose| pose.status).collect();
    assert_eq!(
        statuses,
        [FootStatus::Lost, FootStatus::Observed, FootStatus::Lost]
    );
    assert!(found[0].covariance.is_none() && found[2].covariance.is_none());
}
