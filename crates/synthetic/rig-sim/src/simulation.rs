//! A walk with the rig: sensor data and ground truth.
//!
//! Contract: everything is a function of [`Settings`] and the rig. The images of a camera depend on
//! its own earlier images, through the exposure control, and on no other camera, so cameras may be
//! rendered on parallel threads without any effect on the result. Times are integer ns since the
//! beginning of the walk: frame `n` is exposed in the middle of the `n`-th period, by all cameras
//! simultaneously, and IMU sample `n` is taken at `n` over the rate. Clock offsets and drifts are
//! added by the simulated device.

use std::sync::{Arc, OnceLock};

use boards::Target;
use cad_transforms::RigidTransform;
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::Rig;
use camera_models::{CameraModel, StereoCalibration};
use nalgebra::{UnitQuaternion, Vector3};

use crate::calibration_error::{CalibrationError, true_rig_toml};
use crate::camera::placed::{Motion, SceneBody, placed};
use crate::camera::{Quality, Shutter};
use crate::faults::WearerFaults;
use crate::imu::{ImuFaults, ImuModel, ImuSample};
use crate::lens::Lens;
use crate::rig::{SimCamera, shoe_tags};
use crate::scene::body::Body;
use crate::scene::tag;
use crate::scene::wearer::{Part, Wearer};
use crate::scene::{Kind, Scene, Scenery};
use crate::targets::board::{Board, Sheet};
use crate::targets::observations::TargetObservations;
use crate::targets::{self, Plan};
use crate::walker::Walker;
use crate::walker::gait_model::{self, GaitModel};

mod frame_renderer;
mod ground_truth;
mod imaging;
mod sensors;
mod settings;
mod view_renderer;

pub use self::frame_renderer::{FrameRenderer, FrameSource, StereoFrame};
pub use self::ground_truth::{GroundTruth, TagObservation};
pub use self::imaging::{EyeDifference, Imaging};
pub use self::sensors::RigImu;
pub use self::settings::{Settings, SimulationError, seconds};
pub use self::view_renderer::{ViewImage, ViewRenderer};

use self::sensors::{
    MAX_EXPOSURE_RATIO, NominalCamera, calibration_of, imus, nominal_cameras, sensors,
};
use self::settings::{check_imaging, in_ranges};

/// A simulated walk; see the module documentation.
#[derive(Clone, Debug)]
pub struct Simulation {
    settings: Settings,
    /// Created on first use if the walk does not depend on it.
    scene: OnceLock<Scene>,
    walker: Walker,
    boards: Vec<Board>,
    plan: Option<Plan>,
    /// True camera models and extrinsics.
    cameras: Vec<SimCamera>,
    /// One IMU per camera.
    imus: Vec<RigImu>,
    /// Nominal calibration of each camera, as recorded.
    nominal: Vec<NominalCamera>,
    /// Whether a session contains intrinsics and extrinsics at all.
    has_calibration: bool,
    imaging: Imaging,
    scenery: Scenery,
}

impl Simulation {
    /// Creates scene, walk and sensors; for [`Kind::Targets`] the recommended calibration session
    /// ([`Plan::GOOD`]).
    ///
    /// # Errors
    /// [`SimulationError`].
    pub fn new(settings: &Settings, rig: &Rig) -> Result<Self, SimulationError> {
        Self::with_wearer_faults(settings, rig, &WearerFaults::default())
    }

    /// The same with faults of the wearer; target sessions have none.
    ///
    /// # Errors
    /// [`SimulationError`].
    pub fn with_wearer_faults(
        settings: &Settings,
        rig: &Rig,
        faults: &WearerFaults,
    ) -> Result<Self, SimulationError> {
        Self::walk(settings, rig, faults, None)
    }

    /// The same walk of a wearer with another gait; target sessions have none.
    ///
    /// # Errors
    /// [`SimulationError`].
    pub fn with_gait(
        settings: &Settings,
        rig: &Rig,
        gait: &dyn GaitModel,
    ) -> Result<Self, SimulationError> {
        Self::walk(settings, rig, &WearerFaults::default(), Some(gait))
    }

