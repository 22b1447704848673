//! Simulated walks as sequences.
//!
//! Faults are applied by [`rig_sim::device`], as in the recorder's simulated source: frames and
//! samples are dropped, repeated, torn and late. Corrections of the recorder are taken as given:
//! times are the true ones of the device's samples (its clocks are mapped without error, whatever
//! they show), and duplicated frames are removed. A frame that arrives later than [`HORIZON_NS`] is
//! in no set, as in the recorder.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::thread;

use anyhow::{Context as _, Result, ensure};
use cad_transforms::RigidTransform;
use cad_transforms::frame::{Frame, FramePart};
use nalgebra::{Matrix6, Vector6};
use odometry::ImuSample;
use odometry::rig::{Imu, Rig, StereoCamera};
use rig_sim::calibration_error::CalibrationError;
use rig_sim::camera::sensor::Exposure;
use rig_sim::camera::{Quality, Shutter};
use rig_sim::device::{Delivery, Device, DeviceFrame};
use rig_sim::faults::Faults;
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{FrameSource, Imaging, Settings, Simulation, StereoFrame};

use super::prerendered::PrerenderedFrames;
use super::{ImageSource, OwnedFrameSet, PlannedSet, Reader, Sequence, Truth};

/// Default rig of walks.
const EXAMPLE_RIG: &str = include_str!("../../../../../cad-transforms/rigs/example.toml");
/// Time for which the recorder waits for a camera (`capture-daemon/src/sync/sets.rs`), ns.
const HORIZON_NS: i64 = capture_daemon::sync::sets::HORIZON_NS;
/// Maximum number of queued rendered images per camera.
const MAX_QUEUED_IMAGES: usize = 3;

/// Settings of a walk, with faults.
#[derive(Clone, Debug)]
pub struct WalkSettings {
    /// Scene.
    pub kind: Kind,
    /// Lighting.
    pub light: Lighting,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Length, s.
    pub seconds: f64,
    /// Frames per second.
    pub rate_hz: f64,
    /// Columns and rows of one eye.
    pub size: [u32; 2],
    /// Rendering quality.
    pub quality: Quality,
    /// Sensor response.
    pub imaging: Imaging,
    /// Faults.
    pub faults: Faults,
    /// Errors of the nominal rig.
    pub calibration_error: CalibrationError,
    /// Names of the cameras in use, in this order; empty for all. Rendering does not depend on it.
    pub cameras: Vec<String>,
    /// Whether these cameras' IMUs are used.
    pub with_imu: bool,
    /// Text of the rig file.
    pub rig: String,
}

impl WalkSettings {
    /// A walk of the example rig without faults and with all sensor effects: quality for
    /// evaluation, 15 Hz, 672x376.
    pub fn new(kind: Kind, light: Lighting, seed: u64, seconds: f64) -> Self {
        Self {
            kind,
            light,
            seed,
            seconds,
            rate_hz: 15.0,
            size: [672, 376],
            quality: Quality::ACCURATE,
            imaging: Imaging::USUAL,
            faults: Faults::default(),
            calibration_error: CalibrationError::default(),
            cameras: Vec::new(),
            with_imu: true,
            rig: EXAMPLE_RIG.to_owned(),
        }
    }

    fn settings(&self) -> Settings {
        Settings {
            kind: self.kind,
            lighting: self.light,
            seed: self.seed,
            seconds: self.seconds,
            rate_hz: self.rate_hz,
            width: self.size[0],
            height: self.size[1],
            quality: self.quality,
        }
    }

    /// All inputs of an image, as text.
    fn key(&self) -> String {
        format!(
            "{:?}\n{:?}\n{:?}\n{:?}\n{}",
            self.settings(),
            self.imaging,
            self.faults,
            self.calibration_error,
            self.rig
        )
    }
}

/// A walk that can be rendered.
#[derive(Clone, Debug)]
pub(super) struct Walk {
    pub(super) simulation: Arc<Simulation>,
    pub(super) key: String,
    faults: Faults,
    pub(super) cameras: Vec<WalkCamera>,
    /// Existing images.
    pub(super) prerendered: Option<Arc<Vec<OwnedFrameSet>>>,
}

