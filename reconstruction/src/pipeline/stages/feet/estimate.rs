//! What tags and trajectory tell of both feet.
//!
//! Contract: contacts are in memory, poses are computed as they are read, so that the memory of a
//! long walk is that of its inputs.

use std::borrow::Cow;
use std::ops::Range;

use ::feet::causal::causal_poses;
use ::feet::events::Contact;
use ::feet::observation::causal_observations;
use ::feet::shoe::Side;
use ::feet::stance::FootObservation;
use ::feet::swing::SoleEdges;
use ::feet::swing_habit::SwingHabit;
use ::feet::track::{self, FootContacts, GroundHeights, foot_poses};
use ::feet::{FootConfig, GaitConfig};
use cad_transforms::Covariance;
use cad_transforms::rig::Foot;
use scene_bundle::outputs::feet::{FootPose, FootStatus};
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::tag_detections::TagDetection;
use scene_bundle::outputs::terrain::TerrainMesh;
use scene_bundle::{Pose, Status, Trajectory};

use super::super::soles::edges;
use super::continuous::Continuous;
use super::gait::{FootTracks, Gait, candidates};
use super::inputs_check::{on_one_clock, report_drift, without_jumps};
use super::placement::correct_placement;
use super::reports::{report_restless, report_slides, report_sole, report_unseen};
use crate::pipeline::Findings;

/// Number of poses that are in memory at a time.
const CHUNK: usize = 4096;

/// See the module.
pub struct Feet<'a> {
    rig: RigModel,
    trajectory: &'a Trajectory,
    continuous: Continuous<'a>,
    detections: Cow<'a, [TagDetection]>,
    observed: [Vec<FootObservation>; 2],
    /// By the trajectory without jumps.
    contacts: [Vec<Contact>; 2],
    soles: [SoleEdges; 2],
    ground: GroundHeights,
    habit: SwingHabit,
    /// What is uncertain of each foot by the placement of its tag.
    uncertain: [Covariance; 2],
}

/// Contacts and poses of both feet. `ground` is the mesh of depth alone.
pub fn feet<'a>(
    rig: &RigModel,
    trajectory: &'a Trajectory,
    detections: &'a [TagDetection],
    ground: &TerrainMesh,
    work: &Findings,
) -> Feet<'a> {
    let mut rig = rig.clone();
    let config = GaitConfig::default();
    let soles = Foot::ALL.map(|foot| edges(&rig, foot));
    let (detections, observed) = on_one_clock(work, &rig, trajectory, detections);
    let continuous = without_jumps(work, trajectory, &observed);
    let of_rig = |rig: &RigModel| FootTracks::new(rig, &continuous.trajectory, &detections);
    let observed = match continuous.has_jumps() {
        true => of_rig(&rig),
        false => observed,
    };
    report_drift(work, &rig, &continuous.trajectory, &detections, &observed);
    let mut gait = Gait::new(&rig, &continuous.trajectory, observed);
    let in_world = gait
        .contacts
        .each_ref()
        .map(|own| continuous.contacts_back(own));
    let placements = correct_placement(work, &mut rig, ground, &in_world);
    if placements.is_corrected {
        gait = Gait::new(&rig, &continuous.trajectory, of_rig(&rig));
    }
    let Gait {
        observed,
        mut contacts,
    } = gait;
    for (contacts, placement) in contacts.iter_mut().zip(&placements.uncertain) {
        for own in contacts {
            own.stance.covariance = own.stance.covariance.plus(placement);
        }
    }
    // The mesh is that of the trajectory with its jumps.
    let ground = match continuous.has_jumps() {
        true => GroundHeights::default(),
        false => GroundHeights::new(ground.positions.iter().map(|own| own.map(f64::from))),
    };
    let mut feet = Feet {
        rig,
        trajectory,
        continuous,
        detections,
        observed,
        contacts,
        soles,
        ground,
        habit: SwingHabit::generic(&config.swing),
        uncertain: placements.uncertain,
    };
    if !feet.are_seen() {
        work.note("no tag on a shoe was seen: there are no contacts and no poses of feet");
        return feet;
    }
    let known = [0, 1].map(|k: usize| feet.known(k));
    // What a tag that slipped shows is not how feet swing.
    let sound = [0, 1].map(|k: usize| FootContacts {
        contacts: match placements.slipped[k] {
            true => &[],
            false => known[k].contacts,
        },
        ..known[k]
    });
    let habit = SwingHabit::learned(&sound, &config.swing);
    for (foot, known) in Foot::ALL.into_iter().zip(&known) {
        report_restless(work, foot, known);
    }
    report_slides(work, &known);
    report_unseen(work, &known);
    for (foot, sole) in Foot::ALL.into_iter().zip(&feet.soles) {
        report_sole(work, foot, sole);
    }
    feet.habit = habit;
    feet
}

