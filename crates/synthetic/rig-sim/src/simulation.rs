//! A walk with the rig on, as its sensors record it, and what is true meanwhile.
//!
//! Contract: everything follows from [`Settings`] and the rig. A camera's pictures depend on its own
//! earlier ones, through the exposure, and on no other camera, so that cameras may be rendered side
//! by side on threads without any effect on the result. Times are whole ns since the beginning of
//! the walk: frame `n` is taken in the middle of the `n`-th period, by all cameras at one instant, and IMU
//! sample `n` at `n` over the rate. Clocks that run differently are added by whoever plays a device.

use std::sync::{Arc, OnceLock};

use cad_transforms::RigidTransform;
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::{Rig, RigError};
use calib::target::Target;
use calib::{CameraModel, ImuCalibration, ImuNoise, Provenance, StereoCalibration};
use nalgebra::{UnitQuaternion, Vector3};

use crate::calibration_error::{CalibrationError, true_rig_toml};
use crate::camera::placed::{Motion, Placed, placed};
use crate::camera::sensor::{SensorModel, Tone};
use crate::camera::{Quality, Shutter};
use crate::imu::{Imu, ImuFaults, ImuModel, ImuSample};
use crate::lens::Lens;
use crate::random;
use crate::rig::{SimCamera, cameras, shoe_tags};
use crate::scene::body::Body;
use crate::scene::tag;
use crate::scene::wearer::{Part, Wearer};
use crate::scene::{Kind, Lighting, Scene};
use crate::targets::board::{Board, Sheet};
use crate::targets::observations::TargetObservations;
use crate::targets::{self, Plan};
use crate::walker::Walker;

mod frame_renderer;
mod ground_truth;

pub use self::frame_renderer::{FrameRenderer, FrameSource, StereoFrame};
pub use self::ground_truth::{GroundTruth, TagObservation};

/// Seeds of IMUs, apart from the streams that they use themselves.
const IMU_SEEDS: u64 = random::IMU + 0x80;
/// Longest walk, s: the truth of a whole walk is kept in memory.
const MAX_LENGTH_S: f64 = 3600.0;
/// Fastest cameras, Hz: the rolling shutter reads a picture in less than this period.
const MAX_RATE_HZ: f64 = 100.0;
/// Sizes that the renderer can do, pixels per side of one eye.
const SIDE_RANGE_PX: std::ops::RangeInclusive<u32> = 16..=4096;
/// How much of a period light may be gathered: the rest is the device's.
const MAX_EXPOSURE_RATIO: f64 = 0.9;

/// What to simulate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Which place.
    pub kind: Kind,
    /// Which light.
    pub lighting: Lighting,
    /// All randomness comes from it.
    pub seed: u64,
    /// Length of the walk, s.
    pub seconds: f64,
    /// Frames per second of every camera.
    pub rate_hz: f64,
    /// Columns of one eye, even.
    pub width: u32,
    /// Rows, even.
    pub height: u32,
    /// How much trouble a picture is worth.
    pub quality: Quality,
}

/// Why nothing was simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// A setting that cannot be simulated: choose another.
    #[error("preparing a simulated walk: {what} is {found}, expected {expected}")]
    Setting {
        /// Which.
        what: &'static str,
        /// Its value.
        found: String,
        /// What is possible.
        expected: String,
    },
    /// A tag on a shoe that cannot be drawn: use one of the first of its family.
    #[error("preparing the wearer of a simulated rig: tag {id} is on a shoe, expected 0 to {last}")]
    Tag {
        /// Its number.
        id: u32,
        /// The last one that can be drawn.
        last: usize,
    },
    /// A calibration is of a camera that the rig does not have, or of pictures of another size.
    #[error("giving a simulated camera the lenses of a calibration: {0}")]
    Lenses(String),
    /// The rig lacks an eye or the IMU of a camera: complete its file.
    #[error("preparing the cameras of a simulated walk")]
    Rig(#[from] RigError),
}

