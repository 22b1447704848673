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
use ::feet::events::{Contact, Event, FootStances, RigHeights, contacts};
use ::feet::observation::{
    FootCandidates, TagPose, causal_observations, foot_candidates, foot_observations,
};
use ::feet::shoe::Side;
use ::feet::stance::{FootObservation, Stance, stances};
use ::feet::swing_habit::SwingHabit;
use ::feet::tag_placement::{
    Estimate, PlacementError, Quantity, Slip, are_exchanged, placement_error, slip,
};
use ::feet::track::{self, FootContacts, foot_poses};
use ::feet::{FootConfig, GaitConfig, PlacementConfig};
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

use self::contact_views::{ContactViewConfig, Keyframes, contact_views};
use self::ground_below::{GroundBelow, GroundBelowConfig, corrected, places};
use super::depth_frames::{DepthFrame, instants};
use super::pose_interpolation::pose_at;
use super::soles::{edges, outline, shoe};
use crate::input::Input;
use crate::pipeline::{Findings, Stage, StageError, Work};

mod contact_views;
mod ground_below;

/// See the module.
pub(super) struct FeetStage;

impl Stage<Input> for FeetStage {
    fn name(&self) -> &'static str {
        "feet"
    }

    fn version(&self) -> u32 {
        3
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
            "placement": PlacementConfig::default(),
            "ground_below": GroundBelowConfig::default(),
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
        let views = views(work, &rig, &trajectory, &rows)?;
        outputs::contacts::write(work.draft(CONTACTS), &rows, &views)?;
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
    let mut gait = Gait::new(&rig, trajectory, detections);
    if correct_placement(work, &mut rig, ground, &gait.contacts) {
        gait = Gait::new(&rig, trajectory, detections);
    }
    let Gait { observed, contacts } = gait;
    let times: Vec<i64> = trajectory.poses().iter().map(|pose| pose.time_ns).collect();
    let mut poses = Vec::with_capacity(2 * times.len());
    let mut causal = Vec::with_capacity(2 * times.len());
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
            let of_rig = |(rig, own): (&Pose, track::FootPose)| foot_pose(foot, rig, &own);
            poses.extend(rigs.clone().zip(found).map(of_rig));
            let until_then = candidates(foot, &rig, trajectory, detections);
            let until_then = causal_observations(until_then, &FootConfig::default());
            let found = causal_poses(&until_then, &times, &config);
            causal.extend(rigs.zip(found).map(of_rig));
        }
        report(work, &contacts, &poses);
        for (foot, known) in Foot::ALL.into_iter().zip(&known) {
            report_restless(work, foot, known);
        }
    } else {
        work.note("no tag on a shoe was seen: there are no contacts and no poses of feet");
    }
    Feet {
        contacts,
        poses,
        causal,
    }
}

/// What the tags show of both feet.
struct Gait {
    observed: [Vec<FootObservation>; 2],
    contacts: [Vec<Contact>; 2],
}

impl Gait {
    fn new(rig: &RigModel, trajectory: &Trajectory, detections: &[TagDetection]) -> Self {
        let config = GaitConfig::default();
        let observed = Foot::ALL.map(|foot| {
            let candidates = candidates(foot, rig, trajectory, detections);
            foot_observations(candidates, &FootConfig::default())
        });
        let at_rest: [Vec<Stance>; 2] = observed.each_ref().map(|own| stances(own, &config.stance));
        let seen = [0, 1].map(|k: usize| FootStances {
            observations: &observed[k],
            stances: &at_rest[k],
            sole: edges(rig, Foot::ALL[k]),
        });
        let known = trajectory
            .poses()
            .iter()
            .filter(|pose| pose.status != Status::Lost);
        let height = |pose: &Pose| {
            [
                1e-9 * pose.time_ns as f64,
                pose.world_from_rig.translation_m()[2],
            ]
        };
        let heights = RigHeights::new(known.map(height).collect());
        let contacts = contacts(seen, &heights, &config.events);
        Self { observed, contacts }
    }
}

