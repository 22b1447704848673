//! Stage `tags`: tags on the wearer's shoes in the images of all cameras that can see them.
//!
//! Contract: each frame of a camera that may see the ground below the rig is read once, in order of
//! time; tags are fitted where their shoe is predicted, in both eyes, and searched where it is not
//! (`feet::tag_tracker`). Poses are relative to the rig, so errors of the trajectory do not enter
//! them. A rig without tags on shoes, or without a camera that can see them, is no loss: there is
//! nothing to do. Memory does not grow with the session.

use std::collections::BTreeMap;

use ::feet::shoe::{Shoe, ShoeTag, Side};
use ::feet::tag_tracker::{Camera, Detection, Frame, RigState, TagTracker};
use cad_transforms::rig::{Foot, TagFamily};
use cad_transforms::{Covariance, RigidTransform};
use camera_models::Lens;
use fiducials::Motion;
use imaging::ImageView;
use nalgebra::Vector3;
use scene_bundle::outputs::rig::{RigCamera, RigModel, RigShoe};
use scene_bundle::outputs::tag_detections::{SecondPose, TagDetection, TagDetectionsWriter};
use scene_bundle::outputs::{self, RIG_REFINED, TAG_DETECTIONS, TRAJECTORY};
use scene_bundle::{Trajectory, error_chain};
use serde_json::{Value, json};
use session_input::View;

use super::pose_interpolation::pose_at;
use crate::input::{HANDOFF, Input};
use crate::pipeline::{Findings, Stage, StageError, Work};

/// Half of the time over which the motion of the rig is a difference of its poses, ns.
const MOTION_NS: i64 = 5_000_000;
/// Share of a tag's cells in an eye below which that eye says nothing.
const MIN_EYE_SHARE: f32 = 0.25;
/// Least number of detections that say something of eyes.
const MIN_DETECTIONS: u32 = 10;
/// Where shoes can be relative to the rig, m: depths below it, and the distance from the vertical
/// through it.
const BELOW_M: [f64; 2] = [0.7, 1.5];
const ASIDE_M: f64 = 0.5;

/// See the module.
pub(super) struct TagsStage;

impl Stage<Input> for TagsStage {
    fn name(&self) -> &'static str {
        "tags"
    }

    fn version(&self) -> u32 {
        5
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[HANDOFF, RIG_REFINED, TRAJECTORY]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[TAG_DETECTIONS]
    }

    fn settings(&self) -> Value {
        json!({ "tracker": ::feet::Config::default() })
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let rig = outputs::rig::read(&work.read(RIG_REFINED)?)?;
        let trajectory = outputs::trajectory::read(&work.read(TRAJECTORY)?)?;
        let mut writer = TagDetectionsWriter::new(work.draft(TAG_DETECTIONS))?;
        let (shoes, ids) = shoes(&rig);
        let seeing = seeing_cameras(&rig);
        match (ids.is_empty(), seeing.is_empty()) {
            (true, _) => work.note(
                "the rig file has no tags on shoes ([[shoe_tag]]): there are no poses of feet",
            ),
            (false, true) => work.note(
                "no camera of the rig can see the wearer's shoes: there are no poses of feet",
            ),
            (false, false) => {
                let tracked = TrackerInputs {
                    rig: &rig,
                    trajectory: &trajectory,
                    ids: &ids,
                };
                tracked.run(work, shoes, &seeing, &mut writer)?;
            }
        }
        writer.finish()?;
        Ok(())
    }
}

/// What is tracked.
struct TrackerInputs<'a> {
    rig: &'a RigModel,
    trajectory: &'a Trajectory,
    /// Numbers of the tags of each shoe, and its foot.
    ids: &'a [(Foot, Vec<u64>)],
}