/// An IMU on the rig.
#[derive(Clone, Debug)]
pub struct RigImu {
    /// What it measures.
    pub imu: Imu,
    /// Where it is.
    pub imu_from_rig: RigidTransform,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Simulation {
    settings: Settings,
    /// Made when it is first looked at, where the walk does not need it.
    scene: OnceLock<Scene>,
    walker: Walker,
    boards: Vec<Board>,
    plan: Option<Plan>,
    /// As they are.
    cameras: Vec<SimCamera>,
    /// Of each camera.
    imus: Vec<RigImu>,
    /// What files say of each camera.
    nominal: Vec<NominalCamera>,
    /// Whether a session is given files and records of lenses and places at all.
    has_calibration: bool,
    imaging: Imaging,
}

/// What files say of a camera.
#[derive(Clone, Debug, PartialEq)]
struct NominalCamera {
    models: [CameraModel; 2],
    rig_from_eye: [RigidTransform; 2],
    imu_from_rig: RigidTransform,
}

/// How sensors turn light into numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imaging {
    /// How long all pictures are exposed, s; none for an exposure that follows the light.
    pub exposure_s: Option<f64>,
    /// How much more noise there is than usual; 1 is as usual.
    pub noise: f64,
    /// From light to numbers.
    pub tone: Tone,
    /// Whether cameras that read their rows one after the other expose them all at once.
    pub global_shutter: bool,
}

impl Imaging {
    /// As cameras are.
    pub const USUAL: Self = Self {
        exposure_s: None,
        noise: 1.0,
        tone: Tone::Srgb,
        global_shutter: false,
    };

    fn sensor(&self) -> SensorModel {
        SensorModel {
            noise: self.noise as f32,
            tone: self.tone,
            ..SensorModel::SMALL
        }
    }
}

impl Settings {
    fn check(&self) -> Result<(), SimulationError> {
        let wrong = |what, found: &dyn std::fmt::Display, expected: String| {
            Err(SimulationError::Setting {
                what,
                found: found.to_string(),
                expected,
            })
        };
        // Not a number is in no range.
        if !(self.seconds > 0.0 && self.seconds <= MAX_LENGTH_S) {
            let expected = format!("above 0 and at most {MAX_LENGTH_S} s");
            return wrong("the length of the walk", &self.seconds, expected);
        }
        if !(self.rate_hz > 0.0 && self.rate_hz <= MAX_RATE_HZ) {
            let expected = format!("above 0 and at most {MAX_RATE_HZ} Hz");
            return wrong("the rate of the cameras", &self.rate_hz, expected);
        }
        for (what, size) in [
            ("the width of an eye", self.width),
            ("the height", self.height),
        ] {
            if !SIDE_RANGE_PX.contains(&size) || size % 2 == 1 {
                let expected = format!(
                    "an even number of pixels from {} to {}",
                    SIDE_RANGE_PX.start(),
                    SIDE_RANGE_PX.end()
                );
                return wrong(what, &size, expected);
            }
        }
        if self.frame_count() == 0 {
            let expected = format!("at least one period of {} s", 1.0 / self.rate_hz);
            return wrong("the length of the walk", &self.seconds, expected);
        }
        Ok(())
    }

    /// Frames of each camera: the whole periods of the walk.
    pub fn frame_count(&self) -> u64 {
        // A length of whole periods may be a hair less in floating point.
        (self.seconds * self.rate_hz + 1e-6).floor() as u64
    }

    /// When frame `n` is taken, ns.
    pub fn frame_ns(&self, n: u64) -> i64 {
        ((n as f64 + 0.5) / self.rate_hz * 1e9).round() as i64
    }
}

/// Nanoseconds as the seconds that motion is a function of.
pub fn seconds(time_ns: i64) -> f64 {
    time_ns as f64 * 1e-9
}

impl Plan {
    fn check(&self) -> Result<(), SimulationError> {
        let ranges = [
            ("the bend of the boards, m,", self.bow_m, 0.1),
            ("how much larger the boards are", self.scale_error, 0.2),
        ];
        // Not a number is in no range.
        let is_wrong = |(_, found, most): &&(_, f64, f64)| !(-*most..=*most).contains(found);
        match ranges.iter().find(is_wrong) {
            None => Ok(()),
            Some((what, found, most)) => Err(SimulationError::Setting {
                what,
                found: found.to_string(),
                expected: format!("{} to {most}", -most),
            }),
        }
    }
}