    fn walk(
        settings: &Settings,
        rig: &Rig,
        faults: &WearerFaults,
        gait: Option<&dyn GaitModel>,
    ) -> Result<Self, SimulationError> {
        if settings.kind == Kind::Targets {
            let target = |number| Some(targets::april_grid(number));
            return Self::with_targets(settings, rig, &Plan::GOOD, &target);
        }
        let (cameras, imus) = sensors(settings, rig)?;
        let tags = shoe_tags(rig).map_err(|id| SimulationError::Tag {
            id,
            last: tag::COUNT - 1,
        })?;
        let Settings {
            kind,
            lighting,
            seed,
            seconds,
            ..
        } = *settings;
        let profile = gait_model::profile(seed, gait);
        let scene = Scene::with_tags(kind, lighting, seed, &profile, &tags, faults);
        let walker = match gait {
            Some(gait) => Walker::with_gait(&scene, seed, seconds, gait),
            None => Walker::with_faults(&scene, seed, seconds, faults),
        };
        let nominal = nominal_cameras(&cameras, &imus);
        Ok(Self {
            settings: *settings,
            scene: OnceLock::from(scene),
            walker,
            boards: Vec::new(),
            plan: None,
            cameras,
            imus,
            nominal,
            has_calibration: true,
            imaging: Imaging::USUAL,
            scenery: Scenery::default(),
        })
    }

    /// Creates a room with boards, the first of which is `target(0)`, and the path on which the rig
    /// is carried before them. A camera without a board of its own faces the board of the
    /// neighboring camera. [`Settings::kind`] must be [`Kind::Targets`]. The room itself is created
    /// on first use: corner observations and IMU samples do not need it.
    ///
    /// # Errors
    /// [`SimulationError`].
    ///
    /// # Panics
    /// For a target that cannot be drawn.
    pub fn with_targets(
        settings: &Settings,
        rig: &Rig,
        plan: &Plan,
        target: &dyn Fn(usize) -> Option<Target>,
    ) -> Result<Self, SimulationError> {
        let (cameras, imus) = sensors(settings, rig)?;
        if settings.kind != Kind::Targets {
            return Err(SimulationError::Setting {
                what: "the scene of a target session",
                found: settings.kind.name().to_owned(),
                expected: Kind::Targets.name().to_owned(),
            });
        }
        plan.check()?;
        let sheet = |number: usize| target(number).map(Sheet::new);
        let (boards, facing) = targets::boards(&cameras, &sheet, plan, settings.seed);
        if boards.is_empty() {
            return Err(SimulationError::Setting {
                what: "the number of boards",
                found: "0".to_owned(),
                expected: "at least 1, and a rig with a camera".to_owned(),
            });
        }
        let (seed, seconds) = (settings.seed, settings.seconds);
        let spline = targets::motion::spline(&cameras, &boards, &facing, plan, seconds, seed);
        let nominal = nominal_cameras(&cameras, &imus);
        Ok(Self {
            settings: *settings,
            scene: OnceLock::new(),
            walker: Walker::carrying(spline, settings.seed, seconds),
            boards,
            plan: Some(*plan),
            cameras,
            imus,
            nominal,
            has_calibration: true,
            imaging: Imaging::USUAL,
            scenery: Scenery::default(),
        })
    }

    /// The same walk with the intrinsics of a calibration in one camera. Extrinsics remain those of
    /// the rig file.
    ///
    /// # Errors
    /// [`SimulationError::Lenses`].
    pub fn with_lenses(
        mut self,
        camera: &str,
        calibration: &StereoCalibration,
    ) -> Result<Self, SimulationError> {
        let (at, models) = self.lenses(camera, calibration)?;
        self.cameras[at].models = models;
        self.nominal[at].models = models;
        Ok(self)
    }

