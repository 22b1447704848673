//! What the tags show of both feet: poses, stances and contacts.

use ::feet::events::{Contact, FootStances, RigHeights, contacts};
use ::feet::observation::{FootCandidates, TagPose, foot_candidates, foot_observations};
use ::feet::stance::{FootObservation, Stance, stances};
use ::feet::{FootConfig, GaitConfig};
use cad_transforms::rig::Foot;
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::tag_detections::TagDetection;
use scene_bundle::{Pose, Status, Trajectory};

use super::super::pose_interpolation::pose_at;
use super::super::soles::{edges, shoe};

/// Where frames show both feet, and where these are at rest.
pub(super) struct FootTracks {
    pub(super) poses: [Vec<FootObservation>; 2],
    pub(super) stances: [Vec<Stance>; 2],
}

impl FootTracks {
    pub(super) fn new(
        rig: &RigModel,
        trajectory: &Trajectory,
        detections: &[TagDetection],
    ) -> Self {
        let config = GaitConfig::default().stance;
        let poses = Foot::ALL.map(|foot| {
            let candidates = candidates(foot, rig, trajectory, detections);
            foot_observations(candidates, &FootConfig::default())
        });
        let stances = poses.each_ref().map(|own| stances(own, &config));
        Self { poses, stances }
    }
}

/// What the tags show of both feet.
pub(super) struct Gait {
    pub(super) observed: [Vec<FootObservation>; 2],
    pub(super) contacts: [Vec<Contact>; 2],
}

impl Gait {
    pub(super) fn new(rig: &RigModel, trajectory: &Trajectory, observed: FootTracks) -> Self {
        let config = GaitConfig::default();
        let seen = [0, 1].map(|k: usize| FootStances {
            observations: &observed.poses[k],
            stances: &observed.stances[k],
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
        Self {
            observed: observed.poses,
            contacts,
        }
    }
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
