//! Views of a walk: those of the training as the stage `splats` has them, and test views with exact
//! truth.
//!
//! Poses are true, and so are the masks of people and of the wearer. Instants are apart by the
//! spacing of keyframes of the preset `balanced`. They are in three parts: *gaps*, 2 m in every
//! 20 m of the path, of which no image trains or chooses anything; *validation*, every eighth one
//! of the others, which decides the number of Gaussians as in the stage; and *training*.
//!
//! Truth is of the static scene, without noise, motion blur, flare and people, at the median
//! exposure of the camera; depth is exact.

use anyhow::Result;
use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use camera_models::rectify::{Rectification, View};
use harness::sequences::Truth;
use rayon::prelude::*;
use reconstruction::pipeline::stages::splats::RecordedDepth;
use rig_sim::camera::Shutter;
use rig_sim::camera::sensor::Exposure;
use rig_sim::simulation::seconds;
use scene_bundle::outputs::depth::DepthView;
use splats::{Camera, TrainingView};

mod poses;

use super::recorded::{KeyframeImages, recorded};
use crate::meter;
use crate::terrain::walks::WalkInputs;

/// Length of a gap, and from the begin of one to that of the next, m.
const GAP_M: f64 = 2.0;
const GAP_PERIOD_M: f64 = 20.0;
/// Every which instant outside of gaps is for validation, and which of those, from 0; as the stage.
const VALIDATION_INTERVAL: usize = 8;
const VALIDATION_OFFSET: usize = 2;
/// Time over which the motion of a camera is measured, ns; as the stage.
const STEP_NS: i64 = 10_000_000;
/// Part of the poses in the standard deviation of a depth, m; as the stage.
const POSE_SIGMA_M: f32 = 0.003;
/// Exponent between radiance and the values of images; as the stage.
const GAMMA: f64 = 2.2;
/// Most cameras of a rig: images of one frame share an exposure group, as in the stage.
const MAX_CAMERAS: u32 = 8;

/// What an instant is used for; see the module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    Training,
    Validation,
    Gap,
}

/// What is known of exposures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum KnownExposure {
    /// Nothing.
    Nothing,
    /// The time, relative to the same reference for all cameras: as the stage has it.
    Time,
    /// Time and gain.
    TimeAndGain,
}

/// Which views to make of keyframes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ViewOptions {
    /// Factor by which images are reduced.
    pub(crate) reduction: u32,
    pub(crate) right_images: bool,
    /// Whether people and the wearer are masked.
    pub(crate) masks: bool,
    /// Whether views have stereo depth.
    pub(crate) depth: bool,
    pub(crate) exposure: KnownExposure,
}

impl ViewOptions {
    /// As the stage has them.
    pub(crate) const STAGE: Self = Self {
        reduction: 1,
        right_images: true,
        masks: true,
        depth: true,
        exposure: KnownExposure::Time,
    };
}

/// A view with exact truth.
#[derive(Clone, Debug)]
pub(crate) struct TestView {
    /// Colors and depth are the truth, NaN where it is the sky.
    pub(crate) view: TrainingView,
    pub(crate) camera: usize,
    pub(crate) frame: u64,
}

/// Keyframes of a walk in parts.
pub(crate) struct WalkViews {
    pub(crate) prepared: WalkInputs,
    cameras: Vec<WalkCamera>,
    keyframes: Vec<WalkKeyframe>,
    /// Poses of the rig instead of the true ones.
    estimated: Option<Truth>,
}

struct WalkCamera {
    models: [CameraModel; 2],
    rig_from_eye: [RigidTransform; 2],
    shutter: Shutter,
    recorded_depth: RecordedDepth,
    /// Median exposure time, s, and median of the time times the gain, s.
    median_s: f64,
    median_product_s: f64,
}

struct WalkKeyframe {
    recorded: KeyframeImages,
    instant: u32,
    part: Part,
}

impl WalkViews {
    /// Renders or reads the keyframes of a walk. `variant` names what differs from the usual walk
    /// of this name.
    ///
    /// # Errors
    /// A pair that cannot be rectified, or an I/O error.
    pub(crate) fn load(prepared: WalkInputs, variant: &str) -> Result<Self> {
        let ids = prepared.keyframes()?;
        let all = recorded(&prepared, &ids, variant)?;
        let parts = parts(&prepared, &all);
        let mut frames: Vec<u64> = all.iter().map(|own| own.id.frame).collect();
        frames.dedup();
        let keyframes: Vec<WalkKeyframe> = all
            .into_iter()
            .map(|recorded| {
                let instant = frames.partition_point(|frame| *frame < recorded.id.frame);
                WalkKeyframe {
                    recorded,
                    instant: instant as u32,
                    part: parts[instant],
                }
            })
            .collect();
        let count = prepared.simulation.cameras().len();
        let cameras = (0..count).map(|number| WalkCamera::new(&prepared, number, &keyframes));
        Ok(Self {
            cameras: cameras.collect::<Result<_>>()?,
            keyframes,
            prepared,
            estimated: None,
        })
    }

