//! Renders the frames of one stereo camera in order.

use std::ops::Range;
use std::sync::Arc;
use std::thread;

use crate::camera::optics::Conditions;
use crate::camera::sensor::{AutoExposure, Exposure, SensorModel};
use crate::camera::{MonoCamera, Quality, Shot, auto_exposure, codec};
use crate::faults::CameraFaults;
use crate::random;

use super::{Simulation, seconds};

/// Random streams that seed cameras and frames; distinct from the streams that sensors use
/// themselves.
const CAMERA_SEEDS: u64 = random::SENSOR + 0x80;
const FRAME_SEEDS: u64 = random::SENSOR + 0x81;
const SENSOR_SEEDS: u64 = random::SENSOR + 0x82;
/// Number of frames after which the automatic exposure has converged from any start.
const SETTLING_FRAMES: u64 = 24;

/// A stereo frame as the device delivers it.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoFrame {
    /// Frame index, from 0.
    pub number: u64,
    /// Middle of the exposure of the middle row, ns since the beginning of the walk.
    pub time_ns: i64,
    /// Exposure of both eyes.
    pub exposure: Exposure,
    /// Columns of both eyes together.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Left and right side by side as I420: luma, then Cb and Cr at half the size, full range
    /// BT.601.
    pub i420: Vec<u8>,
}

/// Source of the frames of a camera.
pub trait FrameSource: Send {
    /// Frame `number`, exposed at `time_ns`, ns since the beginning of the walk. Called in order,
    /// once per frame.
    fn render_frame(&mut self, number: u64, time_ns: i64) -> StereoFrame;
}

/// Renders the frames of one camera. As an iterator it yields all frames of the walk.
pub struct FrameRenderer {
    simulation: Arc<Simulation>,
    camera: usize,
    faults: CameraFaults,
    seed: u64,
    eyes: [MonoCamera; 2],
    auto: AutoExposure,
    next: u64,
}

impl FrameRenderer {
    /// The exposure starts converged for the beginning of the walk, as of a camera that has been
    /// running.
    pub(super) fn new(simulation: &Arc<Simulation>, camera: usize) -> Self {
        let seed = random::bits(simulation.settings.seed, CAMERA_SEEDS, camera as u64);
        let of = &simulation.cameras[camera];
        let quality = simulation.settings.quality;
        let eye = |k: usize| {
            let sensor = SensorModel {
                seed: random::bits(seed, SENSOR_SEEDS, k as u64),
                ..simulation.imaging.sensor(k)
            };
            MonoCamera::new(&of.models[k], of.shutter, sensor, quality)
        };
        let mut renderer = Self {
            simulation: simulation.clone(),
            camera,
            faults: CameraFaults::default(),
            seed,
            eyes: [eye(0), eye(1)],
            auto: auto_exposure(of.max_exposure_s).fixed(simulation.imaging.exposure_s),
            next: 0,
        };
        renderer.settle(simulation.settings.frame_ns(0));
        renderer
    }

    /// The same frames with these faults.
    #[must_use]
    pub fn with_faults(mut self, faults: CameraFaults) -> Self {
        self.faults = faults;
        self
    }

    /// Lets the automatic exposure converge for the scene at a time.
    pub fn settle(&mut self, time_ns: i64) {
        for k in 0..SETTLING_FRAMES {
            self.shoot(k, time_ns, Quality::FAST);
        }
    }

    /// Renders one frame, each eye by a thread; `number` selects its noise.
    pub fn expose(&mut self, number: u64, time_ns: i64) -> StereoFrame {
        self.shoot(number, time_ns, self.simulation.settings.quality)
    }

