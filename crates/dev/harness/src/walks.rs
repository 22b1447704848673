//! Simulated walks as input of the verification of a calibration.
//!
//! Only the bursts of a walk are rendered, and features are tracked once: nominal values with
//! errors that are applied afterwards ([`NominalError`]) need no new images. An error of the
//! nominal calibration is equivalent to a change of the rig.

use std::sync::Arc;
use std::thread;

use anyhow::{Context as _, Result};
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::Rig;
use cad_transforms::transform::RigidTransform;
use calib::verify::{
    Burst, BurstConfig, Camera, CameraEstimate, Config, FeatureTracker, Gyro, StereoFrame,
    Tolerances, Verification, choose_bursts, compare, judge,
};
use camera_models::StereoCalibration;
use imaging::ImageView;
use rig_sim::camera::{Quality, Shutter};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};
use serde::{Deserialize, Serialize};

const RIG: &str = include_str!("../../../../cad-transforms/rigs/example.toml");
/// Number of discarded frames before each burst, for the exposure to converge.
const SETTLING_FRAMES: u64 = 4;
const SIZE: (u32, u32) = (672, 376);

/// Plan of a walk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Length of the walk, s.
    pub seconds: f64,
    /// Frames per second.
    pub rate_hz: f64,
    /// Number of bursts, and the length of each, s.
    pub bursts: (usize, f64),
    /// Rendering quality.
    pub quality: Quality,
}

impl Plan {
    /// One minute, at the quality for recording in real time.
    pub const MINUTE: Self = Self {
        seconds: 60.0,
        rate_hz: 15.0,
        bursts: (8, 1.05),
        quality: Quality::FAST,
    };
}

/// A walk.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Walk {
    cameras: Vec<NominalCamera>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct NominalCamera {
    name: String,
    calibration: StereoCalibration,
    rig_from_left: RigidTransform,
    line_s: f64,
    bursts: Vec<Burst>,
    /// Times in ns and rates in counts.
    gyro: Vec<(i64, [i16; 3])>,
    count: f64,
}

/// Error of the nominal calibration of a camera, given by its index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NominalError {
    /// No error.
    None,
    /// The camera has rotated on the rig, by a rotation vector in its left optical frame, rad.
    CameraRotation(usize, [f64; 3]),
    /// The right eye has rotated, by a rotation vector in the right optical frame, rad.
    StereoRotation(usize, [f64; 3]),
    /// Image timestamps are late, s.
    ImageTime(usize, f64),
    /// IMU timestamps are late, s.
    ImuTime(usize, f64),
    /// Image and IMU timestamps are late, s.
    Clock(usize, f64),
}

impl Walk {
    /// Simulates a walk and tracks features.
    ///
    /// # Errors
    /// The walk cannot be prepared.
    pub fn make(kind: Kind, light: Lighting, seed: u64, plan: &Plan) -> Result<Self> {
        let rig = Rig::parse(RIG).context("reading the example rig")?;
        let settings = Settings {
            kind,
            lighting: light,
            seed,
            seconds: plan.seconds,
            rate_hz: plan.rate_hz,
            width: SIZE.0,
            height: SIZE.1,
            quality: plan.quality,
        };
        let simulation = Simulation::new(&settings, &rig).context("preparing the walk")?;
        let simulation = Arc::new(simulation);
        let mut cameras = Vec::new();
        for (k, (camera, imu)) in (simulation.cameras().iter())
            .zip(simulation.imus())
            .enumerate()
        {
            let left = Frame::of_camera(&camera.name, FramePart::Left)?;
            let samples = simulation.samples(imu);
            cameras.push(NominalCamera {
                name: camera.name.clone(),
                calibration: simulation.calibration(k),
                rig_from_left: rig.transform(&Frame::rig(), &left)?,
                line_s: match camera.shutter {
                    Shutter::Global => 0.0,
                    Shutter::Rolling { line_s } => line_s,
                },
                bursts: Vec::new(),
                gyro: samples
                    .map(|(_, time, sample)| (time, imu.imu.counts(&sample)[0]))
                    .collect(),
                count: imu.imu.model().count[0],
            });
        }
        let gyros: Vec<Gyro> = cameras.iter().map(|c| c.gyro(0.0)).collect();
        let refs: Vec<&Gyro> = gyros.iter().collect();
        let (count, length_s) = plan.bursts;
        let span = [0, (plan.seconds * 1e9) as i64];
        let times = choose_bursts(
            &refs,
            span,
            count,
            (length_s * 1e9) as i64,
            &BurstConfig::default(),
        );
        let track_bursts =
            |k: usize| track_bursts(&simulation, k, &cameras[k].calibration, &gyros[k], &times);
        let bursts: Vec<Vec<Burst>> = thread::scope(|scope| {
            let track_bursts = &track_bursts;
            let running: Vec<_> = (0..cameras.len())
                .map(|k| scope.spawn(move || track_bursts(k)))
                .collect();
            running
                .into_iter()
                .map(|thread| thread.join().expect("feature tracking does not panic"))
                .collect()
        });
        for (camera, bursts) in cameras.iter_mut().zip(bursts) {
            camera.bursts = bursts;
        }
        Ok(Self { cameras })
    }

