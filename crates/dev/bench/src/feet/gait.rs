//! Contacts and swings of one walk against the truth: places, times, what is missed or invented.

use anyhow::Result;
use cad_transforms::{Covariance, RigidTransform};
use feet::events::{Contact, FootStances, contacts};
use feet::observation::{TagPose, foot_observation, surest};
use feet::stance::{FootObservation, Stance, stances};
use feet::swing::SoleEdges;
use feet::tag_tracker::Detection;
use feet::track::{FootContacts, FootStatus, foot_poses};
use feet::{FootConfig, GaitConfig};
use rig_sim::simulation::Simulation;
use rig_sim::walker::{Footfall, Phase, Side};
use serde::Serialize;

use super::tags::transform;

/// Edges of the sole of the simulated wearer.
const SOLE: SoleEdges = SoleEdges {
    heel_m: 0.13,
    toe_m: 0.15,
};
/// Time within which a contact is that of a footfall, s.
const MATCH_S: f64 = 0.25;

/// Errors of the contacts and swings of a walk.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Row {
    /// Footfalls between the first and the last second, those found, and contacts that are none.
    footfalls: usize,
    found: usize,
    invented: usize,
    /// Error of the middle of the sole at rest: RMS and 95th percentile, mm; mean squared error in
    /// sigmas, per dimension of the pose.
    contact_rms_mm: f64,
    contact_p95_mm: f64,
    contact_nees: f64,
    /// Errors of times, 95th percentile, ms, and mean squared error in sigmas.
    strike_p95_ms: f64,
    strike_nees: f64,
    toe_off_p95_ms: f64,
    toe_off_nees: f64,
    /// Poses out of sight between contacts: their number, RMS error of the middle of the sole, mm,
    /// and the share within the ellipsoid that contains 95 %.
    bridged: usize,
    bridged_rms_mm: f64,
    bridged_within: f64,
    /// Share of times at which a foot is lost.
    lost: f64,
}

/// The foot of a sighting in the world.
pub(super) fn observation(
    world_from_rig: &RigidTransform,
    seen: &Detection,
    foot_from_tag: &RigidTransform,
) -> Result<FootObservation> {
    // Rotation first in a fit.
    let place = |k: usize| (k + 3) % 6;
    let fit = &seen.fit;
    let rows =
        std::array::from_fn(|i| std::array::from_fn(|j| fit.covariance[(place(i), place(j))]));
    let tag = TagPose {
        rig_from_tag: fit.reference_from_tag,
        covariance: Covariance::from_rows(rows)?,
        second: fit
            .other
            .as_ref()
            .map(|own| (own.reference_from_tag, own.excess_cost)),
    };
    let config = FootConfig::default();
    Ok(foot_observation(
        seen.time_ns,
        world_from_rig,
        &tag,
        foot_from_tag,
        &config,
    ))
}

/// Errors of both feet.
pub(super) fn errors(simulation: &Simulation, observed: &[Vec<FootObservation>; 2]) -> Row {
    let config = GaitConfig::default();
    let observed = observed.each_ref().map(|own| surest(own.iter().copied()));
    let at_rest: [Vec<Stance>; 2] = observed.each_ref().map(|own| stances(own, &config.stance));
    let seen = [0, 1].map(|k: usize| FootStances {
        observations: &observed[k],
        stances: &at_rest[k],
        heel_m: SOLE.heel_m,
    });
    let contacts = contacts(seen, &config.events);
    let mut row = Row::default();
    let mut sums = Sums::default();
    let last_s = simulation.walker().seconds() - 1.0;
    for (k, side) in [Side::Left, Side::Right].into_iter().enumerate() {
        let falls = simulation.walker().contacts(side).iter();
        let falls: Vec<&Footfall> = falls
            .filter(|fall| fall.strike_s > 1.0 && fall.off_s < last_s)
            .collect();
        row.footfalls += falls.len();
        for contact in &contacts[k] {
            let near =
                |fall: &&&Footfall| (fall.strike_s - contact.heel_strike.time_s).abs() < MATCH_S;
            match falls.iter().find(near) {
                Some(fall) => {
                    row.found += 1;
                    sums.contact(contact, fall);
                }
                None if (1.0..last_s - 0.5).contains(&contact.heel_strike.time_s) => {
                    row.invented += 1;
                }
                None => {}
            }
        }
        let foot = FootContacts {
            observations: &observed[k],
            contacts: &contacts[k],
            sole: SOLE,
        };
        let times: Vec<i64> = (0..)
            .map(|n: i64| 1_000_000_000 + n * 10_000_000)
            .take_while(|ns| 1e-9 * (*ns as f64) < last_s)
            .collect();
        let poses = foot_poses(&foot, &times, &config.swing);
        let lost = poses
            .iter()
            .filter(|pose| pose.status == FootStatus::Lost)
            .count();
        row.lost += 0.5 * lost as f64 / times.len().max(1) as f64;
        for pose in poses
            .iter()
            .filter(|pose| pose.status == FootStatus::Bridged)
        {
            let state = simulation.walker().foot(side, 1e-9 * pose.time_ns as f64);
            let truth = transform(&state.position, &state.rotation);
            if let (Ok(truth), Phase::Swing | Phase::Toe | Phase::Heel) = (truth, state.phase) {
                sums.bridged(&truth, pose);
            }
        }
    }
    sums.into_row(row)
}