    fn shoot(&mut self, number: u64, time_ns: i64, quality: Quality) -> StereoFrame {
        let simulation = &*self.simulation;
        let camera = &simulation.cameras[self.camera];
        let imaging = &simulation.imaging;
        let settings = &simulation.settings;
        let (eye_width, height) = (settings.width as usize, settings.height as usize);
        let width = 2 * eye_width;
        let exposure = self.auto.exposure();
        let limbs = simulation.limbs();
        let placed = simulation.placed(&limbs);
        let time_s = camera.taken_s(time_ns);
        let conditions = Conditions::of(&self.faults, seconds(time_ns));
        let slip = camera.slip(&conditions.rotation);
        let mut i420 = vec![0; width * height * 3 / 2];
        let (luma, chroma) = i420.split_at_mut(width * height);
        let (cb, cr) = chroma.split_at_mut(width * height / 4);
        let noise = |k: usize| random::bits(self.seed, FRAME_SEEDS, 2 * number + k as u64);
        let render = |k: usize, eye: &mut MonoCamera| {
            let pose = |t: f64| camera.world_from_eye(k, &simulation.walker.rig(t), slip.as_ref());
            let shot = Shot {
                time_s,
                exposure,
                quality,
                noise: noise(k),
            };
            eye.expose(simulation.scene(), &placed, &pose, &shot);
            eye.degrade(simulation.scene(), &pose(time_s), &conditions, k as u64);
            if k == 1 {
                eye.blur(imaging.right_eye.blur_px);
            }
        };
        let [left, right] = &mut self.eyes;
        thread::scope(|scope| {
            scope.spawn(|| render(1, right));
            render(0, left);
        });
        let mut mean = 0.0;
        for (k, eye) in self.eyes.iter_mut().enumerate() {
            // The right eye's columns follow the left one's in each row.
            let (x, half) = (k * eye_width, k * eye_width / 2);
            let chroma = [&mut cb[half..], &mut cr[half..]];
            mean += 0.5 * eye.develop(&exposure, noise(k), &mut luma[x..], chroma, width);
            codec::quantize(
                &mut luma[x..],
                width,
                [eye_width, height],
                imaging.codec_step,
            );
        }
        self.auto.learn(mean);
        StereoFrame {
            number,
            time_ns,
            exposure,
            width,
            height,
            i420,
        }
    }
}

impl FrameSource for FrameRenderer {
    fn render_frame(&mut self, number: u64, time_ns: i64) -> StereoFrame {
        self.expose(number, time_ns)
    }
}

impl Iterator for FrameRenderer {
    type Item = StereoFrame;

    fn next(&mut self) -> Option<StereoFrame> {
        let settings = &self.simulation.settings;
        let number = self.next;
        if number >= settings.frame_count() {
            return None;
        }
        let time_ns = settings.frame_ns(number);
        self.next += 1;
        Some(self.expose(number, time_ns))
    }
}

impl StereoFrame {
    /// The luma of one eye (0 left, 1 right), rows first, without gaps.
    pub fn gray(&self, eye: usize) -> Vec<u8> {
        let half = self.width / 2;
        let rows = self.i420[..self.width * self.height].chunks_exact(self.width);
        rows.flat_map(|row| &row[eye * half..(eye + 1) * half])
            .copied()
            .collect()
    }

    /// Red, green, blue of each pixel of one eye, rows first.
    pub fn rgb(&self, eye: usize) -> Vec<[u8; 3]> {
        let half = self.width / 2;
        let columns = eye * half..(eye + 1) * half;
        rgb_of(&self.i420, [self.width, self.height], columns)
    }
}

/// Red, green, blue of some columns of an I420 image, rows first.
pub(super) fn rgb_of(
    i420: &[u8],
    [width, height]: [usize; 2],
    columns: Range<usize>,
) -> Vec<[u8; 3]> {
    let (luma, chroma) = i420.split_at(width * height);
    let (cb, cr) = chroma.split_at(width * height / 4);
    let pixel = |x: usize, y: usize| {
        let c = y / 2 * (width / 2) + x / 2;
        let luma = f32::from(luma[y * width + x]);
        let (b, r) = (f32::from(cb[c]) - 128.0, f32::from(cr[c]) - 128.0);
        // The inverse of what the sensor does (BT.601).
        [
            luma + 1.402 * r,
            luma - 0.344 * b - 0.714 * r,
            luma + 1.772 * b,
        ]
        .map(|v| (v + 0.5).clamp(0.0, 255.0) as u8)
    };
    (0..height)
        .flat_map(|y| columns.clone().map(move |x| (x, y)))
        .map(|(x, y)| pixel(x, y))
        .collect()
}
