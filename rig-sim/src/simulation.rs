//! A walk with the rig on, as its sensors record it, and what is true meanwhile.
//!
//! Contract: everything follows from [`Settings`] and the rig. A camera's pictures depend on its own
//! earlier ones, through the exposure, and on no other camera, so that cameras may be rendered side
//! by side on threads without any effect on the result. Times are whole ns since the beginning of
//! the walk: frame `n` is taken in the middle of the `n`-th period, by all cameras at one instant, and IMU
//! sample `n` at `n` over the rate. Clocks that run differently are added by whoever plays a device.

use std::sync::Arc;

use cad_transforms::RigidTransform;
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::{Rig, RigError};
use calib::{ImuCalibration, ImuNoise, Provenance, StereoCalibration};
use nalgebra::{UnitQuaternion, Vector3};

use crate::camera::Quality;
use crate::camera::placed::{Motion, Placed, placed};
use crate::imu::{Imu, ImuModel, ImuSample, ImuTrouble};
use crate::lens::Lens;
use crate::random;
use crate::rig::{SimCamera, cameras, shoe_tags};
use crate::scene::body::Body;
use crate::scene::tag;
use crate::scene::wearer::{Part, Wearer};
use crate::scene::{Kind, Scene, Time};
use crate::walker::Walker;

mod pictures;
mod truths;

pub use self::pictures::{Painter, Pictures, StereoFrame};
pub use self::truths::{SeenTag, Truths};

/// Seeds of IMUs, apart from the streams that they use themselves.
const IMU_SEEDS: u64 = random::IMU + 0x80;
/// Longest walk, s: the truth of a whole walk is kept in memory.
const LONGEST_S: f64 = 3600.0;
/// Fastest cameras, Hz: the rolling shutter reads a picture in less than this period.
const FASTEST_HZ: f64 = 100.0;
/// Sizes that the renderer can do, pixels per side of one eye.
const SIZES: std::ops::RangeInclusive<u32> = 16..=4096;
/// How much of a period light may be gathered: the rest is the device's.
const SHUTTER_SHARE: f64 = 0.9;

/// What to simulate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Which place.
    pub kind: Kind,
    /// Which light.
    pub time: Time,
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
    scene: Scene,
    walker: Walker,
    cameras: Vec<SimCamera>,
    /// Of each camera.
    imus: Vec<RigImu>,
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
        if !(self.seconds > 0.0 && self.seconds <= LONGEST_S) {
            let expected = format!("above 0 and at most {LONGEST_S} s");
            return wrong("the length of the walk", &self.seconds, expected);
        }
        if !(self.rate_hz > 0.0 && self.rate_hz <= FASTEST_HZ) {
            let expected = format!("above 0 and at most {FASTEST_HZ} Hz");
            return wrong("the rate of the cameras", &self.rate_hz, expected);
        }
        for (what, size) in [
            ("the width of an eye", self.width),
            ("the height", self.height),
        ] {
            if !SIZES.contains(&size) || size % 2 == 1 {
                let expected = format!(
                    "an even number of pixels from {} to {}",
                    SIZES.start(),
                    SIZES.end()
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

impl Simulation {
    /// Makes the place, the walk and the sensors.
    ///
    /// # Errors
    /// [`SimulationError`].
    pub fn new(settings: &Settings, rig: &Rig) -> Result<Self, SimulationError> {
        settings.check()?;
        let mut cameras = cameras(rig, settings.width, settings.height)?;
        for camera in &mut cameras {
            let period_s = 1.0 / settings.rate_hz;
            camera.longest_exposure_s = camera.longest_exposure_s.min(SHUTTER_SHARE * period_s);
        }
        let imus = imus(ImuModel::ZED_MINI, &cameras, settings, rig)?;
        let tags = shoe_tags(rig).map_err(|id| SimulationError::Tag {
            id,
            last: tag::COUNT - 1,
        })?;
        let scene = Scene::with_tags(settings.kind, settings.time, settings.seed, &tags);
        let walker = Walker::new(&scene, settings.seed, settings.seconds);
        Ok(Self {
            settings: *settings,
            scene,
            walker,
            cameras,
            imus,
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
        let wanted = (self.settings.width, self.settings.height);
        let Some(of) = self.cameras.iter_mut().find(|c| c.name == camera) else {
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
        of.models = models;
        Ok(self)
    }

    /// The same walk with other IMUs in the cameras.
    ///
    /// # Errors
    /// [`SimulationError::Rig`].
    pub fn with_imus(mut self, model: ImuModel, rig: &Rig) -> Result<Self, SimulationError> {
        self.imus = imus(model, &self.cameras, &self.settings, rig)?;
        Ok(self)
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
        &self.scene
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

    /// What a calibration of a camera that finds everything exactly says of it.
    pub fn calibration(&self, camera: usize) -> StereoCalibration {
        let (of, imu) = (&self.cameras[camera], &self.imus[camera]);
        let [left, right] = of.rig_from_eye;
        let model = imu.imu.model();
        StereoCalibration {
            left: of.models[0],
            right: of.models[1],
            right_from_left: right.inverse() * left,
            imu: Some(ImuCalibration {
                imu_from_left: imu.imu_from_rig * left,
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

    /// All frames of a camera, in order.
    pub fn pictures(self: &Arc<Self>, camera: usize) -> Pictures {
        Pictures::new(self, camera)
    }

    /// What a camera's eyes really see.
    pub fn truths(&self, camera: usize) -> Truths<'_> {
        Truths::new(self, camera)
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
                    .sample(&self.walker, n, seconds(time_ns), &ImuTrouble::NONE),
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
        let parts = self.scene.wearer.parts.iter();
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
        let mut placed = placed(&self.scene);
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