#[derive(Default)]
struct Sums {
    contacts_mm: Vec<f64>,
    contact_nees: f64,
    strikes_ms: Vec<f64>,
    strike_nees: f64,
    toe_offs_ms: Vec<f64>,
    toe_off_nees: f64,
    bridged_mm: Vec<f64>,
    bridged_within: usize,
}

impl Sums {
    fn contact(&mut self, contact: &Contact, fall: &Footfall) {
        let Ok(truth) = transform(&fall.position, &fall.rotation) else {
            return;
        };
        let stance = &contact.stance;
        let error = motion(&truth, &stance.world_from_foot);
        self.contacts_mm.push(1e3 * error.fixed_rows::<3>(0).norm());
        if let Some(inverse) = stance.covariance.matrix().try_inverse() {
            self.contact_nees += error.dot(&(inverse * error)) / 6.0;
        }
        let strike = contact.heel_strike.time_s - fall.strike_s;
        self.strikes_ms.push(1e3 * strike.abs());
        self.strike_nees += (strike / contact.heel_strike.sigma_s).powi(2);
        let toe_off = contact.toe_off.time_s - fall.off_s;
        self.toe_offs_ms.push(1e3 * toe_off.abs());
        self.toe_off_nees += (toe_off / contact.toe_off.sigma_s).powi(2);
    }

    fn bridged(&mut self, truth: &RigidTransform, pose: &feet::track::FootPose) {
        let error = motion(truth, &pose.world_from_foot)
            .fixed_rows::<3>(0)
            .into_owned();
        self.bridged_mm.push(1e3 * error.norm());
        let covariance = pose.covariance.as_ref().map(Covariance::matrix);
        let own = covariance.map(|all| all.fixed_view::<3, 3>(0, 0).into_owned());
        let square = own.and_then(|own| Some(error.dot(&(own.try_inverse()? * error))));
        // 95 % of a chi-squared distribution with three degrees of freedom.
        self.bridged_within += usize::from(square.is_some_and(|square| square < 7.81));
    }

    fn into_row(self, row: Row) -> Row {
        let count = self.contacts_mm.len().max(1) as f64;
        Row {
            contact_rms_mm: rms(&self.contacts_mm),
            contact_p95_mm: p95(self.contacts_mm),
            contact_nees: self.contact_nees / count,
            strike_p95_ms: p95(self.strikes_ms),
            strike_nees: self.strike_nees / count,
            toe_off_p95_ms: p95(self.toe_offs_ms),
            toe_off_nees: self.toe_off_nees / count,
            bridged: self.bridged_mm.len(),
            bridged_rms_mm: rms(&self.bridged_mm),
            bridged_within: self.bridged_within as f64 / self.bridged_mm.len().max(1) as f64,
            ..row
        }
    }
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

fn p95(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values
        .get(values.len() * 95 / 100)
        .copied()
        .unwrap_or(f64::NAN)
}

/// Motion from a pose to another in the axes of the first: translation, rotation.
fn motion(from: &RigidTransform, to: &RigidTransform) -> nalgebra::Vector6<f64> {
    let motion = from.inverse() * *to;
    let ([x, y, z], [a, b, c]) = (motion.translation_m(), motion.rotation_vector());
    nalgebra::Vector6::new(x, y, z, a, b, c)
}