impl TrackerInputs<'_> {
    fn run(
        &self,
        work: &Work<'_, Input>,
        shoes: Vec<Shoe>,
        seeing: &[usize],
        writer: &mut TagDetectionsWriter<'_>,
    ) -> Result<(), StageError> {
        let input = work.source();
        let cameras = self.rig.cameras.iter().map(camera).collect();
        let mut tracker = TagTracker::new(shoes, cameras, ::feet::Config::default());
        let mut frames = Vec::new();
        for &camera in seeing {
            let name = &self.rig.cameras[camera].name;
            frames.push((camera, input.session().luma_frames_where(name, |_| true)?));
        }
        let names = seeing.iter().map(|&camera| &self.rig.cameras[camera].name);
        let indices = names.filter_map(|name| input.index().camera(name));
        let all: u64 = indices.map(|camera| camera.frames.len() as u64).sum();
        // The next frame of each camera, the earliest of which is next.
        let mut next: Vec<Option<View>> = vec![None; frames.len()];
        let (mut done, mut seen) = (0_u64, 0_u64);
        let mut eyes = EyeCounts::default();
        let mut losses = Vec::new();
        loop {
            for (waiting, (_, frames)) in next.iter_mut().zip(&mut frames) {
                while waiting.is_none() {
                    match frames.next() {
                        Some(Ok(view)) => *waiting = Some(view),
                        Some(Err(loss)) => losses.push(loss),
                        None => break,
                    }
                }
            }
            losses
                .drain(..)
                .for_each(|loss| work.record_loss_from(&loss));
            let times = next.iter().enumerate();
            let times = times.filter_map(|(k, view)| Some((view.as_ref()?.time.ns(), k)));
            let Some((_, k)) = times.min() else { break };
            let Some(view) = next[k].take() else { break };
            let mut found = tracker.add(&self.frame(frames[k].0, &view));
            found.sort_by_key(|sighting| self.tag(sighting).1);
            for sighting in &found {
                match self.detection(sighting, &view) {
                    Ok(detection) => {
                        eyes.count(sighting, &detection);
                        writer.push(&detection)?;
                    }
                    Err(error) => work.record_loss(error_chain(&*error)),
                }
            }
            seen += u64::from(!found.is_empty());
            done += 1;
            work.progress(done, all);
        }
        report(work.findings(), &eyes, &self.rig.cameras, seen, done);
        report_repeated(work.findings(), tracker.repeated_images(), done);
        Ok(())
    }

    fn frame<'a>(&self, camera: usize, view: &'a View) -> Frame<'a> {
        let luma = |image: &'a session_input::Image| {
            let (width, height) = (image.width as usize, image.height as usize);
            ImageView::new(width, height, width, &image.data)
                .expect("a decoded luma image is whole")
        };
        Frame {
            camera,
            time_ns: view.time.ns(),
            images: [luma(&view.left), luma(&view.right)],
            exposure_s: view.exposure_ns.map_or(0.0, |ns| 1e-9 * f64::from(ns)),
            rig: rig_state(self.trajectory, view.time.ns()),
        }
    }

    /// Foot and number of a tag.
    fn tag(&self, sighting: &Detection) -> (Foot, u64) {
        let (foot, ids) = &self.ids[sighting.shoe];
        (*foot, ids[sighting.tag])
    }

    fn detection(&self, sighting: &Detection, view: &View) -> Result<TagDetection, StageError> {
        detection(sighting, self.tag(sighting), view.number)
    }
}

/// The row of a detection in a frame, of a tag with this foot and number.
///
/// # Errors
/// Rounding makes its covariance none.
pub fn detection(
    sighting: &Detection,
    (foot, tag): (Foot, u64),
    frame: u64,
) -> Result<TagDetection, StageError> {
    let fit = &sighting.fit;
    let share = |eye: usize| fit.visible_share.get(eye).copied().unwrap_or(0.0) as f32;
    Ok(TagDetection {
        time_ns: sighting.time_ns,
        frame,
        camera: sighting.camera as u8,
        foot,
        tag,
        rig_from_tag: fit.reference_from_tag,
        covariance: covariance(&fit.covariance)?,
        visible_share: [share(0), share(1)],
        rms_levels: fit.rms_levels as f32,
        wrong_bits: u8::try_from(fit.wrong_bits).unwrap_or(u8::MAX),
        second: fit.other.as_ref().map(|other| SecondPose {
            rig_from_tag: other.reference_from_tag,
            excess_cost: other.excess_cost as f32,
        }),
    })
}