    /// Names of the cameras.
    pub fn names(&self) -> Vec<&str> {
        self.cameras.iter().map(|c| c.name.as_str()).collect()
    }

    /// The same with every `every`-th burst only.
    #[must_use]
    pub fn thinned(&self, every: usize) -> Self {
        let mut thin = self.clone();
        for camera in &mut thin.cameras {
            camera.bursts = camera.bursts.iter().step_by(every).cloned().collect();
        }
        thin
    }

    /// Estimates of the cameras without nominal errors.
    pub fn compare(&self) -> Vec<CameraEstimate> {
        self.with(&NominalError::None, |cameras| {
            cameras
                .iter()
                .map(|camera| compare(camera, &Config::default()))
                .collect()
        })
    }

    /// Verification with an error of the nominal calibration. `reference` is the result of
    /// [`Walk::compare`]; its unaffected parts are reused.
    pub fn verify(&self, error: &NominalError, reference: &[CameraEstimate]) -> Verification {
        self.with(error, |cameras| {
            let mut found = reference.to_vec();
            if let NominalError::StereoRotation(k, _)
            | NominalError::ImageTime(k, _)
            | NominalError::ImuTime(k, _) = *error
            {
                found[k] = compare(&cameras[k], &Config::default());
            }
            judge(cameras, found, &Tolerances::default(), &Config::default())
        })
    }

    fn with<T>(&self, error: &NominalError, run: impl FnOnce(&[Camera<'_>]) -> T) -> T {
        let mut nominal = self.cameras.clone();
        let turn = |rad: [f64; 3]| {
            let turn = RigidTransform::from_rotation_vector(rad, [0.0; 3]);
            turn.expect("a finite rotation is a transform").inverse()
        };
        let mut imu_delay_s = vec![0.0; nominal.len()];
        match *error {
            NominalError::None => {}
            NominalError::CameraRotation(k, rad) => {
                nominal[k].rig_from_left = nominal[k].rig_from_left * turn(rad);
            }
            NominalError::StereoRotation(k, rad) => {
                let calibration = &mut nominal[k].calibration;
                calibration.right_from_left = turn(rad) * calibration.right_from_left;
            }
            NominalError::ImageTime(k, s) => nominal[k].delay_images(s),
            NominalError::ImuTime(k, s) => imu_delay_s[k] = s,
            NominalError::Clock(k, s) => {
                nominal[k].delay_images(s);
                imu_delay_s[k] = s;
            }
        }
        let gyros: Vec<Gyro> = (nominal.iter().zip(&imu_delay_s))
            .map(|(c, s)| c.gyro(*s))
            .collect();
        let mut cameras = Vec::new();
        for (nominal, gyro) in nominal.iter().zip(&gyros) {
            cameras.push(Camera {
                name: &nominal.name,
                nominal: &nominal.calibration,
                rig_from_left: Some(nominal.rig_from_left),
                joint_sigma_rad: None,
                // Not contained in sessions.
                line_s: None,
                bursts: &nominal.bursts,
                gyro: Some(gyro),
            });
        }
        run(&cameras)
    }
}

impl NominalCamera {
    fn gyro(&self, imu_delay_s: f64) -> Gyro {
        let rate = |c: i16| f64::from(c) * self.count;
        let gyro = Gyro::new(self.gyro.iter().map(|(time, c)| (*time, c.map(rate))));
        gyro.shifted_by_ns((imu_delay_s * 1e9) as i64)
    }

    fn delay_images(&mut self, imu_delay_s: f64) {
        let late_ns = (imu_delay_s * 1e9) as i64;
        for of in self.bursts.iter_mut().flat_map(|b| &mut b.segments) {
            of.from_ns += late_ns;
            of.to_ns += late_ns;
        }
    }
}

/// Renders the bursts of a camera and tracks features through them.
fn track_bursts(
    simulation: &Arc<Simulation>,
    camera: usize,
    calibration: &StereoCalibration,
    gyro: &Gyro,
    times: &[[i64; 2]],
) -> Vec<Burst> {
    let settings = simulation.settings();
    let count = settings.frame_count();
    let mut follower = FeatureTracker::new(calibration, Some(gyro), &Config::default());
    let mut renderer = simulation.frames(camera);
    let mut burst = |[from, to]: &[i64; 2]| {
        let first = (0..count).find(|n| settings.frame_ns(*n) >= *from);
        let first = first.unwrap_or(count);
        for n in first.saturating_sub(SETTLING_FRAMES)..first {
            renderer.expose(n, settings.frame_ns(n));
        }
        for n in (first..count).take_while(|n| settings.frame_ns(*n) <= *to) {
            let frame = renderer.expose(n, settings.frame_ns(n));
            let (left, right) = (frame.gray(0), frame.gray(1));
            let (width, height) = (frame.width / 2, frame.height);
            let eye =
                |pixels| ImageView::new(width, height, width, pixels).expect("a complete image");
            follower.push(&StereoFrame {
                time_ns: frame.time_ns,
                left: eye(&left),
                right: eye(&right),
            });
        }
        follower.end()
    };
    times.iter().map(&mut burst).collect()
}
