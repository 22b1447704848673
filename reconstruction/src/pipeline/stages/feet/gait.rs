//! What the tags show of both feet, and what that says of clocks and of the poses of the rig.
//!
//! Contract: time stamps of cameras that are late move all places along the path, and jumps of the
//! rig's poses break contacts in two. Both are found by feet at rest, reported as losses, and taken
//! out; poses are those in the world of the trajectory all the same.

use ::feet::checks::camera_clock::{RestFrame, clock_error, pose_drift};
use ::feet::checks::jump::jumps;
use ::feet::checks::trajectory_step::{RigPlace, steps};
use ::feet::events::{Contact, FootStances, RigHeights, contacts};
use ::feet::observation::{FootCandidates, TagPose, foot_candidates, foot_observations};
use ::feet::stance::{FootObservation, Stance, stances};
use ::feet::{ClockConfig, FootConfig, GaitConfig, JumpConfig};
use cad_transforms::rig::Foot;
use nalgebra::Vector3;
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::tag_detections::TagDetection;
use scene_bundle::{Pose, Status, Trajectory};

use super::super::pose_interpolation::pose_at;
use super::super::soles::{edges, shoe};
use super::super::tags::rig_state;
use super::continuous::Continuous;
use crate::pipeline::Findings;

/// Rounds in which clocks are estimated: a late clock hides feet at rest.
const ROUNDS: usize = 4;

/// What the tags show of both feet.
pub(super) struct Gait {
    pub(super) observed: [Vec<FootObservation>; 2],
    pub(super) contacts: [Vec<Contact>; 2],
}