/// How both eyes of each camera agree about tags.
#[derive(Clone, Debug, Default)]
pub struct EyeCounts(BTreeMap<u8, CameraCounts>);

/// How both eyes of a camera agree.
#[derive(Clone, Debug, Default)]
struct CameraCounts {
    /// Number of detections, and of those in which one eye was used of two.
    all: u32,
    one: u32,
    /// From the ray of the left eye to that of the right one: to the right and down, m.
    between: [Vec<f64>; 2],
}

/// Distance of the rays of both eyes from which on one of what they depend on is wrong, m: 1.3 % of
/// the size of tags with a baseline of 63 mm, or 0.04 degrees of a right eye 1.1 m above them. By
/// day it is below 0.1 mm with an exact calibration, 0.45 mm with the estimated one of the demo.
const MAX_BETWEEN_M: f64 = 0.0008;

impl EyeCounts {
    /// Adds a detection, as tracked and as a row.
    pub fn count(&mut self, seen: &Detection, row: &TagDetection) {
        let [left, right] = row.visible_share;
        let camera = self.0.entry(row.camera).or_default();
        camera.all += 1;
        camera.one += u32::from(left.min(right) < MIN_EYE_SHARE);
        for (all, own) in camera
            .between
            .iter_mut()
            .zip(seen.between_eyes.into_iter().flatten())
        {
            all.push(own);
        }
    }
}

impl CameraCounts {
    /// Reports how both eyes of a camera of this name agree.
    fn report(&self, work: &Findings, camera: &str) {
        if self.disagree() {
            work.record_loss(format!(
                "{} of {} detections of tags by camera {camera} fit the image of one eye only, so \
                 their distances are not known: check size_m of [[shoe_tag]], the calibration of \
                 the camera, and whether an eye is covered",
                self.one, self.all
            ));
        } else if let Some(apart) = self.apart() {
            let [right, down] = apart.map(|own| 1e3 * own);
            let places = format!(
                "at the distance that their size says, the right eye of camera {camera} places \
                 tags {:.2} mm to the {} of and {:.2} mm {} where the left one does",
                right.abs(),
                if right < 0.0 { "left" } else { "right" },
                down.abs(),
                if down < 0.0 { "above" } else { "below" },
            );
            match apart.iter().any(|own| own.abs() > MAX_BETWEEN_M) {
                true => work.record_loss(format!(
                    "{places}, so that heights of feet are wrong: check size_m of [[shoe_tag]] \
                     and the calibration of the camera"
                )),
                false => work.note(places),
            }
        }
    }

    /// Whether most detections use one eye, which happens at the edge of images alone now and then.
    fn disagree(&self) -> bool {
        self.all >= MIN_DETECTIONS && 2 * self.one > self.all
    }

    /// Median distances of the rays of both eyes, to the right and down, m; `None` of too few.
    fn apart(&self) -> Option<[f64; 2]> {
        let mut apart = [0.0; 2];
        for (apart, all) in apart.iter_mut().zip(&self.between) {
            if all.len() < MIN_DETECTIONS as usize {
                return None;
            }
            let mut sorted = all.clone();
            sorted.sort_by(f64::total_cmp);
            *apart = sorted[sorted.len() / 2];
        }
        Some(apart)
    }
}

/// Reports what the frames of the cameras show: `seen` of `done` contain a tag.
pub fn report(work: &Findings, eyes: &EyeCounts, cameras: &[RigCamera], seen: u64, done: u64) {
    let share = 100.0 * seen as f64 / done.max(1) as f64;
    work.note(format!(
        "{share:.0} % of {done} frames show a tag of a shoe"
    ));
    for (camera, counts) in &eyes.0 {
        let name = cameras
            .get(usize::from(*camera))
            .map_or("", |camera| camera.name.as_str());
        counts.report(work, name);
    }
    if seen == 0 {
        work.record_loss(format!(
            "none of {done} frames shows a tag of a shoe: check numbers, size and family of \
             [[shoe_tag]] in the rig file, and whether an eye is covered"
        ));
    }
}