impl Simulation {
    /// Makes the place, the walk and the sensors; for [`Kind::Targets`] a session as it should be done.
    ///
    /// # Errors
    /// [`SimulationError`].
    pub fn new(settings: &Settings, rig: &Rig) -> Result<Self, SimulationError> {
        if settings.kind == Kind::Targets {
            let target = |number| Some(targets::april_grid(number));
            return Self::with_targets(settings, rig, &Plan::GOOD, &target);
        }
        let (cameras, imus) = sensors(settings, rig)?;
        let tags = shoe_tags(rig).map_err(|id| SimulationError::Tag {
            id,
            last: tag::COUNT - 1,
        })?;
        let scene = Scene::with_tags(settings.kind, settings.lighting, settings.seed, &tags);
        let walker = Walker::new(&scene, settings.seed, settings.seconds);
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
        })
    }

    /// Makes a room with boards, the first of which is `target(0)`, and the way on which the plate is carried
    /// before them. A camera for which there is none left looks at that of the camera beside it. [`Settings::kind`] must be [`Kind::Targets`]. The room itself is made when somebody looks at it:
    /// truth of corners and IMU samples need none.
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
            walker: Walker::carrying(spline, seconds),
            boards,
            plan: Some(*plan),
            cameras,
            imus,
            nominal,
            has_calibration: true,
            imaging: Imaging::USUAL,
        })
    }

    /// The same walk with the lenses of a calibration in a camera; where its eyes sit is the rig file's to say.
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

    /// The same recording with other lenses in a camera than its files say.
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

    /// The same recording of a rig that is as this one, while its files say what they did. The rig has the same cameras.
    /// Call it after [`Simulation::with_imus`].
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

    /// The same recording of a rig that deviates from what its files say, of which `rig` was made. Call it last.
    ///
    /// # Errors
    /// [`SimulationError::Rig`].
    pub fn with_calibration_error(
        mut self,
        rig: &Rig,
        calibration_error: &CalibrationError,
    ) -> Result<Self, SimulationError> {
        let moved: Vec<_> = calibration_error
            .cameras
            .iter()
            .filter(|c| !c.has_nominal_extrinsics())
            .collect();
        if !moved.is_empty() {
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

    /// Whether anything is not as files say.
    pub fn differs_from_calibration(&self) -> bool {
        self.nominal != nominal_cameras(&self.cameras, &self.imus)
            || self.cameras.iter().any(|c| c.time_offset_ns != 0)
    }

    /// The text of a rig file of the rig as it is; `nominal` is the one that the recording knows.
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

    /// The same recording through sensors that are so.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for an exposure that is no time or longer than a period, or for noise below 0.
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
        if !(0.0..=100.0).contains(&imaging.noise) {
            return Err(SimulationError::Setting {
                what: "the noise",
                found: imaging.noise.to_string(),
                expected: "0 to 100 times the usual".to_owned(),
            });
        }
        if imaging.global_shutter {
            let cameras = self.cameras.iter_mut();
            cameras.for_each(|camera| camera.shutter = Shutter::Global);
        }
        self.imaging = imaging;
        Ok(self)
    }

    /// Where a calibration finds its camera, and its lenses.
    fn lenses(
        &self,
        camera: &str,
        calibration: &StereoCalibration,
    ) -> Result<(usize, [CameraModel; 2]), SimulationError> {
        let wanted = (self.settings.width, self.settings.height);
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
            if (model.width, model.height) != wanted {
                return Err(SimulationError::Lenses(format!(
                    "the calibration of {camera} is for {}x{}, expected {}x{}",
                    model.width, model.height, wanted.0, wanted.1
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

    /// The same recording of a rig that was never calibrated: its session has neither a rig file nor lenses.
    #[must_use]
    pub fn without_calibration(mut self) -> Self {
        self.has_calibration = false;
        self
    }

    /// Whether a session of it has a rig file and lenses.
    pub fn has_calibration(&self) -> bool {
        self.has_calibration
    }

    /// The same walk in pictures of another quality.
    #[must_use]
    pub fn with_quality(mut self, quality: Quality) -> Self {
        self.settings.quality = quality;
        self
    }

    /// What was asked for.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The place.
    pub fn scene(&self) -> &Scene {
        let Settings { lighting, seed, .. } = self.settings;
        let new = || Scene::with_boards(lighting, seed, &self.boards);
        self.scene.get_or_init(new)
    }

    /// The calibration boards; none on a walk.
    pub fn boards(&self) -> &[Board] {
        &self.boards
    }

    /// How the boards are shown; none on a walk.
    pub fn plan(&self) -> Option<&Plan> {
        self.plan.as_ref()
    }

    /// How sensors turn light into numbers.
    pub fn imaging(&self) -> &Imaging {
        &self.imaging
    }

    /// Where corners of boards are in a camera's pictures, without a picture.
    pub fn target_observations(&self, camera: usize) -> TargetObservations<'_> {
        TargetObservations::new(self, camera)
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

    /// What files say of a camera: the truth, unless the rig deviates from it.
    pub fn calibration(&self, camera: usize) -> StereoCalibration {
        calibration_of(&self.nominal[camera], self.imus[camera].imu.model())
    }

    /// What a calibration of a camera that finds everything exactly says of it.
    pub fn true_calibration(&self, camera: usize) -> StereoCalibration {
        let is = nominal_cameras(&self.cameras, &self.imus).swap_remove(camera);
        calibration_of(&is, self.imus[camera].imu.model())
    }

    /// What files say of an eye: its lens, and what takes its optical frame to the IMU's.
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

    /// What a camera's eyes really see.
    pub fn ground_truth(&self, camera: usize) -> GroundTruth<'_> {
        GroundTruth::new(self, camera)
    }

    /// All samples of an IMU in order, each with its number and its time in ns.
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

    /// The wearer's limbs, which move with the walk.
    fn limbs(&self) -> Vec<Limb<'_>> {
        let parts = self.scene().wearer.parts.iter();
        parts
            .map(|(part, body)| Limb {
                body,
                part: *part,
                walker: &self.walker,
            })
            .collect()
    }

    /// Everything that can be seen: the scene, then the wearer.
    fn placed<'a>(&'a self, limbs: &'a [Limb<'a>]) -> Vec<Placed<'a>> {
        let mut placed = placed(self.scene());
        for limb in limbs {
            let first = placed.last().map_or(0, Placed::next);
            placed.push(Placed {
                body: limb.body,
                first,
                pose: limb,
            });
        }
        placed
    }
}

