//! Views of the training: images of keyframes with lens, pose, motion, mask, depth and exposure.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Eye};
use rayon::prelude::*;
use scene_bundle::outputs::depth::{self, DepthIndex, DepthKey};
use scene_bundle::outputs::rig::RigCamera;
use scene_bundle::outputs::splats::{SplatShutter, SplatView};
use scene_bundle::{OutputReader, Trajectory};
use session_input::{Color, Image, View};
use splats::{Camera, Exposure, Shutter, SplatError, TrainingView};

use super::config::SplatsConfig;
use super::keyframes::{CameraKeyframes, ChosenKeyframe};
use super::masks;
use super::recorded_depth::{DepthOfPixels, RecordedDepth};
use crate::pipeline::StageError;
use crate::pipeline::stages::pose_interpolation::pose_at;

/// Time over which the motion is measured, ns.
const STEP_NS: i64 = 10_000_000;

/// Stereo frames that are read in one go, on several threads.
pub(super) const BATCH: usize = 8;

/// Most cameras of a rig: images of one frame share an exposure.
const MAX_CAMERAS: u32 = 8;

/// A view of a keyframe.
pub(super) struct KeyframeView {
    pub(super) view: TrainingView,
    /// Number of the view among those of all keyframes; [`view_number`].
    pub(super) number: usize,
    pub(super) keyframe: ChosenKeyframe,
}

/// Number of a view: left and right ones of a keyframe follow each other, whether right ones are
/// used or not.
pub(super) fn view_number(keyframe: &ChosenKeyframe, eye: Eye) -> usize {
    2 * keyframe.number + usize::from(eye == Eye::Right)
}

/// Inputs of all cameras.
pub(super) struct Inputs<'a> {
    pub(super) trajectory: &'a Trajectory,
    pub(super) depth: &'a OutputReader,
    pub(super) index: &'a DepthIndex,
    pub(super) masks: &'a OutputReader,
    pub(super) config: &'a SplatsConfig,
}

/// Makes views of the keyframes of one camera.
pub(super) struct ViewMaker<'a> {
    inputs: &'a Inputs<'a>,
    camera: &'a RigCamera,
    /// Index of the camera's view among those of the depths, and its pixels.
    depth: Option<(usize, RecordedDepth)>,
}

impl<'a> ViewMaker<'a> {
    pub(super) fn new(inputs: &'a Inputs<'a>, keyframes: &CameraKeyframes<'a>) -> Self {
        let camera = keyframes.camera;
        let views = &inputs.index.views;
        let number = views.iter().position(|view| view.camera == camera.name);
        Self {
            inputs,
            camera,
            depth: number.map(|k| (k, RecordedDepth::new(&views[k], &camera.left))),
        }
    }

    /// Views of a few frames with their keyframes, in order: left, then right.
    pub(super) fn views(
        &self,
        frames: &[(View, ChosenKeyframe)],
    ) -> Result<Vec<KeyframeView>, StageError> {
        let views = frames
            .par_iter()
            .map(|(frame, chosen)| self.of_frame(frame, chosen));
        let views: Result<Vec<Vec<KeyframeView>>, StageError> = views.collect();
        Ok(views?.into_iter().flatten().collect())
    }

    fn of_frame(
        &self,
        frame: &View,
        chosen: &ChosenKeyframe,
    ) -> Result<Vec<KeyframeView>, StageError> {
        let config = self.inputs.config;
        let depth = self.depth_of(chosen)?;
        let left_mask = masks::left(self.inputs.masks, self.camera, chosen.keyframe.frame)?;
        let mut views = Vec::new();
        if config.right_images {
            let near = config.min_distance_m;
            let mask = masks::right(self.camera, &left_mask, &depth.depth_m, near);
            let none = DepthOfPixels::default();
            views.push(self.view(Eye::Right, &frame.right, chosen, (mask, none))?);
        }
        views.insert(
            0,
            self.view(Eye::Left, &frame.left, chosen, (left_mask, depth))?,
        );
        Ok(views)
    }

