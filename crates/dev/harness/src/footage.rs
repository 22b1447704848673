//! One camera of a simulated walk as recorded by other tools: test input for replay sources.
//!
//! This code is independent of the daemon and its readers: bags are written by the `mcap` crate and
//! an encoding of their messages after the layouts of `sensor_msgs`, video files by GStreamer's own
//! muxers.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use cad_transforms::rig::Rig;
use calibration_files::Format;
use camera_models::CameraSet;
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation, StereoFrame};
use video::raw_image::i420_to_rgb;
use video::{PixelFormat, RawImage};

pub mod bag;
pub mod film;

/// Rig file of the camera.
pub const RIG: &str = include_str!("../../../../cad-transforms/rigs/example.toml");
/// The camera.
pub const CAMERA: &str = "left_shoulder";

/// A camera's images and the samples of its IMU.
pub struct Footage {
    /// The walk.
    pub simulation: Arc<Simulation>,
    /// Its frames, both eyes side by side.
    pub frames: Vec<StereoFrame>,
    /// Time since the beginning of the walk in ns, angular rate in rad/s, specific force in m/s².
    pub samples: Vec<(i64, [f64; 3], [f64; 3])>,
}

impl Footage {
    /// Four seconds over a plaza at 15 Hz, 480x268 per eye.
    ///
    /// # Errors
    /// The walk cannot be prepared.
    pub fn walk() -> Result<Self> {
        let rig = Rig::parse(RIG).context("reading the example rig")?;
        let settings = Settings {
            kind: Kind::Plaza,
            lighting: Lighting::Day,
            seed: 3,
            seconds: 4.0,
            rate_hz: 15.0,
            width: 480,
            height: 268,
            quality: Quality::FAST,
        };
        let simulation = Simulation::new(&settings, &rig).context("preparing the walk")?;
        let simulation = Arc::new(simulation);
        let cameras = simulation.cameras();
        let camera = cameras.iter().position(|c| c.name == CAMERA);
        let camera = camera.context("the rig has no such camera")?;
        let frames = simulation.frames(camera).collect();
        let imu = &simulation.imus()[camera];
        let samples = simulation
            .samples(imu)
            .map(|(_, time, sample)| (time, sample.gyro.into(), sample.accel.into()));
        let samples = samples.collect();
        Ok(Self {
            frames,
            samples,
            simulation,
        })
    }

    /// The first frames only.
    #[must_use]
    pub fn first(&self, frames: usize) -> Self {
        let end = self
            .frames
            .get(frames)
            .map_or(i64::MAX, |frame| frame.time_ns);
        let samples = self.samples.iter().filter(|(time, ..)| *time < end);
        Self {
            simulation: self.simulation.clone(),
            frames: self.frames[..frames].to_vec(),
            samples: samples.copied().collect(),
        }
    }

    /// Columns and rows of one eye.
    pub fn eye(&self) -> [u32; 2] {
        let settings = self.simulation.settings();
        [settings.width, settings.height]
    }

    /// A frame as an image, both eyes side by side.
    ///
    /// # Errors
    /// The frame is not a valid image.
    pub fn image(&self, frame: usize) -> Result<RawImage> {
        let of = &self.frames[frame];
        let (width, height) = (of.width as u32, of.height as u32);
        Ok(RawImage::new(
            width,
            height,
            PixelFormat::I420,
            of.i420.clone(),
        )?)
    }

    /// One eye of a frame as RGB, rows packed.
    ///
    /// # Errors
    /// The frame is not a valid image.
    pub fn rgb(&self, frame: usize, eye: usize) -> Result<Vec<u8>> {
        let both = self.image(frame)?;
        let rgb = i420_to_rgb(&both)?;
        let row = 3 * both.width as usize;
        let rows = rgb.chunks_exact(row).map(|row| row.split_at(row.len() / 2));
        let rows = rows.flat_map(|(left, right)| [left, right][eye]);
        Ok(rows.copied().collect())
    }

    /// One eye of a frame as I420.
    ///
    /// # Errors
    /// The frame is not a valid image.
    pub fn one_eye(&self, frame: usize, eye: usize) -> Result<RawImage> {
        let (left, right) = video::raw_image::split(&self.image(frame)?)?;
        Ok([left, right][eye].clone())
    }

    /// Writes the camera's true intrinsics as a Kalibr file.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn write_calibration(&self, path: &Path) -> Result<()> {
        let cameras = self.simulation.cameras();
        let camera = cameras.iter().position(|c| c.name == CAMERA).unwrap_or(0);
        let set = CameraSet::of_stereo(&self.simulation.calibration(camera));
        calibration_files::write_cameras(&set, Format::Kalibr, path)?;
        Ok(())
    }

    /// True distance between the rig positions at frames `from` and `to`, m.
    pub fn distance_m(&self, from: usize, to: usize) -> f64 {
        let place = |frame: usize| self.simulation.world_from_rig(self.frames[frame].time_ns).0;
        (place(to) - place(from)).norm()
    }
}