    /// The same recording with true intrinsics that differ from the recorded ones in one camera.
    ///
    /// # Errors
    /// [`SimulationError::Lenses`].
    pub fn with_true_lenses(
        mut self,
        camera: &str,
        calibration: &StereoCalibration,
    ) -> Result<Self, SimulationError> {
        let (at, models) = self.lenses(camera, calibration)?;
        self.cameras[at].models = models;
        Ok(self)
    }

    /// The same recording with the true extrinsics of `rig`, while the recorded rig file is
    /// unchanged. Both rigs have the same cameras. Call it after [`Simulation::with_imus`].
    ///
    /// # Errors
    /// [`SimulationError::Rig`].
    pub fn with_true_rig(mut self, rig: &Rig) -> Result<Self, SimulationError> {
        let model = self
            .imus
            .first()
            .map_or(ImuModel::ZED_MINI, |i| *i.imu.model());
        let part = |name: &str, part| {
            let frame = Frame::of_camera(name, part).expect("the name of a camera");
            rig.transform(&Frame::rig(), &frame)
        };
        for camera in &mut self.cameras {
            let name = &camera.name;
            camera.rig_from_eye = [part(name, FramePart::Left)?, part(name, FramePart::Right)?];
        }
        self.imus = imus(model, &self.cameras, &self.settings, rig)?;
        Ok(self)
    }

    /// The same recording of a rig that differs from its recorded calibration, which was made from
    /// `rig`. Call it last.
    ///
    /// # Errors
    /// [`SimulationError::Rig`].
    pub fn with_calibration_error(
        mut self,
        rig: &Rig,
        calibration_error: &CalibrationError,
    ) -> Result<Self, SimulationError> {
        let displaced: Vec<_> = calibration_error
            .cameras
            .iter()
            .filter(|c| !c.has_nominal_extrinsics())
            .collect();
        if !displaced.is_empty() {
            let text = true_rig_toml(rig, &|frame, placed, left| {
                let (camera, part) = frame.camera()?;
                Some(calibration_error.of(camera).true_pose(part, left, placed))
            });
            self = self.with_true_rig(&Rig::parse(&text)?)?;
        }
        for camera in &mut self.cameras {
            let own = calibration_error.of(&camera.name);
            camera.time_offset_ns = own.time_offset_ns;
            camera.models = camera.models.map(|model| own.true_lens(&model));
        }
        Ok(self)
    }

    /// Whether the ground truth differs from the recorded calibration.
    pub(crate) fn differs_from_calibration(&self) -> bool {
        self.nominal != nominal_cameras(&self.cameras, &self.imus)
            || self.cameras.iter().any(|c| c.time_offset_ns != 0)
    }

    /// Rig file (TOML) with the true extrinsics; `nominal` is the recorded rig.
    pub fn true_rig_toml(&self, nominal: &Rig) -> String {
        true_rig_toml(nominal, &|frame, _, _| {
            let (name, part) = frame.camera()?;
            let at = self.cameras.iter().position(|c| c.name == name)?;
            Some(match part {
                FramePart::Left => self.cameras[at].rig_from_eye[0],
                FramePart::Right => self.cameras[at].rig_from_eye[1],
                FramePart::Imu => self.imus[at].imu_from_rig.inverse(),
            })
        })
    }

    /// The same recording with another sensor response.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for an exposure that is not positive or longer than a period,
    /// or another value out of range.
    pub fn with_imaging(mut self, imaging: Imaging) -> Result<Self, SimulationError> {
        let most = MAX_EXPOSURE_RATIO / self.settings.rate_hz;
        let is_time = |s: f64| s > 0.0 && s <= most;
        if let Some(found) = imaging.exposure_s.filter(|s| !is_time(*s)) {
            return Err(SimulationError::Setting {
                what: "the exposure",
                found: format!("{found} s"),
                expected: format!("above 0 and at most {most} s"),
            });
        }
        check_imaging(&imaging)?;
        if imaging.global_shutter {
            let cameras = self.cameras.iter_mut();
            cameras.for_each(|camera| camera.shutter = Shutter::Global);
        }
        self.imaging = imaging;
        Ok(self)
    }