/// Cameras and IMUs of a rig, once settings are known to be possible.
fn sensors(
    settings: &Settings,
    rig: &Rig,
) -> Result<(Vec<SimCamera>, Vec<RigImu>), SimulationError> {
    settings.check()?;
    let mut cameras = cameras(rig, settings.width, settings.height)?;
    for camera in &mut cameras {
        let period_s = 1.0 / settings.rate_hz;
        camera.max_exposure_s = camera.max_exposure_s.min(MAX_EXPOSURE_RATIO * period_s);
    }
    let imus = imus(ImuModel::ZED_MINI, &cameras, settings, rig)?;
    Ok((cameras, imus))
}

/// What files say that say the truth.
fn nominal_cameras(cameras: &[SimCamera], imus: &[RigImu]) -> Vec<NominalCamera> {
    let of = |(camera, imu): (&SimCamera, &RigImu)| NominalCamera {
        models: camera.models,
        rig_from_eye: camera.rig_from_eye,
        imu_from_rig: imu.imu_from_rig,
    };
    cameras.iter().zip(imus).map(of).collect()
}

fn calibration_of(nominal: &NominalCamera, model: &ImuModel) -> StereoCalibration {
    let [left, right] = nominal.rig_from_eye;
    StereoCalibration {
        left: nominal.models[0],
        right: nominal.models[1],
        right_from_left: right.inverse() * left,
        imu: Some(ImuCalibration {
            imu_from_left: nominal.imu_from_rig * left,
            rate_hz: model.rate_hz,
            noise: Some(ImuNoise {
                gyro_noise_density: model.noise_density[0],
                gyro_random_walk: model.random_walk[0],
                accel_noise_density: model.noise_density[1],
                accel_random_walk: model.random_walk[1],
            }),
        }),
        provenance: Provenance {
            format: None,
            files: Vec::new(),
            part: None,
        },
    }
}

/// The IMUs of cameras, each with errors of its own.
fn imus(
    model: ImuModel,
    cameras: &[SimCamera],
    settings: &Settings,
    rig: &Rig,
) -> Result<Vec<RigImu>, RigError> {
    let imu = |(camera, number): (&SimCamera, u64)| {
        let frame = Frame::of_camera(&camera.name, FramePart::Imu)
            .expect("a rig names its cameras by valid names");
        let imu_from_rig = rig.transform(&frame, &Frame::rig())?;
        let seed = random::bits(settings.seed, IMU_SEEDS, number);
        let imu = Imu::new(model, imu_from_rig, settings.seconds, seed);
        Ok(RigImu { imu, imu_from_rig })
    };
    cameras.iter().zip(0..).map(imu).collect()
}

/// A part of the wearer on his walk.
struct Limb<'a> {
    body: &'a Body,
    part: Part,
    walker: &'a Walker,
}

impl Motion for Limb<'_> {
    fn at(&self, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        Wearer::pose(self.part, self.walker, time_s)
    }
}

#[cfg(test)]
mod tests;
