//! Stage `feet`: poses of the wearer's feet, and their contacts with the ground, from the tags on
//! the shoes.
//!
//! Contract: a row per foot and pose of the trajectory, or none if no tag was seen; a foot that is
//! not known is lost, and so is one of a rig that is lost. Of the two poses of a tag that images
//! hardly distinguish, the one with the more level sole counts. A session in which no tag was seen
//! has no contacts, and a foot of which none was seen is lost throughout.

use std::collections::BTreeSet;

use ::feet::events::{Contact, Event, FootStances, contacts};
use ::feet::observation::{TagPose, foot_observation, surest};
use ::feet::stance::{FootObservation, Stance, stances};
use ::feet::track::{self, FootContacts, foot_poses};
use ::feet::{FootConfig, GaitConfig};
use cad_transforms::rig::Foot;
use scene_bundle::outputs::contacts::{ContactEvent, ContactView, FootContact};
use scene_bundle::outputs::feet::{FootPose, FootStatus};
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::tag_detections::TagDetection;
use scene_bundle::outputs::{
    self, CONTACTS, DEPTH, FEET, KEYFRAMES, RIG_REFINED, TAG_DETECTIONS, TRAJECTORY,
};
use scene_bundle::{Pose, Status, Trajectory};
use serde_json::{Value, json};

use self::contact_views::{ContactViewConfig, Keyframes, contact_views};
use super::depth_frames::{DepthFrame, instants};
use super::pose_interpolation::pose_at;
use super::soles::{edges, outline, shoe};
use crate::input::Input;
use crate::pipeline::{Stage, StageError, Work};

mod contact_views;

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
        &[RIG_REFINED, TRAJECTORY, TAG_DETECTIONS, KEYFRAMES, DEPTH]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[FEET, CONTACTS]
    }

    fn settings(&self) -> Value {
        json!({
            "foot": FootConfig::default(),
            "gait": GaitConfig::default(),
            "contact_views": ContactViewConfig::default(),
        })
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let rig = outputs::rig::read(&work.read(RIG_REFINED)?)?;
        let trajectory = outputs::trajectory::read(&work.read(TRAJECTORY)?)?;
        let detections = outputs::tag_detections::read(&work.read(TAG_DETECTIONS)?)?;
        let config = GaitConfig::default();
        let observed = Foot::ALL.map(|foot| observations(foot, &rig, &trajectory, &detections));
        let soles = Foot::ALL.map(|foot| edges(&rig, foot));
        let at_rest: [Vec<Stance>; 2] = observed.each_ref().map(|own| stances(own, &config.stance));
        let seen = [0, 1].map(|k: usize| FootStances {
            observations: &observed[k],
            stances: &at_rest[k],
            heel_m: soles[k].heel_m,
        });
        let contacts = contacts(seen, &config.events);
        let times: Vec<i64> = trajectory.poses().iter().map(|pose| pose.time_ns).collect();
        let mut poses = Vec::with_capacity(2 * times.len());
        if observed.iter().any(|own| !own.is_empty()) {
            for (k, foot) in Foot::ALL.into_iter().enumerate() {
                let known = FootContacts {
                    observations: &observed[k],
                    contacts: &contacts[k],
                    sole: soles[k],
                };
                let found = foot_poses(&known, &times, &config.swing);
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
        let views = views(work, &rig, &trajectory, &rows)?;
        outputs::contacts::write(work.draft(CONTACTS), &rows, &views)?;
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

/// Keyframes that show the places of contacts.
fn views(
    work: &Work<'_, Input>,
    rig: &RigModel,
    trajectory: &Trajectory,
    contacts: &[FootContact],
) -> Result<Vec<ContactView>, StageError> {
    if contacts.is_empty() {
        return Ok(Vec::new());
    }
    let depth = work.read(DEPTH)?;
    let index = outputs::depth::read_index(&depth)?;
    let instants = instants(rig, &index, &work.read(KEYFRAMES)?, trajectory)?;
    let frames: Vec<DepthFrame> = instants.into_iter().flatten().collect();
    let keyframes = Keyframes {
        rig,
        depth: &depth,
        index: &index,
        frames: &frames,
    };
    let views = contact_views(
        contacts,
        &Foot::ALL.map(|foot| outline(rig, foot)),
        &keyframes,
    )?;
    let places: BTreeSet<u64> = views.iter().map(|view| view.contact).collect();
    work.note(format!(
        "keyframes show the places of {} of {} contacts before or after",
        places.len(),
        contacts.len()
    ));
    Ok(views)
}

/// Poses of a foot in the world by its tags, where the pose of the rig is known.
fn observations(
    foot: Foot,
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &[TagDetection],
) -> Vec<FootObservation> {
    let own = detections.iter().filter(|detection| detection.foot == foot);
    surest(own.filter_map(|detection| {
        let mut tags = shoe(rig, foot)?.tags.iter();
        let tag = tags.find(|tag| u64::from(tag.id) == detection.tag)?;
        let world_from_rig = pose_at(trajectory, detection.time_ns)?;
        let seen = TagPose {
            rig_from_tag: detection.rig_from_tag,
            covariance: detection.covariance,
            second: (detection.second).map(|own| (own.rig_from_tag, f64::from(own.excess_cost))),
        };
        let (time_ns, place) = (detection.time_ns, &tag.foot_from_tag);
        let config = FootConfig::default();
        Some(foot_observation(
            time_ns,
            &world_from_rig,
            &seen,
            place,
            &config,
        ))
    }))
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
