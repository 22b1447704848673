//! What feet at rest say of clocks of cameras and of poses of the rig.
//!
//! Contract: time stamps of cameras that are late move all places along the path, and jumps of the
//! rig's poses break contacts in two. Both are found by feet at rest, reported as losses, and taken
//! out; poses are those in the world of the trajectory all the same.

use std::borrow::Cow;

use ::feet::checks::{RestFrame, RigPosition, clock_error, jumps, pose_drift, position_jumps};
use ::feet::stance::Stance;
use ::feet::tag_placement::Estimate;
use ::feet::{ClockConfig, GaitConfig, JumpConfig};
use cad_transforms::rig::Foot;
use nalgebra::Vector3;
use scene_bundle::Trajectory;
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::tag_detections::TagDetection;

use super::super::soles::shoe;
use super::super::tags::rig_state;
use super::continuous::Continuous;
use super::gait::FootTracks;
use crate::pipeline::Findings;

/// Rounds in which clocks are estimated: a late clock hides feet at rest.
const ROUNDS: usize = 4;

/// The trajectory without jumps that feet at rest show, which are reported.
pub(super) fn without_jumps<'a>(
    work: &Findings,
    trajectory: &'a Trajectory,
    observed: &FootTracks,
) -> Continuous<'a> {
    let [left, right] = &observed.poses;
    let stance = GaitConfig::default().stance;
    let jumps = jumps([left, right], &stance, &JumpConfig::default());
    for jump in &jumps {
        work.record_loss(format!(
            "at {:.3} s of the clock feet at rest are displaced by {:.0} mm between two frames: \
             the poses of the rig jump there, or the camera moved on the rig; contacts go on across \
             it",
            1e-9 * jump.times_ns[1] as f64,
            1e3 * Vector3::from(jump.shift_m).norm()
        ));
    }
    let positions = trajectory.poses().iter().map(|pose| RigPosition {
        time_s: 1e-9 * pose.time_ns as f64,
        position: pose.world_from_rig.translation_m(),
    });
    let positions: Vec<RigPosition> = positions.collect();
    let config = JumpConfig::default();
    for [time_s, size_m] in position_jumps(&positions, &config) {
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
    observed: &FootTracks,
) {
    let config = ClockConfig::default();
    let cameras = (0..rig.cameras.len()).filter(|camera| shows_tags(detections, *camera));
    let frames = cameras.flat_map(|camera| {
        let of_camera = Camera { rig, camera };
        of_camera.rest_frames(trajectory, detections, observed, is_level)
    });
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

/// Detections at the times of the trajectory's clock, and what they show: those of a camera whose
/// time stamps are late by what feet at rest show, which is reported, are moved.
pub(super) fn on_one_clock<'a>(
    work: &Findings,
    rig: &RigModel,
    trajectory: &Trajectory,
    detections: &'a [TagDetection],
) -> (Cow<'a, [TagDetection]>, FootTracks) {
    let mut on_clock = Cow::Borrowed(detections);
    let mut observed = FootTracks::new(rig, trajectory, detections);
    for (camera, name) in rig.cameras.iter().map(|own| &own.name).enumerate() {
        if !shows_tags(detections, camera) {
            continue;
        }
        let of_camera = Camera { rig, camera };
        let Some((late, moved)) = of_camera.late(trajectory, &on_clock, &observed) else {
            continue;
        };
        work.record_loss(format!(
            "feet at rest seem to move as if time stamps of the camera {name} were {:.1} ± {:.1} \
             ms late; its frames are used at earlier times by that, check its clock",
            1e3 * late.value,
            1e3 * late.sigma
        ));
        observed = FootTracks::new(rig, trajectory, &moved);
        on_clock = Cow::Owned(moved);
    }
    (on_clock, observed)
}

fn shows_tags(detections: &[TagDetection], camera: usize) -> bool {
    let mut cameras = detections.iter().map(|own| usize::from(own.camera));
    cameras.any(|own| own == camera)
}

/// A camera of a rig, by its number.
#[derive(Clone, Copy)]
struct Camera<'a> {
    rig: &'a RigModel,
    camera: usize,
}

