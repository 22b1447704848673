//! Stage `feet`: poses of the wearer's feet, and their contacts with the ground, from the tags on
//! the shoes.
//!
//! Contract: a row per foot and pose of the trajectory, or none if no tag was seen; a foot that is
//! not known is lost, and so is one of a rig that is lost. Of the two poses of a tag that images
//! hardly distinguish, the one counts that fits those of other frames and whose sole is more level.
//! A session in which no tag was seen has no contacts, and a foot of which none was seen is lost
//! throughout.

use std::collections::{BTreeMap, BTreeSet};

use ::feet::events::{Contact, Event};
use ::feet::{ClockConfig, FootConfig, GaitConfig, JumpConfig, PlacementConfig, SlideConfig};
use cad_transforms::rig::Foot;
use scene_bundle::Trajectory;
use scene_bundle::outputs::contacts::{ContactEvent, ContactView, FootContact};
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::terrain::MeshDetail;
use scene_bundle::outputs::{
    self, CONTACTS, DEPTH, FEET, KEYFRAMES, RIG_REFINED, TAG_DETECTIONS, TERRAIN, TRAJECTORY,
};
use serde_json::{Value, json};
use terrain::{PatchConfig, RampConfig};

use self::contact_views::{ContactViewConfig, Keyframes, contact_views};
pub use self::estimate::{Feet, feet};
use self::ground_below::GroundBelowConfig;
use self::patches::patches;
use self::reports::report_poses;
use super::depth_frames::{DepthFrame, instants};
use super::soles::outline;
use crate::input::Input;
use crate::pipeline::{Stage, StageError, Work};

mod contact_views;
mod continuous;
mod estimate;
mod gait;
mod ground_below;
mod inputs_check;
mod patches;
mod placement;
mod reports;

/// See the module.
pub(super) struct FeetStage;

impl Stage<Input> for FeetStage {
    fn name(&self) -> &'static str {
        "feet"
    }

    fn version(&self) -> u32 {
        8
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[
            RIG_REFINED,
            TRAJECTORY,
            TAG_DETECTIONS,
            TERRAIN,
            KEYFRAMES,
            DEPTH,
        ]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[FEET, CONTACTS]
    }

    fn settings(&self) -> Value {
        json!({
            "foot": FootConfig::default(),
            "gait": GaitConfig::default(),
            "clock": ClockConfig::default(),
            "jump": JumpConfig::default(),
            "slide": SlideConfig::default(),
            "placement": PlacementConfig::default(),
            "ground_below": GroundBelowConfig::default(),
            "patch": PatchConfig::default(),
            "ramps": RampConfig::default(),
            "contact_views": ContactViewConfig::default(),
        })
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let rig = outputs::rig::read(&work.read(RIG_REFINED)?)?;
        let trajectory = outputs::trajectory::read(&work.read(TRAJECTORY)?)?;
        let detections = outputs::tag_detections::read(&work.read(TAG_DETECTIONS)?)?;
        let reader = work.read(TERRAIN)?;
        let terrain = outputs::terrain::read(&reader)?;
        let ground = outputs::terrain::read_mesh(&reader, MeshDetail::Dense, &terrain)?;
        let feet = feet(&rig, &trajectory, &detections, &ground, work.findings());
        let mut rows: Vec<FootContact> = Vec::new();
        for (foot, contacts) in Foot::ALL.into_iter().zip(&feet.contacts()) {
            rows.extend(contacts.iter().map(|own| foot_contact(foot, own)));
        }
        rows.sort_by_key(|row| (row.events[0].time_ns, row.foot));
        let mut statuses = BTreeMap::new();
        let poses = feet
            .poses()
            .inspect(|pose| *statuses.entry(pose.status).or_default() += 1);
        outputs::feet::write(work.draft(FEET), poses, feet.causal())?;
        if feet.are_seen() {
            report_poses(work.findings(), &rows, &statuses);
        }
        drop(feet);
        let patches = patches(&rig, &rows, &terrain, ground);
        let views = views(work, &rig, &trajectory, &rows)?;
        outputs::contacts::write(work.draft(CONTACTS), &rows, &patches, &views)?;
        Ok(())
    }
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