impl Gait {
    pub(super) fn new(
        rig: &RigModel,
        trajectory: &Trajectory,
        detections: &[TagDetection],
    ) -> Self {
        let config = GaitConfig::default();
        let observed = observed(rig, trajectory, detections);
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

fn observed(
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &[TagDetection],
) -> [Vec<FootObservation>; 2] {
    Foot::ALL.map(|foot| {
        let candidates = candidates(foot, rig, trajectory, detections);
        foot_observations(candidates, &FootConfig::default())
    })
}

/// Poses of a foot in the world by its tags in all frames that show one, where the pose of the rig
/// is known.
pub(super) fn candidates(
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

/// The trajectory without jumps that feet at rest show, which are reported.
pub(super) fn without_jumps(
    work: &Findings,
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &[TagDetection],
) -> Continuous {
    let [left, right] = observed(rig, trajectory, detections);
    let stance = GaitConfig::default().stance;
    let jumps = jumps([&left, &right], &stance, &JumpConfig::default());
    for jump in &jumps {
        work.record_loss(format!(
            "at {:.3} s of the clock feet at rest are displaced by {:.0} mm between two frames: \
             the poses of the rig jump there, or the camera moved on the rig; contacts go on across \
             it",
            1e-9 * jump.times_ns[1] as f64,
            1e3 * Vector3::from(jump.shift_m).norm()
        ));
    }
    let places = trajectory.poses().iter().map(|pose| RigPlace {
        time_s: 1e-9 * pose.time_ns as f64,
        position: pose.world_from_rig.translation_m(),
    });
    let places: Vec<RigPlace> = places.collect();
    let config = JumpConfig::default();
    for [time_s, size_m] in steps(&places, &config) {
        let is_near = |ns: i64| (1e-9 * ns as f64 - time_s).abs() <= config.max_interval_s;
        if jumps
            .iter()
            .all(|jump| !jump.times_ns.into_iter().any(is_near))
        {
            work.record_loss(format!(
                "at {time_s:.3} s of the clock the poses of the rig jump by about {:.0} mm where \
                 no foot at rest shows it: contacts and poses of feet around it are uncertain",
                1e3 * size_m
            ));
        }
    }
    Continuous::new(trajectory, &jumps)
}

/// Reports poses of the rig that drift, by feet at rest that seem to move with the rig.
pub(super) fn report_drift(
    work: &Findings,
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &[TagDetection],
) {
    let config = ClockConfig::default();
    let cameras = (0..rig.cameras.len()).filter(|camera| shows_tags(detections, *camera));
    let frames =
        cameras.flat_map(|camera| rest_frames(rig, trajectory, detections, camera, is_level));
    let Some(drift) = pose_drift(&frames.collect::<Vec<_>>(), &config) else {
        return;
    };
    let percent = format!(
        "feet at rest move by {:.1} ± {:.1} % of what the rig does",
        1e2 * drift.value,
        1e2 * drift.sigma
    );
    match drift.value.abs() > (config.min_drift_sigmas * drift.sigma).max(config.min_drift) {
        true => work.record_loss(format!(
            "{percent}: its poses drift, or the calibration of the camera is wrong"
        )),
        false => work.note(percent),
    }
}

/// Detections at the times of the trajectory's clock: those of a camera whose time stamps are late
/// by what feet at rest show, which is reported, are moved.
pub(super) fn on_one_clock(
    work: &Findings,
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &[TagDetection],
) -> Vec<TagDetection> {
    let config = ClockConfig::default();
    let mut moved = detections.to_vec();
    for (camera, name) in rig.cameras.iter().map(|own| &own.name).enumerate() {
        if !shows_tags(detections, camera) {
            continue;
        }
        let mut late_s = first_guess(rig, trajectory, detections, camera);
        let mut known = None;
        move_times(&mut moved, detections, camera, late_s);
        for _ in 0..ROUNDS {
            let Some(error) =
                clock_error(&rest_frames(rig, trajectory, &moved, camera, any), &config)
            else {
                break;
            };
            late_s += error.value;
            known = Some(error.sigma);
            move_times(&mut moved, detections, camera, late_s);
            if error.value.abs() < error.sigma {
                break;
            }
        }
        let least_s = known.map_or(f64::INFINITY, |sigma| config.min_sigmas * sigma);
        if late_s.abs() < least_s.max(config.min_error_s) || late_s.abs() > config.max_error_s {
            move_times(&mut moved, detections, camera, 0.0);
            continue;
        }
        work.record_loss(format!(
            "feet at rest seem to move as if time stamps of the camera {name} were {:.1} ± {:.1} \
             ms late; its frames are used at earlier times by that, check its clock",
            1e3 * late_s,
            1e3 * known.unwrap_or(0.0)
        ));
    }
    moved
}

fn shows_tags(detections: &[TagDetection], camera: usize) -> bool {
    let mut cameras = detections.iter().map(|own| usize::from(own.camera));
    cameras.any(|own| own == camera)
}

/// The error of a clock with which a camera shows feet at rest most often, s; none if it does so
/// without one.
fn first_guess(
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &[TagDetection],
    camera: usize,
) -> f64 {
    let config = ClockConfig::default();
    let mut moved = detections.to_vec();
    let of_camera = |own: &&TagDetection| usize::from(own.camera) == camera;
    let count = detections.iter().filter(of_camera).count();
    let mut at_rest = |late_s: f64| {
        move_times(&mut moved, detections, camera, late_s);
        let frames = rest_frames(rig, trajectory, &moved, camera, any);
        frames.iter().map(Vec::len).sum::<usize>()
    };
    let without = at_rest(0.0);
    if without as f64 > config.usual_rest_share * count as f64 {
        return 0.0;
    }
    let guesses = config.guesses_s.map(|late_s| (at_rest(late_s), late_s));
    let most = guesses.into_iter().max_by_key(|(frames, _)| *frames);
    let is_better = |frames: usize| frames as f64 > config.better_rest_ratio * without as f64;
    most.filter(|(frames, _)| is_better(*frames))
        .map_or(0.0, |(_, late_s)| late_s)
}

fn move_times(moved: &mut [TagDetection], detections: &[TagDetection], camera: usize, late_s: f64) {
    let late_ns = (1e9 * late_s).round() as i64;
    for (own, stamped) in moved.iter_mut().zip(detections) {
        if usize::from(own.camera) == camera {
            own.time_ns = stamped.time_ns - late_ns;
        }
    }
}

/// Largest height from a stance to those of the same foot before and after it on level ground, m.
const LEVEL_M: f64 = 0.08;

/// Whether a stance, by its place among all of its foot, is on level ground: on stairs soles roll
/// more.
fn is_level(all: &[Stance], index: usize) -> bool {
    let height = |stance: &Stance| stance.world_from_foot.translation().z;
    let own = height(&all[index]);
    let beside = &all[index.saturating_sub(1)..(index + 2).min(all.len())];
    beside
        .iter()
        .all(|other| (height(other) - own).abs() < LEVEL_M)
}

fn any(_: &[Stance], _: usize) -> bool {
    true
}

/// Where a camera shows the tags of feet at rest, by stance and tag, in stances that count.
fn rest_frames(
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &[TagDetection],
    camera: usize,
    counts: fn(&[Stance], usize) -> bool,
) -> Vec<Vec<RestFrame>> {
    let config = GaitConfig::default();
    let mut found = Vec::new();
    for (foot, observed) in Foot::ALL
        .into_iter()
        .zip(observed(rig, trajectory, detections))
    {
        let stances = stances(&observed, &config.stance);
        for tag in shoe(rig, foot).map_or(&[][..], |shoe| &shoe.tags[..]) {
            // Those of one camera are in order of time, whatever its clock says.
            let own = detections
                .iter()
                .filter(|own| usize::from(own.camera) == camera && own.tag == u64::from(tag.id));
            let own: Vec<&TagDetection> = own.collect();
            let of_stance = |stance: &Stance| {
                let [from_ns, to_ns] = stance.times_ns;
                let first = own.partition_point(|own| own.time_ns < from_ns);
                let end = own.partition_point(|own| own.time_ns <= to_ns);
                let frames = own[first..end.max(first)].iter();
                frames
                    .filter_map(|own| rest_frame(trajectory, own))
                    .collect()
            };
            let that_count = (0..stances.len()).filter(|k| counts(&stances, *k));
            found.extend(that_count.map(|k| of_stance(&stances[k])));
        }
    }
    found
}

fn rest_frame(trajectory: &Trajectory, seen: &TagDetection) -> Option<RestFrame> {
    let rig = rig_state(trajectory, seen.time_ns)?;
    let place = rig.world_from_rig * seen.rig_from_tag;
    let away = place.translation() - rig.world_from_rig.translation();
    let [linear, angular] = [rig.motion.linear, rig.motion.angular].map(Vector3::from);
    let sigmas = seen.covariance.sigmas();
    Some(RestFrame {
        place: place.translation_m(),
        velocity: (linear + angular.cross(&away)).into(),
        rig: rig.world_from_rig.translation_m(),
        sigma_m: sigmas[..3].iter().fold(0.0, |a: f64, b| a.max(*b)),
    })
}