    /// Number of instants of a part.
    pub(crate) fn instants(&self, part: Part) -> usize {
        let mut own: Vec<u32> = self.of(part).map(|own| own.instant).collect();
        own.dedup();
        own.len()
    }

    /// Views of a part as recorded: for the training, or to choose by.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(crate) fn recorded(&self, part: Part, options: &ViewOptions) -> Result<Vec<TrainingView>> {
        let own: Vec<&WalkKeyframe> = self.of(part).collect();
        let eyes = 0..if options.right_images { 2 } else { 1 };
        let views: Result<Vec<Vec<TrainingView>>> = own
            .par_iter()
            .map(|own| {
                eyes.clone()
                    .map(|eye| self.view(own, eye, options))
                    .collect()
            })
            .collect();
        Ok(views?.into_iter().flatten().collect())
    }

    /// Left images of a part without noise, with exact depth.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(crate) fn truth(&self, part: Part, options: &ViewOptions) -> Result<Vec<TestView>> {
        let own: Vec<&WalkKeyframe> = self.of(part).collect();
        own.par_iter()
            .map(|own| {
                let id = own.recorded.id;
                let camera = self.camera(id.camera, 0, id.time_ns)?;
                self.rendered(id.camera, id.frame, camera, options, |time_s| {
                    let rig = self
                        .prepared
                        .simulation
                        .walker()
                        .rig(seconds(id.time_ns) + time_s);
                    self.prepared.simulation.cameras()[id.camera].world_from_eye(0, &rig, None)
                })
            })
            .collect()
    }

    /// The left image of a camera at another pose, without noise, with exact depth and a global
    /// shutter.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(crate) fn truth_at(
        &self,
        camera: usize,
        frame: u64,
        world_from_camera: &RigidTransform,
        options: &ViewOptions,
    ) -> Result<TestView> {
        let model = self.cameras[camera].models[0];
        let at = Camera::new(model, world_from_camera.inverse())?;
        let pose = (
            *world_from_camera.translation(),
            *world_from_camera.rotation(),
        );
        self.rendered(camera, frame, at, options, |_| pose)
    }

    /// The image of a lens without distortion at a pose, without noise, with exact depth and the
    /// exposure of a camera.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(crate) fn pinhole(
        &self,
        camera: usize,
        model: CameraModel,
        world_from_camera: &RigidTransform,
    ) -> Result<TrainingView> {
        let at = Camera::new(model, world_from_camera.inverse())?;
        let pose = (
            *world_from_camera.translation(),
            *world_from_camera.rotation(),
        );
        let options = ViewOptions::STAGE;
        Ok(self.rendered(camera, 0, at, &options, |_| pose)?.view)
    }

    /// Camera, frame and pose of the left images of a part, in order of time.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(crate) fn poses(&self, part: Part) -> Result<Vec<(usize, u64, RigidTransform)>> {
        self.of(part)
            .map(|own| {
                let id = own.recorded.id;
                let pose = self.world_from_eye(id.camera, 0, id.time_ns)?;
                Ok((id.camera, id.frame, pose))
            })
            .collect()
    }

    fn of(&self, part: Part) -> impl Iterator<Item = &WalkKeyframe> {
        self.keyframes.iter().filter(move |own| own.part == part)
    }

    /// The camera of a recorded image, with its motion where the shutter is rolling.
    fn camera(&self, number: usize, eye: usize, time_ns: i64) -> Result<Camera> {
        let of = &self.cameras[number];
        let model = of.models[eye];
        let pose = self.world_from_eye(number, eye, time_ns)?;
        let camera = Camera::new(model, pose.inverse())?;
        let Shutter::Rolling { line_s } = of.shutter else {
            return Ok(camera);
        };
        let from = self.world_from_eye(number, eye, time_ns - STEP_NS / 2)?;
        let to = self.world_from_eye(number, eye, time_ns + STEP_NS / 2)?;
        let motion = from.inverse() * to;
        let step_s = STEP_NS as f64 * 1e-9;
        let velocity = motion.translation_m().map(|v| v / step_s);
        let rate = motion.rotation_vector().map(|w| w / step_s);
        let rows = splats::Shutter::rows(line_s, model.height, velocity, rate);
        Ok(camera.with_shutter(rows)?)
    }

    fn view(&self, own: &WalkKeyframe, eye: usize, options: &ViewOptions) -> Result<TrainingView> {
        let id = own.recorded.id;
        let of = &self.cameras[id.camera];
        let camera = self.camera(id.camera, eye, id.time_ns)?;
        let rgb = own.recorded.rgb[eye].clone();
        let mut view = TrainingView::new(camera, rgb, own.instant);
        view.exposure_group = MAX_CAMERAS * own.instant + id.camera as u32;
        if options.masks {
            let is_person = own.recorded.is_person[eye].iter();
            view.mask = is_person.map(|is| !is).collect();
        }
        if options.depth && eye == 0 {
            let depth = of.recorded_depth.of(&own.recorded.depth, POSE_SIGMA_M);
            view.depth_m = depth.depth_m;
            view.depth_sigma_m = depth.sigma_m;
        }
        view.exposure = self.exposure(&own.recorded.exposure, options.exposure);
        Ok(view.reduced(options.reduction)?)
    }

    /// Exposure of an image as far as it is known.
    fn exposure(&self, of: &Exposure, known: KnownExposure) -> splats::Exposure {
        let ratio = match known {
            KnownExposure::Nothing => 1.0,
            KnownExposure::Time => of.seconds / self.cameras[0].median_s,
            KnownExposure::TimeAndGain => of.seconds * of.gain / self.cameras[0].median_product_s,
        };
        let log = libm::log(ratio) / GAMMA;
        splats::Exposure::from_log_gain([log as f32; 3])
    }

    /// `pose` is a function of the time since that of the image, s.
    fn rendered(
        &self,
        number: usize,
        frame: u64,
        camera: Camera,
        options: &ViewOptions,
        pose: impl Fn(f64) -> (nalgebra::Vector3<f64>, nalgebra::UnitQuaternion<f64>),
    ) -> Result<TestView> {
        let of = &self.cameras[number];
        let shutter = match camera.shutter() {
            Some(_) => of.shutter,
            None => Shutter::Global,
        };
        let exposure = Exposure {
            seconds: of.median_s,
            gain: of.median_product_s / of.median_s,
        };
        let simulation = &self.prepared.simulation;
        let mut renderer = simulation.view_renderer(camera.model(), shutter);
        let image = renderer.render(&pose, 0.0, &exposure);
        let mut view = TrainingView::new(camera, image.rgb.into_flattened(), 0);
        let finite = |depth: &f32| if depth.is_finite() { *depth } else { f32::NAN };
        view.depth_m = image.depth_m.iter().map(finite).collect();
        view.depth_sigma_m = vec![0.0; view.depth_m.len()];
        view.exposure = self.exposure(&exposure, options.exposure);
        Ok(TestView {
            view: view.reduced(options.reduction)?,
            camera: number,
            frame,
        })
    }
}

