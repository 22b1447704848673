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
use ::feet::swing::SoleEdges;
use ::feet::swing_habit::SwingHabit;
use ::feet::tag_placement::{
    Estimate, PlacementError, Quantity, Slip, are_exchanged, gross_placement_error,
    placement_error, slip,
};
use ::feet::track::{self, FootContacts, foot_poses};
use ::feet::{ClockConfig, FootConfig, GaitConfig, JumpConfig, PlacementConfig};
use cad_transforms::Covariance;
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
use self::gait::{Gait, candidates, on_one_clock, report_drift, without_jumps};
use self::ground_below::{GroundBelow, GroundBelowConfig, corrected, places, remaining};
use super::depth_frames::{DepthFrame, instants};
use super::soles::{edges, outline, shoe};
use crate::input::Input;
use crate::pipeline::{Findings, Stage, StageError, Work};

mod contact_views;
mod continuous;
mod gait;
mod ground_below;

/// See the module.
pub(super) struct FeetStage;

impl Stage<Input> for FeetStage {
    fn name(&self) -> &'static str {
        "feet"
    }

    fn version(&self) -> u32 {
        4
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
    let detections = &on_one_clock(work, &rig, trajectory, detections)[..];
    let continuous = without_jumps(work, &rig, trajectory, detections);
    report_drift(work, &rig, &continuous.trajectory, detections);
    let of_rig = |rig: &RigModel| Gait::new(rig, &continuous.trajectory, detections);
    let mut gait = of_rig(&rig);
    let in_world = gait
        .contacts
        .each_ref()
        .map(|own| continuous.contacts_back(own));
    let (is_corrected, placements) = correct_placement(work, &mut rig, ground, &in_world);
    if is_corrected {
        gait = of_rig(&rig);
    }
    let Gait {
        observed,
        mut contacts,
    } = gait;
    for (contacts, placement) in contacts.iter_mut().zip(&placements) {
        for own in contacts {
            own.stance.covariance = own.stance.covariance.plus(placement);
        }
    }
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
            poses.extend(rigs.clone().zip(found).map(|(rig, mut own)| {
                own.world_from_foot = continuous.back(own.time_ns) * own.world_from_foot;
                foot_pose(foot, rig, &own)
            }));
            let until_then = candidates(foot, &rig, trajectory, detections);
            let until_then = causal_observations(until_then, &FootConfig::default());
            let found = causal_poses(&until_then, &times, &config);
            causal.extend(rigs.zip(found).map(of_rig));
        }
        report(work, &contacts, &poses);
        for (foot, known) in Foot::ALL.into_iter().zip(&known) {
            report_restless(work, foot, known);
        }
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

/// Corrects the placement of the tags by the ground below the feet at rest: whether it did, and
/// what is uncertain of the pose of each foot by what remains of their tolerance.
/// Reports tags that slipped, that are exchanged, and those that the ground contradicts.
fn correct_placement(
    work: &Findings,
    rig: &mut RigModel,
    ground: &TerrainMesh,
    contacts: &[Vec<Contact>; 2],
) -> (bool, [Covariance; 2]) {
    let config = PlacementConfig::default();
    let mut uncertain = [Covariance::zero(); 2];
    let [left, right] = contacts.each_ref().map(|own| places(own));
    if are_exchanged([&left, &right], &config) {
        work.record_loss(
            "the tags of the left and the right shoe are exchanged: their feet step to the wrong \
             sides; exchange `foot` of [[shoe_tag]] in the rig file",
        );
    }
    let ground = GroundBelow::new(ground);
    let mut is_corrected = false;
    for (k, foot) in Foot::ALL.into_iter().enumerate() {
        let samples = ground.samples(&contacts[k]);
        let none = PlacementError::default();
        if let Some(tag) = shoe(rig, foot).and_then(|shoe| shoe.tags.first()) {
            uncertain[k] = remaining(tag, &none, &config);
        }
        if let Some(slip) = slip(&samples, &config) {
            work.record_loss(slip_message(foot, &slip));
            // Before and after it the placement differs.
            continue;
        }
        let error = placement_error(&samples, &config);
        let gross = gross_placement_error(&samples, &config);
        let shoes = rig.shoes.iter_mut().filter(|shoe| shoe.foot == foot);
        for tag in shoes.flat_map(|shoe| &mut shoe.tags) {
            uncertain[k] = remaining(tag, &error, &config);
            let (place, contradicts) = corrected(tag, &error, &config);
            if contradicts || corrected(tag, &gross, &config).1 {
                work.record_loss(placement_message(foot, &gross));
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
    (is_corrected, uncertain)
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

/// Reports an outline that is none of a shoe: times of strikes and lifts depend on its ends.
fn report_sole(work: &Findings, foot: Foot, sole: &SoleEdges) {
    let [least, largest] = FootConfig::default().sole_length_m;
    let length = sole.heel_m + sole.toe_m;
    if !(least..=largest).contains(&length) {
        work.record_loss(format!(
            "{}: its sole is {length:.2} m long, and shoes of adults are {least} to {largest} m: \
             check outline_m of [[sole]] in the rig file; its events and swings depend on it",
            foot.as_str()
        ));
    }
}

/// Time without either foot in which a step is missing, s.
const MAX_UNSEEN_S: f64 = 0.8;

/// Reports times in which no frame shows a foot: no frames, or no poses of the rig for them.
fn report_unseen(work: &Findings, known: &[FootContacts<'_>; 2]) {
    let seen = known.iter().flat_map(|foot| foot.observations);
    let mut times_s: Vec<f64> = seen.map(|own| 1e-9 * own.time_ns as f64).collect();
    times_s.sort_by(f64::total_cmp);
    let pairs = times_s.windows(2).map(|pair| (pair[0], pair[1] - pair[0]));
    let gaps: Vec<(f64, f64)> = pairs.filter(|(_, s)| *s > MAX_UNSEEN_S).collect();
    if let Some((at_s, longest_s)) = gaps.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)) {
        work.record_loss(format!(
            "in {} times no frame shows a foot, or the pose of the rig is unknown, for {:.1} s in \
             total, the longest from {at_s:.3} s of the clock on for {longest_s:.1} s: contacts in \
             them are missing, and events beside them are uncertain",
            gaps.len(),
            gaps.iter().map(|own| own.1).sum::<f64>()
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