/// Corrects the placement of the tags by the ground below the feet at rest; whether it did.
/// Reports tags that slipped, that are exchanged, and those that the ground contradicts.
fn correct_placement(
    work: &Findings,
    rig: &mut RigModel,
    ground: &TerrainMesh,
    contacts: &[Vec<Contact>; 2],
) -> bool {
    let config = PlacementConfig::default();
    let [left, right] = contacts.each_ref().map(|own| places(own));
    if are_exchanged([&left, &right], &config) {
        work.record_loss(
            "the tags of the left and the right shoe are exchanged: their feet step to the wrong \
             sides; exchange `foot` of [[shoe_tag]] in the rig file",
        );
    }
    let ground = GroundBelow::new(ground);
    let mut is_corrected = false;
    for (foot, contacts) in Foot::ALL.into_iter().zip(contacts) {
        let samples = ground.samples(contacts);
        if let Some(slip) = slip(&samples, &config) {
            work.record_loss(slip_message(foot, &slip));
            // Before and after it the placement differs.
            continue;
        }
        let error = placement_error(&samples, &config);
        let shoes = rig.shoes.iter_mut().filter(|shoe| shoe.foot == foot);
        for tag in shoes.flat_map(|shoe| &mut shoe.tags) {
            let (place, contradicts) = corrected(tag, &error, &config);
            if contradicts {
                work.record_loss(placement_message(foot, &error));
            }
            is_corrected |= place != tag.foot_from_tag;
            tag.foot_from_tag = place;
        }
        if let Some(height) = error.height_m {
            let tilt = error
                .tilt_rad
                .map(|own| own.map_or(0.0, |own| own.value.to_degrees()));
            work.note(format!(
                "{}: by the ground below its contacts the sole was {:.1} ± {:.1} mm too high and \
                 tilted by {:.1} and {:.1} degrees; its tag's placement is corrected by that as far \
                 as its tolerance allows",
                foot.as_str(),
                1e3 * height.value,
                1e3 * height.sigma,
                tilt[0],
                tilt[1]
            ));
        }
    }
    is_corrected
}

fn slip_message(foot: Foot, slip: &Slip) -> String {
    let Estimate { value, sigma } = slip.change;
    let change = match slip.quantity {
        Quantity::Height => format!("rises by {:.1} ± {:.1} mm", 1e3 * value, 1e3 * sigma),
        quantity => {
            let axis = match quantity {
                Quantity::Roll => "about its length",
                Quantity::Pitch => "about its width",
                _ => "about the vertical",
            };
            let [value, sigma] = [value, sigma].map(f64::to_degrees);
            format!("rotates by {value:.1} ± {sigma:.1} degrees {axis}")
        }
    };
    format!(
        "{}: at {:.3} s of the clock the sole {change}: its tag has slipped, or the ground is of \
         another kind from there on",
        foot.as_str(),
        slip.time_s
    )
}

fn placement_message(foot: Foot, error: &PlacementError) -> String {
    let height = error.height_m.map_or(0.0, |own| 1e3 * own.value);
    let tilt = error
        .tilt_rad
        .map(|own| own.map_or(0.0, |own| own.value.to_degrees()));
    format!(
        "{}: by the ground below its contacts the sole is {height:.1} mm too high and tilted by \
         {:.1} and {:.1} degrees, which is more than the tolerance of its tag: check size_m, \
         translation_m and rotation_wxyz of [[shoe_tag]] in the rig file; not corrected",
        foot.as_str(),
        tilt[0],
        tilt[1]
    )
}

fn report(work: &Findings, contacts: &[Vec<Contact>; 2], poses: &[FootPose]) {
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

/// Share of the frames of a foot in which it is at rest, below which contacts are missing: on the
/// walks of `bench feet` it is flat in 0.50 (a jog) to 0.78 of those that show its tag.
const MIN_REST_SHARE: f64 = 0.25;
/// Number of frames of a foot that says something about that.
const MIN_REST_FRAMES: usize = 60;

/// Reports a foot that frames show well, and hardly ever at rest: poses of the rig that drift, or a
/// calibration or a size of tags with which feet seem to move.
fn report_restless(work: &Findings, foot: Foot, known: &FootContacts<'_>) {
    let all = known.observations.len();
    let at_rest = known
        .contacts
        .iter()
        .map(|own| own.stance.observations.len());
    let share = at_rest.sum::<usize>() as f64 / all.max(1) as f64;
    if all >= MIN_REST_FRAMES && share < MIN_REST_SHARE {
        work.record_loss(format!(
            "{}: it is at rest in {:.0} % of {all} frames only, so contacts are missing: check the \
             poses of the rig, the calibration of the camera and size_m of [[shoe_tag]]",
            foot.as_str(),
            100.0 * share
        ));
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

/// Poses of a foot in the world by its tags, where the pose of the rig is known.
/// Poses of a foot in all frames that show a tag of it.
fn candidates(
    foot: Foot,
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &[TagDetection],
) -> Vec<FootCandidates> {
    let own = detections.iter().filter(|detection| detection.foot == foot);
    let config = FootConfig::default();
    own.filter_map(|detection| {
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
    })
    .collect()
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
