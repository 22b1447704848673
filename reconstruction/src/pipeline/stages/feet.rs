//! Stage `feet`: poses of the wearer's feet, and their contacts with the ground, from the tags on
//! the shoes.
//!
//! Contract: a row per foot and pose of the trajectory, or none if no tag was seen; a foot that is
//! not known is lost, and so is one of a rig that is lost. Of the two poses of a tag that images
//! hardly distinguish, the one counts that fits those of other frames and whose sole is more level.
//! A session in which no tag was seen has no contacts, and a foot of which none was seen is lost
//! throughout.

use std::collections::BTreeSet;

use ::feet::causal::causal_poses;
use ::feet::events::{Contact, Event};
use ::feet::observation::causal_observations;
use ::feet::shoe::Side;
use ::feet::swing_habit::SwingHabit;
use ::feet::track::{self, FootContacts, GroundHeights, foot_poses};
use ::feet::{ClockConfig, FootConfig, GaitConfig, JumpConfig, PlacementConfig, SlideConfig};
use cad_transforms::rig::Foot;
use scene_bundle::outputs::contacts::{ContactEvent, ContactView, FootContact};
use scene_bundle::outputs::feet::{FootPose, FootStatus};
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::tag_detections::TagDetection;
use scene_bundle::outputs::terrain::{MeshDetail, TerrainMesh};
use scene_bundle::outputs::{
    self, CONTACTS, DEPTH, FEET, KEYFRAMES, RIG_REFINED, TAG_DETECTIONS, TERRAIN, TRAJECTORY,
};
use scene_bundle::{Pose, Status, Trajectory};
use serde_json::{Value, json};
use terrain::{PatchConfig, RampConfig};

use self::contact_views::{ContactViewConfig, Keyframes, contact_views};
use self::gait::{FootTracks, Gait, candidates};
use self::ground_below::GroundBelowConfig;
use self::inputs_check::{on_one_clock, report_drift, without_jumps};
use self::patches::patches;
use self::placement::correct_placement;
use self::reports::{report, report_restless, report_slides, report_sole, report_unseen};
use super::depth_frames::{DepthFrame, instants};
use super::soles::{edges, outline};
use crate::input::Input;
use crate::pipeline::{Findings, Stage, StageError, Work};

mod contact_views;
mod continuous;
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
        for (foot, contacts) in Foot::ALL.into_iter().zip(&feet.contacts) {
            rows.extend(contacts.iter().map(|own| foot_contact(foot, own)));
        }
        rows.sort_by_key(|row| (row.events[0].time_ns, row.foot));
        outputs::feet::write(work.draft(FEET), &feet.poses, &feet.causal)?;
        let patches = patches(&rig, &rows, &terrain, ground);
        let views = views(work, &rig, &trajectory, &rows)?;
        outputs::contacts::write(work.draft(CONTACTS), &rows, &patches, &views)?;
        Ok(())
    }
}

/// What is known of the feet.
#[derive(Clone, Debug, Default)]
pub struct Feet {
    /// Of the left and the right foot.
    pub contacts: [Vec<Contact>; 2],
    /// Of both at the times of the trajectory, by foot, from all frames.
    pub poses: Vec<FootPose>,
    /// The same, each from the frames until then.
    pub causal: Vec<FootPose>,
}

/// Contacts and poses of both feet. `ground` is the mesh of depth alone.
pub fn feet(
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &[TagDetection],
    ground: &TerrainMesh,
    work: &Findings,
) -> Feet {
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
    let times: Vec<i64> = trajectory.poses().iter().map(|pose| pose.time_ns).collect();
    let mut poses = Vec::with_capacity(2 * times.len());
    let mut causal = Vec::with_capacity(2 * times.len());
    if observed.iter().any(|own| !own.is_empty()) {
        // The mesh is that of the trajectory with its jumps.
        let heights = match continuous.has_jumps() {
            true => GroundHeights::default(),
            false => GroundHeights::new(ground.positions.iter().map(|own| own.map(f64::from))),
        };
        let known = [0, 1].map(|k: usize| FootContacts {
            side: match Foot::ALL[k] {
                Foot::Left => Side::Left,
                Foot::Right => Side::Right,
            },
            observations: &observed[k],
            contacts: &contacts[k],
            sole: soles[k],
            ground: &heights,
        });
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
            let found = foot_poses(known, &habit, &times, &config.swing);
            let rigs = trajectory.poses().iter();
            poses.extend(rigs.clone().zip(found).map(|(rig, mut own)| {
                own.world_from_foot = continuous.back(own.time_ns) * own.world_from_foot;
                foot_pose(foot, rig, &own)
            }));
            let until_then = candidates(foot, &rig, trajectory, &detections);
            let until_then = causal_observations(until_then, &FootConfig::default());
            let found = causal_poses(&until_then, &times, &config);
            let uncertain = &placements.uncertain[usize::from(foot == Foot::Right)];
            causal.extend(rigs.zip(found).map(|(rig, mut own)| {
                own.covariance = own.covariance.map(|by_frames| by_frames.plus(uncertain));
                foot_pose(foot, rig, &own)
            }));
        }
        report(work, &contacts, &poses);
        for (foot, known) in Foot::ALL.into_iter().zip(&known) {
            report_restless(work, foot, known);
        }
        report_slides(work, &known);
        report_unseen(work, &known);
        for (foot, sole) in Foot::ALL.into_iter().zip(&soles) {
            report_sole(work, foot, sole);
        }
    } else {
        work.note("no tag on a shoe was seen: there are no contacts and no poses of feet");
    }
    Feet {
        contacts: contacts.each_ref().map(|own| continuous.contacts_back(own)),
        poses,
        causal,
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