/// One camera of a walk.
#[derive(Clone, Debug)]
pub(super) struct WalkCamera {
    pub(super) name: String,
    /// Index in the simulation.
    position: usize,
    /// Index in the sequence.
    number: usize,
}

/// Covariance that a calibration of the stereo cameras states: a tenth of a millimetre and 0.02
/// degrees, as `paws calib cameras` does for a good recording of a target.
fn stereo_covariance() -> Matrix6<f64> {
    let variances = [1e-4, 3e-4].map(|sigma: f64| sigma * sigma);
    Matrix6::from_diagonal(&Vector6::from_fn(|k, _| variances[k / 3]))
}

/// A simulated walk.
///
/// # Errors
/// Settings that cannot be simulated.
pub fn walk(settings: &WalkSettings) -> Result<Sequence> {
    let rig = cad_transforms::rig::Rig::parse(&settings.rig)?;
    let wearer = settings.faults.of_wearer();
    let simulation = Simulation::with_wearer_faults(&settings.settings(), &rig, &wearer)?
        .with_imaging(settings.imaging)?
        .with_calibration_error(&rig, &settings.calibration_error)?;
    let simulation = Arc::new(simulation);
    let all: Vec<&str> = simulation
        .cameras()
        .iter()
        .map(|c| c.name.as_str())
        .collect();
    let used: Vec<&str> = match settings.cameras.is_empty() {
        true => all.clone(),
        false => settings.cameras.iter().map(String::as_str).collect(),
    };
    let frames = simulation.settings().frame_count() as usize;
    let mut sets: Vec<PlannedSet> = (0..frames as u64)
        .map(|n| PlannedSet {
            time_ns: simulation.settings().frame_ns(n),
            views: vec![None; used.len()],
        })
        .collect();
    let (mut cameras, mut imu, mut seen) = (Vec::new(), Vec::new(), Vec::new());
    let mut nominal = Rig {
        cameras: Vec::new(),
        imus: Vec::new(),
    };
    for (number, name) in used.iter().enumerate() {
        let position = all.iter().position(|other| other == name);
        let position = position.with_context(|| {
            let known = all.join(", ");
            format!("choosing cameras of a walk: found {name:?}, expected one of {known}")
        })?;
        ensure!(!seen.contains(name), "camera {name} is chosen twice");
        seen.push(*name);
        let calibration = simulation.calibration(position);
        let part = |part| -> Result<RigidTransform> {
            Ok(rig.transform(&Frame::rig(), &Frame::of_camera(name, part)?)?)
        };
        nominal.cameras.push(StereoCamera {
            name: (*name).to_owned(),
            left: calibration.left,
            right: calibration.right,
            rig_from_left: part(FramePart::Left)?,
            covariance: None,
            right_from_left: calibration.right_from_left,
            right_from_left_covariance: Some(stereo_covariance()),
            line_s: match simulation.cameras()[position].shutter {
                Shutter::Global => 0.0,
                Shutter::Rolling { line_s } => line_s,
            },
        });
        let (taken, samples) = dry_run(&simulation, position, &settings.faults);
        for index in &taken {
            let planned = &mut sets[*index as usize];
            planned.views[number] = Some(planned.time_ns);
        }
        cameras.push(WalkCamera {
            name: (*name).to_owned(),
            position,
            number,
        });
        if settings.with_imu {
            let model = simulation.imus()[position].imu.model();
            let noise = calibration.imu.and_then(|imu| imu.noise);
            nominal.imus.push(Imu {
                name: Frame::of_camera(name, FramePart::Imu)?.as_str().to_owned(),
                rig_from_imu: part(FramePart::Imu)?,
                noise: noise.context("a simulated calibration has the IMU's noise")?,
                rate_hz: model.rate_hz,
                range: model.range,
            });
            imu.push(samples);
        }
    }
    let name = format!(
        "{}, {}, seed {}",
        settings.kind.name(),
        settings.light.name(),
        settings.seed
    );
    Ok(Sequence {
        name,
        rig: nominal,
        imu,
        truth: Truth::Walk(simulation.clone()),
        sets,
        images: ImageSource::Rendered(Walk {
            simulation,
            key: settings.key(),
            faults: settings.faults.clone(),
            cameras,
            prerendered: None,
        }),
    })
}