impl WalkCamera {
    fn new(prepared: &WalkInputs, number: usize, keyframes: &[WalkKeyframe]) -> Result<Self> {
        let simulation = &prepared.simulation;
        let camera = &simulation.cameras()[number];
        let rectification = Rectification::new(&simulation.calibration(number), View::Filled)?;
        let view = DepthView {
            camera: camera.name.clone(),
            model: rectification.camera,
            view_from_left: rectification.rectified_from_left,
        };
        let own = keyframes.iter().map(|own| &own.recorded);
        let own: Vec<&KeyframeImages> = own.filter(|own| own.id.camera == number).collect();
        let product = |own: &&KeyframeImages| own.exposure.seconds * own.exposure.gain;
        Ok(Self {
            models: camera.models,
            rig_from_eye: camera.rig_from_eye,
            shutter: camera.shutter,
            recorded_depth: RecordedDepth::new(&view, &camera.models[0]),
            median_s: meter::median(own.iter().map(|own| own.exposure.seconds)),
            median_product_s: meter::median(own.iter().map(product)),
        })
    }
}

/// Part of each instant.
fn parts(prepared: &WalkInputs, all: &[KeyframeImages]) -> Vec<Part> {
    let mut last: Option<(u64, nalgebra::Vector3<f64>)> = None;
    let (mut path_m, mut outside) = (0.0, 0);
    let mut parts = Vec::new();
    for own in all {
        if last.is_some_and(|(frame, _)| frame == own.id.frame) {
            continue;
        }
        let position = prepared
            .simulation
            .walker()
            .rig(seconds(own.id.time_ns))
            .position;
        path_m += last.map_or(0.0, |(_, before)| (position - before).norm());
        last = Some((own.id.frame, position));
        // In the middle of each period: there are training images before the first gap.
        let along = path_m % GAP_PERIOD_M - 0.5 * (GAP_PERIOD_M - GAP_M);
        parts.push(if (0.0..GAP_M).contains(&along) {
            Part::Gap
        } else {
            outside += 1;
            match (outside - 1) % VALIDATION_INTERVAL {
                VALIDATION_OFFSET => Part::Validation,
                _ => Part::Training,
            }
        });
    }
    parts
}