    /// The same walk with scenery.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for a value out of range, or for scenery of a target session.
    pub fn with_scenery(mut self, scenery: Scenery) -> Result<Self, SimulationError> {
        let Scenery {
            fence_spacing_m,
            gloss,
        } = scenery;
        let least_m = if fence_spacing_m > 0.0 { 0.05 } else { 0.0 };
        in_ranges(&[
            (
                "the spacing of the fence, m,",
                fence_spacing_m,
                least_m,
                2.0,
            ),
            ("the gloss of the ground", f64::from(gloss), 0.0, 1.0),
        ])?;
        if scenery == self.scenery {
            return Ok(self);
        }
        match self.scene.get_mut() {
            Some(scene) if self.plan.is_none() => scene.furnish(&scenery),
            _ => {
                return Err(SimulationError::Setting {
                    what: "the scenery of a target session",
                    found: format!("{scenery:?}"),
                    expected: "none".to_owned(),
                });
            }
        }
        self.scenery = scenery;
        Ok(self)
    }

    /// Index of a camera, and the validated intrinsics of its calibration.
    fn lenses(
        &self,
        camera: &str,
        calibration: &StereoCalibration,
    ) -> Result<(usize, [CameraModel; 2]), SimulationError> {
        let expected = (self.settings.width, self.settings.height);
        let Some(of) = self.cameras.iter().position(|c| c.name == camera) else {
            let known: Vec<&str> = self.cameras.iter().map(|c| c.name.as_str()).collect();
            return Err(SimulationError::Lenses(format!(
                "found {camera:?}, expected one of {}",
                known.join(", ")
            )));
        };
        let models = [calibration.left, calibration.right];
        for model in &models {
            if !Lens::can_draw(&model.distortion) {
                return Err(SimulationError::Lenses(format!(
                    "the calibration of {camera} has a lens of model {}, expected a pinhole model or \
                     kannala_brandt4: convert it",
                    model.distortion.name()
                )));
            }
            if (model.width, model.height) != expected {
                return Err(SimulationError::Lenses(format!(
                    "the calibration of {camera} is for {}x{}, expected {}x{}",
                    model.width, model.height, expected.0, expected.1
                )));
            }
        }
        Ok((of, models))
    }

    /// The same walk with other IMUs in the cameras.
    ///
    /// # Errors
    /// [`SimulationError::Rig`].
    pub fn with_imus(mut self, model: ImuModel, rig: &Rig) -> Result<Self, SimulationError> {
        self.imus = imus(model, &self.cameras, &self.settings, rig)?;
        for (nominal, imu) in self.nominal.iter_mut().zip(&self.imus) {
            nominal.imu_from_rig = imu.imu_from_rig;
        }
        Ok(self)
    }

    /// The same recording of an uncalibrated rig: its session has neither a rig file nor
    /// intrinsics.
    #[must_use]
    pub fn without_calibration(mut self) -> Self {
        self.has_calibration = false;
        self
    }

    /// Whether a session contains a rig file and intrinsics.
    pub(crate) fn has_calibration(&self) -> bool {
        self.has_calibration
    }

    /// The same walk with another rendering quality.
    #[must_use]
    pub fn with_quality(mut self, quality: Quality) -> Self {
        self.settings.quality = quality;
        self
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        let Settings { lighting, seed, .. } = self.settings;
        let new = || Scene::with_boards(lighting, seed, &self.boards);
        self.scene.get_or_init(new)
    }

    /// Scenery of the walk.
    pub(crate) fn scenery(&self) -> &Scenery {
        &self.scenery
    }

    /// The calibration boards; none on a walk.
    pub fn boards(&self) -> &[Board] {
        &self.boards
    }

    /// Plan of the calibration session; none on a walk.
    pub fn plan(&self) -> Option<&Plan> {
        self.plan.as_ref()
    }

    /// Sensor response.
    pub fn imaging(&self) -> &Imaging {
        &self.imaging
    }