impl Camera<'_> {
    /// By how much its time stamps are late, s, and detections without that; `None` if they are not
    /// by more than feet at rest determine.
    fn late(
        self,
        trajectory: &Trajectory,
        detections: &[TagDetection],
        observed: &FootTracks,
    ) -> Option<(Estimate, Vec<TagDetection>)> {
        let config = ClockConfig::default();
        let at = |late_s: f64| {
            let moved = self.moved(detections, late_s);
            let observed = FootTracks::new(self.rig, trajectory, &moved);
            let frames = self.rest_frames(trajectory, &moved, &observed, any);
            (moved, frames)
        };
        let frames = self.rest_frames(trajectory, detections, observed, any);
        let (mut late_s, mut frames) = match self.first_guess(detections, &frames, at) {
            Some((late_s, frames)) => (late_s, frames),
            None => (0.0, frames),
        };
        let mut moved = None;
        let mut sigma = f64::INFINITY;
        for _ in 0..ROUNDS {
            let Some(error) = clock_error(&frames, &config) else {
                break;
            };
            late_s += error.value;
            sigma = error.sigma;
            let is_known = error.value.abs() < error.sigma;
            if is_known && !config.is_error(late_s, sigma) {
                return None;
            }
            let (detections, next) = at(late_s);
            (moved, frames) = (Some(detections), next);
            if is_known {
                break;
            }
        }
        let late = Estimate {
            value: late_s,
            sigma,
        };
        moved
            .filter(|_| config.is_error(late_s, sigma))
            .map(|moved| (late, moved))
    }

    /// The error of its clock with which it shows feet at rest most often, s, and frames of these;
    /// none if it does so without one.
    fn first_guess(
        self,
        detections: &[TagDetection],
        without: &[Vec<RestFrame>],
        at: impl Fn(f64) -> (Vec<TagDetection>, Vec<Vec<RestFrame>>),
    ) -> Option<(f64, Vec<Vec<RestFrame>>)> {
        let config = ClockConfig::default();
        let of_camera = |own: &&TagDetection| usize::from(own.camera) == self.camera;
        let all = detections.iter().filter(of_camera).count() as f64;
        let count = |frames: &[Vec<RestFrame>]| frames.iter().map(Vec::len).sum::<usize>();
        let without = count(without) as f64;
        if without > config.usual_rest_share * all {
            return None;
        }
        let guesses = config.guesses_s.map(|late_s| (late_s, at(late_s).1));
        let most = guesses.into_iter().max_by_key(|(_, frames)| count(frames));
        most.filter(|(_, frames)| count(frames) as f64 > config.better_rest_ratio * without)
    }

    /// Detections of which its own are earlier, by time.
    fn moved(self, detections: &[TagDetection], late_s: f64) -> Vec<TagDetection> {
        let late_ns = (1e9 * late_s).round() as i64;
        let mut moved = detections.to_vec();
        for own in &mut moved {
            if usize::from(own.camera) == self.camera {
                own.time_ns -= late_ns;
            }
        }
        // Beside those of other cameras.
        moved.sort_by_key(|own| own.time_ns);
        moved
    }

    /// Where it shows the tags of feet at rest, by stance and tag, in stances that count.
    fn rest_frames(
        self,
        trajectory: &Trajectory,
        detections: &[TagDetection],
        observed: &FootTracks,
        counts: fn(&[Stance], usize) -> bool,
    ) -> Vec<Vec<RestFrame>> {
        let mut found = Vec::new();
        for (foot, stances) in Foot::ALL.into_iter().zip(&observed.stances) {
            for tag in shoe(self.rig, foot).map_or(&[][..], |shoe| &shoe.tags[..]) {
                // Those of one camera are in order of time, whatever its clock says.
                let own = detections.iter().filter(|own| {
                    usize::from(own.camera) == self.camera && own.tag == u64::from(tag.id)
                });
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
                let that_count = (0..stances.len()).filter(|k| counts(stances, *k));
                found.extend(that_count.map(|k| of_stance(&stances[k])));
            }
        }
        found
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
