//! Stage `feet`: poses of the wearer's feet, and their contacts with the ground, from the tags on
//! the shoes.
//!
//! Contract: a row per foot and pose of the trajectory; where a foot is not known, it says so. Of
//! the two poses of a tag that images hardly tell apart the one counts that fits those of other frames
//! and whose sole is more level. A
//! session in which no tag was seen has no contacts, and a foot of which none was seen is lost
//! throughout.

use ::feet::events::{Contact, Event, FootStances, contacts};
use ::feet::observation::{TagPose, foot_candidates, foot_observations};
use ::feet::shoe::Side;
use ::feet::stance::{FootObservation, Stance, stances};
use ::feet::swing::SoleEdges;
use ::feet::swing_habit::SwingHabit;
use ::feet::track::{self, FootContacts, foot_poses};
use ::feet::{FootConfig, GaitConfig};
use cad_transforms::rig::Foot;
use scene_bundle::outputs::contacts::{ContactEvent, FootContact};
use scene_bundle::outputs::feet::{FootPose, FootStatus};
use scene_bundle::outputs::rig::{RigModel, RigShoe};
use scene_bundle::outputs::tag_detections::TagDetection;
use scene_bundle::outputs::{self, CONTACTS, FEET, RIG_REFINED, TAG_DETECTIONS, TRAJECTORY};
use scene_bundle::{Pose, Trajectory};
use serde_json::{Value, json};

use super::pose_interpolation::pose_at;
use crate::input::Input;
use crate::pipeline::{Stage, StageError, Work};

/// See the module.
pub(super) struct FeetStage;

impl Stage<Input> for FeetStage {
    fn name(&self) -> &'static str {
        "feet"
    }

    fn version(&self) -> u32 {
        1
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[RIG_REFINED, TRAJECTORY, TAG_DETECTIONS]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[FEET, CONTACTS]
    }

    fn settings(&self) -> Value {
        json!({ "foot": FootConfig::default(), "gait": GaitConfig::default() })
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let rig = outputs::rig::read(&work.read(RIG_REFINED)?)?;
        let trajectory = outputs::trajectory::read(&work.read(TRAJECTORY)?)?;
        let detections = outputs::tag_detections::read(&work.read(TAG_DETECTIONS)?)?;
        let config = GaitConfig::default();
        let observed = Foot::ALL.map(|foot| observations(foot, &rig, &trajectory, &detections));
        let soles = Foot::ALL.map(|foot| edges(shoe(&rig, foot)));
        let at_rest: [Vec<Stance>; 2] = observed.each_ref().map(|own| stances(own, &config.stance));
        let seen = [0, 1].map(|k: usize| FootStances {
            observations: &observed[k],
            stances: &at_rest[k],
            sole: soles[k],
        });
        let contacts = contacts(seen, &config.events);
        let times: Vec<i64> = trajectory.poses().iter().map(|pose| pose.time_ns).collect();
        let mut poses = Vec::with_capacity(2 * times.len());
        if observed.iter().any(|own| !own.is_empty()) {
            let known = [0, 1].map(|k: usize| FootContacts {
                side: match Foot::ALL[k] {
                    Foot::Left => Side::Left,
                    Foot::Right => Side::Right,
                },
                observations: &observed[k],
                contacts: &contacts[k],
                sole: soles[k],
            });
            let habit = SwingHabit::learned(&known, &config.swing);
            for (foot, known) in Foot::ALL.into_iter().zip(&known) {
                let found = foot_poses(known, &habit, &times, &config.swing);
                let rigs = trajectory.poses().iter();
                poses.extend(rigs.zip(found).map(|(rig, own)| foot_pose(foot, rig, &own)));
            }
            report(work, &contacts, &poses);
        } else {
            work.note("no tag on a shoe was seen: there are no contacts and no poses of feet");
        }
        let mut rows: Vec<FootContact> = Vec::new();
        for (foot, contacts) in Foot::ALL.into_iter().zip(&contacts) {
            rows.extend(contacts.iter().map(|own| foot_contact(foot, own)));
        }
        rows.sort_by_key(|row| (row.events[0].time_ns, row.foot));
        outputs::feet::write(work.draft(FEET), &poses)?;
        outputs::contacts::write(work.draft(CONTACTS), &rows)?;
        Ok(())
    }
}

