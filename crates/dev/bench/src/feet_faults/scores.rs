//! Contacts and poses of a walk against the truth, in the frame of the rig.

use anyhow::Result;
use cad_transforms::RigidTransform;
use cad_transforms::rig::Foot;
use feet::events::Contact;
use rig_sim::simulation::{Simulation, seconds};
use rig_sim::walker::{Footfall, Side};
use scene_bundle::outputs::feet::{FootPose, FootStatus};
use scene_bundle::{Pose, Status, Trajectory};

use super::outcome::{FootScores, motion};
use super::stages::StageOutputs;
use super::walks::rig_pose;
use crate::terrain::walks::transform;

const SIDES: [Side; 2] = [Side::Left, Side::Right];
/// Time at the ends of the recording whose events do not count, s.
const END_S: f64 = 0.5;

/// The truth of a recording.
pub(super) struct Truth<'a> {
    pub(super) simulation: &'a Simulation,
    /// Begin and end of the recording, s.
    pub(super) span_s: [f64; 2],
}

impl Truth<'_> {
    /// Scores of both feet.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(super) fn scores(
        &self,
        found: &StageOutputs,
        trajectory: &Trajectory,
    ) -> Result<[FootScores; 2]> {
        let mut scores = [FootScores::default(), FootScores::default()];
        for (foot, scores) in scores.iter_mut().enumerate() {
            for pose in &found.poses {
                if pose.foot == Foot::ALL[foot] {
                    self.add_pose(foot, pose, scores)?;
                }
            }
            let falls = self.simulation.walker().contacts(SIDES[foot]);
            let mut taken = vec![false; falls.len()];
            for contact in &found.contacts[foot] {
                match overlapping(falls, contact) {
                    Some(at) => {
                        taken[at] = true;
                        self.add_contact((foot, at), contact, &falls[at], trajectory, scores)?;
                    }
                    None => scores.invented += 1,
                }
            }
            for (fall, taken) in falls.iter().zip(taken) {
                if self.counts(fall.strike_s) && self.counts(fall.off_s) {
                    scores.found += usize::from(taken);
                    scores.missed += usize::from(!taken);
                }
            }
        }
        Ok(scores)
    }

    fn counts(&self, time_s: f64) -> bool {
        let [from, to] = self.span_s;
        (from + END_S..to - END_S).contains(&time_s)
    }

    fn rig_from_foot(&self, foot: usize, time_ns: i64) -> Result<RigidTransform> {
        let state = self.simulation.walker().foot(SIDES[foot], seconds(time_ns));
        let world_from_foot = transform(&state.position, &state.rotation)?;
        Ok(rig_pose(self.simulation, time_ns)?.inverse() * world_from_foot)
    }

    fn add_pose(&self, foot: usize, pose: &FootPose, scores: &mut FootScores) -> Result<()> {
        let covariance = match pose.status {
            FootStatus::Lost => None,
            _ => pose.covariance,
        };
        let Some(covariance) = covariance else {
            scores.lost += 1;
            return Ok(());
        };
        let error = motion(
            &self.rig_from_foot(foot, pose.time_ns)?,
            &pose.rig_from_foot,
        );
        let sigmas = covariance.sigmas();
        let errors: Vec<(f64, f64)> = error.iter().copied().zip(sigmas).collect();
        scores.poses.add(
            (foot, pose.time_ns),
            &errors,
            error.fixed_rows::<3>(0).norm(),
        );
        Ok(())
    }

    /// A contact at the tracked pose of the rig next to the middle of its frames.
    fn add_contact(
        &self,
        (foot, number): (usize, usize),
        contact: &Contact,
        fall: &Footfall,
        trajectory: &Trajectory,
        scores: &mut FootScores,
    ) -> Result<()> {
        let stance = &contact.stance;
        let at = (foot, number as i64);
        let middle_ns = stance.times_ns[0].midpoint(stance.times_ns[1]);
        let tracked = trajectory.poses().iter();
        let tracked = tracked.filter(|pose| pose.status == Status::Tracked);
        let away = |pose: &&Pose| pose.time_ns.abs_diff(middle_ns);
        if let Some(rig) = tracked.min_by_key(away) {
            let rig_from_foot = rig.world_from_rig.inverse() * stance.world_from_foot;
            let error = motion(&self.rig_from_foot(foot, rig.time_ns)?, &rig_from_foot);
            let sigmas = stance.covariance.sigmas();
            let along = [0, 1].map(|k| (error[k], sigmas[k]));
            scores.places.add(at, &along, error[0].hypot(error[1]));
            scores
                .heights
                .add(at, &[(error[2], sigmas[2])], error[2].abs());
        }
        let (flat_s, heel_off_s) = fall.flat_phase();
        let events = [
            (&contact.heel_strike, fall.strike_s),
            (&contact.foot_flat, flat_s),
            (&contact.heel_off, heel_off_s),
            (&contact.toe_off, fall.off_s),
        ];
        for (kind, ((event, true_s), scores)) in
            (0..).zip(events.into_iter().zip(&mut scores.events))
        {
            if self.counts(true_s) {
                let error = event.time_s - true_s;
                let at = (foot, 4 * number as i64 + kind);
                scores.add(at, &[(error, event.sigma_s)], error.abs());
            }
        }
        Ok(())
    }
}

/// The footfall during which most of the frames of a contact are.
fn overlapping(falls: &[Footfall], contact: &Contact) -> Option<usize> {
    let [from, to] = contact.stance.times_ns.map(seconds);
    let overlap = |fall: &Footfall| to.min(fall.off_s) - from.max(fall.strike_s);
    let falls = falls.iter().enumerate();
    let largest = falls.max_by(|a, b| overlap(a.1).total_cmp(&overlap(b.1)));
    largest
        .filter(|(_, fall)| overlap(fall) > 0.0)
        .map(|(k, _)| k)
}