impl Feet<'_> {
    /// Whether a tag was seen: otherwise there are neither contacts nor poses.
    pub(super) fn are_seen(&self) -> bool {
        self.observed.iter().any(|own| !own.is_empty())
    }

    /// Of the left and the right foot.
    pub fn contacts(&self) -> [Vec<Contact>; 2] {
        let own = self.contacts.each_ref();
        own.map(|own| self.continuous.contacts_back(own))
    }

    /// Poses of both at the times of the trajectory, by foot, from all frames.
    pub fn poses(&self) -> impl Iterator<Item = FootPose> {
        let config = GaitConfig::default().swing;
        self.seen_feet().flat_map(move |k| {
            self.chunks().flat_map(move |rigs| {
                let found = foot_poses(&self.known(k), &self.habit, &times(rigs), &config);
                let poses = rigs.iter().zip(found).map(|(rig, mut own)| {
                    own.world_from_foot = self.continuous.back(own.time_ns) * own.world_from_foot;
                    foot_pose(Foot::ALL[k], rig, &own)
                });
                poses.collect::<Vec<_>>()
            })
        })
    }

    /// The same, each from the frames until then.
    pub(super) fn causal(&self) -> impl Iterator<Item = FootPose> {
        let config = GaitConfig::default();
        self.seen_feet().flat_map(move |k| {
            let foot = Foot::ALL[k];
            let until_then = candidates(foot, &self.rig, self.trajectory, &self.detections);
            let until_then = causal_observations(until_then, &FootConfig::default());
            self.chunks().flat_map(move |rigs| {
                let found = causal_poses(&until_then, &times(rigs), &config);
                let poses = rigs.iter().zip(found).map(|(rig, mut own)| {
                    let by_frames = own.covariance;
                    own.covariance = by_frames.map(|by_frames| by_frames.plus(&self.uncertain[k]));
                    foot_pose(foot, rig, &own)
                });
                poses.collect::<Vec<_>>()
            })
        })
    }

    /// Both feet, or none if no tag was seen.
    fn seen_feet(&self) -> Range<usize> {
        if self.are_seen() { 0..2 } else { 0..0 }
    }

    /// Parts of the trajectory.
    fn chunks(&self) -> impl Iterator<Item = &[Pose]> {
        self.trajectory.poses().chunks(CHUNK)
    }

    fn known(&self, k: usize) -> FootContacts<'_> {
        FootContacts {
            side: match Foot::ALL[k] {
                Foot::Left => Side::Left,
                Foot::Right => Side::Right,
            },
            observations: &self.observed[k],
            contacts: &self.contacts[k],
            sole: self.soles[k],
            ground: &self.ground,
        }
    }
}

fn times(rigs: &[Pose]) -> Vec<i64> {
    rigs.iter().map(|pose| pose.time_ns).collect()
}

fn foot_pose(foot: Foot, rig: &Pose, pose: &track::FootPose) -> FootPose {
    FootPose {
        foot,
        time_ns: pose.time_ns,
        world_from_foot: pose.world_from_foot,
        rig_from_foot: rig.world_from_rig.inverse() * pose.world_from_foot,
        covariance: pose.covariance,
        status: match pose.status {
            // Relative to a rig that is not known.
            _ if rig.status == Status::Lost => FootStatus::Lost,
            track::FootStatus::Observed => FootStatus::Observed,
            track::FootStatus::Held => FootStatus::Held,
            track::FootStatus::Bridged => FootStatus::Bridged,
            track::FootStatus::Lost => FootStatus::Lost,
        },
    }
}