/// Renders nothing: the deliveries of a device and their times do not depend on image content.
struct Blank;

impl FrameSource for Blank {
    fn render_frame(&mut self, number: u64, time_ns: i64) -> StereoFrame {
        StereoFrame {
            number,
            time_ns,
            exposure: Exposure {
                seconds: 0.0,
                gain: 1.0,
            },
            width: 0,
            height: 0,
            i420: Vec::new(),
        }
    }
}

/// Whether a frame is in the set of its instant; `last` is the previous frame of the walk.
fn is_used(frame: &DeviceFrame, last: Option<u64>) -> bool {
    last.is_none_or(|last| frame.index > last) && frame.arrival_ns - frame.taken_ns <= HORIZON_NS
}

/// The frames that are in sets, and the IMU's samples, without any image.
fn dry_run(
    simulation: &Arc<Simulation>,
    camera: usize,
    faults: &Faults,
) -> (Vec<u64>, Vec<ImuSample>) {
    let name = &simulation.cameras()[camera].name;
    let mut device = Device::new(simulation, camera, faults.of(name), Box::new(Blank));
    let scales = simulation.imus()[camera].imu.model().count;
    let (mut frames, mut samples) = (Vec::new(), Vec::new());
    while let Some(delivery) = device.deliver() {
        match delivery {
            Delivery::Frame(frame) => {
                if is_used(&frame, frames.last().copied()) {
                    frames.push(frame.index);
                }
            }
            Delivery::Imu(sample) => {
                let si = sample.si(scales, 0.0);
                samples.push(ImuSample {
                    time_ns: sample.taken_ns,
                    gyro: si.gyro.into(),
                    accel: si.accel.into(),
                });
            }
            Delivery::Disconnected(_) => {}
        }
    }
    (frames, samples)
}

impl Walk {
    /// Whether cameras or devices have faults.
    pub(super) fn has_faults(&self) -> bool {
        !self.faults.list.is_empty()
    }

    /// Renders the frames of a camera that are in sets, in order: left and right.
    pub(super) fn frames(&self, camera: &WalkCamera) -> impl Iterator<Item = [Vec<u8>; 2]> + use<> {
        let faults = self.faults.of(&camera.name);
        let mut device = match &self.prerendered {
            None => Device::rendered(&self.simulation, camera.position, faults),
            Some(sets) => {
                let painter = PrerenderedFrames {
                    sets: sets.clone(),
                    camera: camera.number,
                };
                Device::new(&self.simulation, camera.position, faults, Box::new(painter))
            }
        };
        let mut last = None;
        std::iter::from_fn(move || {
            loop {
                if let Delivery::Frame(frame) = device.deliver()?
                    && is_used(&frame, last)
                {
                    last = Some(frame.index);
                    return Some([frame.image.gray(0), frame.image.gray(1)]);
                }
            }
        })
    }

    /// Renders each camera on its own thread, a few images ahead.
    pub(super) fn readers(&self) -> Vec<Reader> {
        let reader = |camera: &WalkCamera| -> Reader {
            let (walk, camera) = (self.clone(), camera.clone());
            let (sender, receiver) = sync_channel(MAX_QUEUED_IMAGES);
            thread::spawn(move || {
                // The receiver is dropped with the sets.
                let mut frames = walk.frames(&camera);
                while frames
                    .next()
                    .is_some_and(|frame| sender.send(frame).is_ok())
                {}
            });
            Box::new(move || receiver.recv().context("the walk has no further image"))
        };
        self.cameras.iter().map(reader).collect()
    }
}