/// Reports frames that repeat the image before them, of all.
pub fn report_repeated(work: &Findings, repeated: u64, done: u64) {
    if repeated > 0 {
        work.record_loss(format!(
            "{repeated} of {done} frames repeat the image before them, whole or in part, while the \
             rig moves: the camera delivered images twice; feet are not known in them"
        ));
    }
}

/// Translation first, as files have it; a fit has rotation first.
fn covariance(fit: &nalgebra::Matrix6<f64>) -> Result<Covariance, StageError> {
    let place = |k: usize| (k + 3) % 6;
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| fit[(place(i), place(j))]));
    Ok(Covariance::from_rows(rows)?)
}

/// Shoes with tags, with their feet and the numbers of their tags.
pub fn shoes(rig: &RigModel) -> (Vec<Shoe>, Vec<(Foot, Vec<u64>)>) {
    let with_tags = rig.shoes.iter().filter(|shoe| !shoe.tags.is_empty());
    with_tags.map(shoe).unzip()
}

fn shoe(shoe: &RigShoe) -> (Shoe, (Foot, Vec<u64>)) {
    let tags = shoe.tags.iter().filter_map(|tag| {
        let dictionary = match tag.family {
            TagFamily::Tag36h11 => boards::Dictionary::AprilTag36h11,
        };
        let shoe_tag = ShoeTag {
            tag: fiducials::Tag::new(dictionary, tag.id, tag.size_m)?,
            foot_from_tag: tag.foot_from_tag,
        };
        Some((shoe_tag, u64::from(tag.id)))
    });
    let (tags, ids) = tags.unzip();
    let side = match shoe.foot {
        Foot::Left => Side::Left,
        Foot::Right => Side::Right,
    };
    (Shoe { side, tags }, (shoe.foot, ids))
}

/// A camera as the tracker has it.
pub fn camera(camera: &RigCamera) -> Camera {
    let rig_from_right = camera.rig_from_left * camera.right_from_left.inverse();
    Camera {
        lenses: [Lens::new(&camera.left), Lens::new(&camera.right)],
        rig_from_eye: [camera.rig_from_left, rig_from_right],
        line_s: camera.line_s,
    }
}

/// Cameras that can see where shoes can be.
fn seeing_cameras(rig: &RigModel) -> Vec<usize> {
    let steps = [-1.0, -0.5, 0.0, 0.5, 1.0].map(|share| share * ASIDE_M);
    let places = BELOW_M
        .into_iter()
        .flat_map(|below| steps.into_iter().map(move |x| (below, x)))
        .flat_map(|(below, x)| steps.into_iter().map(move |y| [x, y, -below]));
    let places: Vec<[f64; 3]> = places.collect();
    let sees = |of: &RigCamera| {
        let (lens, left_from_rig) = (Lens::new(&of.left), of.rig_from_left.inverse());
        let is_inside = |pixel: [f64; 2]| {
            let size = [of.left.width, of.left.height].map(f64::from);
            (0..2).all(|k| pixel[k] >= 0.0 && pixel[k] < size[k])
        };
        places.iter().any(|place| {
            let point = left_from_rig.apply(*place);
            point[2] > 0.0 && lens.project(point).is_some_and(is_inside)
        })
    };
    let cameras = rig.cameras.iter().enumerate();
    cameras.filter(|(_, of)| sees(of)).map(|(k, _)| k).collect()
}

/// Pose and motion of the rig at a time, where it is tracked.
pub fn rig_state(trajectory: &Trajectory, time_ns: i64) -> Option<RigState> {
    let world_from_rig = pose_at(trajectory, time_ns)?;
    let at = |by_ns: i64| pose_at(trajectory, time_ns + by_ns).unwrap_or(world_from_rig);
    let (before, after) = (at(-MOTION_NS), at(MOTION_NS));
    let seconds = 2e-9 * MOTION_NS as f64;
    let linear: Vector3<f64> = (after.translation() - before.translation()) / seconds;
    let turn: RigidTransform = before.inverse() * after;
    let angular = world_from_rig.rotation() * Vector3::from(turn.rotation_vector()) / seconds;
    Some(RigState {
        world_from_rig,
        motion: Motion {
            linear: linear.into(),
            angular: angular.into(),
        },
    })
}