    /// Depth of the pixels of the left image of a keyframe; empty where it has none.
    pub(super) fn depth_of(&self, chosen: &ChosenKeyframe) -> Result<DepthOfPixels, StageError> {
        let Some((view, recorded)) = &self.depth else {
            return Ok(DepthOfPixels::default());
        };
        let key = DepthKey {
            view: *view,
            time_ns: chosen.keyframe.time_ns,
            frame: chosen.keyframe.frame,
            set: chosen.keyframe.set,
        };
        if !self.inputs.index.images.contains(&key) {
            return Ok(DepthOfPixels::default());
        }
        let image = depth::read(self.inputs.depth, self.inputs.index, &key)?;
        Ok(recorded.of(&image, self.inputs.config.pose_sigma_m))
    }

    fn view(
        &self,
        eye: Eye,
        image: &Image,
        chosen: &ChosenKeyframe,
        (mask, depth): (Vec<bool>, DepthOfPixels),
    ) -> Result<KeyframeView, StageError> {
        let record = self.record(eye, chosen);
        let model = self.model(eye);
        let camera = camera(model, &record.world_from_camera, record.shutter.as_ref())?;
        let mut view = TrainingView::new(camera, rgb(image), chosen.instant);
        view.exposure_group = MAX_CAMERAS * chosen.instant + u32::from(chosen.keyframe.camera);
        view.mask = mask;
        view.depth_m = depth.depth_m;
        view.depth_sigma_m = depth.sigma_m;
        view.exposure = exposure(chosen);
        Ok(KeyframeView {
            view: view.reduced(self.inputs.config.reduction)?,
            number: view_number(chosen, eye),
            keyframe: *chosen,
        })
    }

    fn model(&self, eye: Eye) -> CameraModel {
        match eye {
            Eye::Left => self.camera.left,
            Eye::Right => self.camera.right,
        }
    }

    /// What the bundle records of a view, as if the scene was trained with it.
    pub(super) fn record(&self, eye: Eye, chosen: &ChosenKeyframe) -> SplatView {
        let keyframe = &chosen.keyframe;
        let eye_from_left = match eye {
            Eye::Left => RigidTransform::identity(),
            Eye::Right => self.camera.right_from_left,
        };
        let rig_from_camera = self.camera.rig_from_left * eye_from_left.inverse();
        SplatView {
            camera: self.camera.name.clone(),
            eye,
            frame: keyframe.frame,
            set: keyframe.set,
            time_ns: keyframe.time_ns,
            world_from_camera: keyframe.world_from_left * eye_from_left.inverse(),
            shutter: self.shutter(&rig_from_camera, keyframe.time_ns),
            reduction: self.inputs.config.reduction,
            exposure: exposure(chosen).matrix,
            held_out: None,
        }
    }

    /// Motion of a camera with a rolling shutter at a time; `None` for a global shutter and where
    /// the poses around the time are not known.
    fn shutter(&self, rig_from_camera: &RigidTransform, time_ns: i64) -> Option<SplatShutter> {
        if self.camera.line_s <= 0.0 {
            return None;
        }
        let pose = |time_ns: i64| {
            let world_from_rig = pose_at(self.inputs.trajectory, time_ns)?;
            Some(world_from_rig * *rig_from_camera)
        };
        let (from, to) = (pose(time_ns - STEP_NS / 2)?, pose(time_ns + STEP_NS / 2)?);
        let motion = from.inverse() * to;
        let seconds = STEP_NS as f64 * 1e-9;
        Some(SplatShutter {
            line_s: self.camera.line_s,
            velocity_m_s: motion.translation_m().map(|v| v / seconds),
            rate_rad_s: motion.rotation_vector().map(|w| w / seconds),
        })
    }
}

fn exposure(chosen: &ChosenKeyframe) -> Exposure {
    Exposure::from_log_gain([libm::logf(chosen.gain); 3])
}

/// The camera of an image as recorded.
fn camera(
    model: CameraModel,
    world_from_camera: &RigidTransform,
    shutter: Option<&SplatShutter>,
) -> Result<Camera, SplatError> {
    let camera = Camera::new(model, world_from_camera.inverse())?;
    match shutter {
        None => Ok(camera),
        Some(of) => camera.with_shutter(Shutter::rows(
            of.line_s,
            model.height,
            of.velocity_m_s,
            of.rate_rad_s,
        )),
    }
}

/// Colors of an image; gray ones as three equal channels.
fn rgb(image: &Image) -> Vec<u8> {
    match image.color {
        Color::Rgb => image.data.to_vec(),
        Color::Grey => image.data.iter().flat_map(|gray| [*gray; 3]).collect(),
    }
}