    /// Corner observations of a camera, computed without rendering.
    pub fn target_observations(&self, camera: usize) -> TargetObservations<'_> {
        TargetObservations::new(self, camera)
    }

    /// Faults of the wearer.
    pub fn wearer_faults(&self) -> &WearerFaults {
        self.walker.faults()
    }

    /// The walk.
    pub fn walker(&self) -> &Walker {
        &self.walker
    }

    /// The cameras, by name.
    pub fn cameras(&self) -> &[SimCamera] {
        &self.cameras
    }

    /// The IMUs, one in each camera.
    pub fn imus(&self) -> &[RigImu] {
        &self.imus
    }

    /// Nominal calibration of a camera, as recorded; equal to the ground truth unless an error was
    /// set.
    pub fn calibration(&self, camera: usize) -> StereoCalibration {
        calibration_of(&self.nominal[camera], self.imus[camera].imu.model())
    }

    /// Ground-truth calibration of a camera.
    pub fn true_calibration(&self, camera: usize) -> StereoCalibration {
        let is = nominal_cameras(&self.cameras, &self.imus).swap_remove(camera);
        calibration_of(&is, self.imus[camera].imu.model())
    }

    /// Nominal intrinsics of an eye, and the transform from its optical frame to the IMU frame.
    pub(crate) fn nominal_eye(&self, camera: usize, eye: usize) -> (&CameraModel, RigidTransform) {
        let nominal = &self.nominal[camera];
        (
            &nominal.models[eye],
            nominal.imu_from_rig * nominal.rig_from_eye[eye],
        )
    }

    /// All frames of a camera, in order.
    pub fn frames(self: &Arc<Self>, camera: usize) -> FrameRenderer {
        FrameRenderer::new(self, camera)
    }

    /// Ground truth of a camera's images.
    pub fn ground_truth(&self, camera: usize) -> GroundTruth<'_> {
        GroundTruth::new(self, camera)
    }

    /// A camera for images of the static scene from any pose; an even number of columns and rows.
    pub fn view_renderer(&self, model: &CameraModel, shutter: Shutter) -> ViewRenderer<'_> {
        ViewRenderer::new(self.scene(), self.imaging.sensor(0), model, shutter)
    }

    /// All samples of an IMU in order, each with its index and its time, ns.
    pub fn samples<'a>(
        &'a self,
        imu: &'a RigImu,
    ) -> impl Iterator<Item = (usize, i64, ImuSample)> + 'a {
        let rate_hz = imu.imu.model().rate_hz;
        let last = (self.settings.seconds * rate_hz + 1e-6).floor() as usize;
        (0..=last).map(move |n| {
            let time_ns = (n as f64 / rate_hz * 1e9).round() as i64;
            (
                n,
                time_ns,
                imu.imu
                    .sample(&self.walker, n, seconds(time_ns), &ImuFaults::NONE),
            )
        })
    }

    /// Pose of the rig in the world.
    pub fn world_from_rig(&self, time_ns: i64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let state = self.walker.rig(seconds(time_ns));
        (state.position, state.rotation)
    }

    /// The wearer's limbs, which move during the walk.
    fn limbs(&self) -> Vec<Limb<'_>> {
        let wearer = &self.scene().wearer;
        (wearer.parts.iter())
            .map(|(part, body)| Limb {
                body,
                part: *part,
                wearer,
                walker: &self.walker,
            })
            .collect()
    }

    /// All bodies to draw: the scene, then the wearer.
    fn placed<'a>(&'a self, limbs: &'a [Limb<'a>]) -> Vec<SceneBody<'a>> {
        let mut placed = placed(self.scene());
        for limb in limbs {
            let first = placed.last().map_or(0, SceneBody::next);
            placed.push(SceneBody {
                body: limb.body,
                first,
                pose: limb,
            });
        }
        placed
    }
}

/// A body part of the wearer with its motion.
struct Limb<'a> {
    body: &'a Body,
    part: Part,
    wearer: &'a Wearer,
    walker: &'a Walker,
}

impl Motion for Limb<'_> {
    fn at(&self, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        self.wearer.pose(self.part, self.walker, time_s)
    }
}

#[cfg(test)]
mod tests;