fn report(work: &Work<'_, Input>, contacts: &[Vec<Contact>; 2], poses: &[FootPose]) {
    let [left, right] = contacts.each_ref().map(Vec::len);
    let share = |statuses: &[FootStatus]| {
        let count = poses.iter().filter(|pose| statuses.contains(&pose.status));
        100.0 * count.count() as f64 / poses.len().max(1) as f64
    };
    work.note(format!(
        "{left} contacts of the left foot and {right} of the right one; poses: {:.0} % observed, \
         {:.0} % held or bridged, {:.0} % lost",
        share(&[FootStatus::Observed]),
        share(&[FootStatus::Held, FootStatus::Bridged]),
        share(&[FootStatus::Lost])
    ));
}

fn shoe(rig: &RigModel, foot: Foot) -> Option<&RigShoe> {
    rig.shoes.iter().find(|shoe| shoe.foot == foot)
}

/// Front and rear edge of a sole; of a usual one where its outline is unknown.
fn edges(shoe: Option<&RigShoe>) -> SoleEdges {
    let usual = FootConfig::default();
    let outline = shoe
        .map(|shoe| shoe.outline_m.as_slice())
        .unwrap_or_default();
    let x = outline.iter().map(|[x, _]| *x);
    match outline.is_empty() {
        true => SoleEdges {
            heel_m: usual.heel_m,
            toe_m: usual.toe_m,
        },
        false => SoleEdges {
            heel_m: -x.clone().fold(f64::INFINITY, f64::min),
            toe_m: x.fold(f64::NEG_INFINITY, f64::max),
        },
    }
}

/// Poses of a foot in the world by its tags, where the pose of the rig is known.
fn observations(
    foot: Foot,
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &[TagDetection],
) -> Vec<FootObservation> {
    let own = detections.iter().filter(|detection| detection.foot == foot);
    let config = FootConfig::default();
    let candidates = own.filter_map(|detection| {
        let mut tags = shoe(rig, foot)?.tags.iter();
        let tag = tags.find(|tag| u64::from(tag.id) == detection.tag)?;
        let world_from_rig = pose_at(trajectory, detection.time_ns)?;
        let seen = TagPose {
            rig_from_tag: detection.rig_from_tag,
            covariance: detection.covariance,
            visible_share: f64::from(detection.visible_share[0].max(detection.visible_share[1])),
            second: (detection.second).map(|own| (own.rig_from_tag, f64::from(own.excess_cost))),
        };
        let (time_ns, place) = (detection.time_ns, &tag.foot_from_tag);
        foot_candidates(time_ns, &world_from_rig, &seen, place, &config).ok()
    });
    foot_observations(candidates, &config)
}

fn foot_pose(foot: Foot, rig: &Pose, pose: &track::FootPose) -> FootPose {
    FootPose {
        foot,
        time_ns: pose.time_ns,
        world_from_foot: pose.world_from_foot,
        rig_from_foot: rig.world_from_rig.inverse() * pose.world_from_foot,
        covariance: pose.covariance,
        status: match pose.status {
            track::FootStatus::Observed => FootStatus::Observed,
            track::FootStatus::Held => FootStatus::Held,
            track::FootStatus::Bridged => FootStatus::Bridged,
            track::FootStatus::Lost => FootStatus::Lost,
        },
    }
}

fn foot_contact(foot: Foot, contact: &Contact) -> FootContact {
    let event = |event: &Event| ContactEvent {
        time_ns: (event.time_s * 1e9).round() as i64,
        sigma_s: event.sigma_s as f32,
        is_seen: event.is_seen,
    };
    FootContact {
        foot,
        events: [
            event(&contact.heel_strike),
            event(&contact.foot_flat),
            event(&contact.heel_off),
            event(&contact.toe_off),
        ],
        world_from_foot: contact.stance.world_from_foot,
        covariance: contact.stance.covariance,
    }
}
