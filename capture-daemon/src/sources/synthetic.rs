//! A synthetic moving image with its IMU, generated from a seed.
//!
//! Contract: the same arguments give the same samples, byte for byte, on every machine: images are
//! computed with integers, and fractions only with operations that IEEE 754 specifies exactly. A
//! textured wall moves as the camera rotates left and right, up and down; the right image shows it
//! with a constant disparity; a bar of black and white blocks at the top of each eye's image
//! contains the frame's number ([`read_counter`]). The IMU measures the same rotation, gravity and
//! the bobbing of a walk, which the image does not show.
//!
//! Frame `n` is captured at `start + n / rate`, sample `n` of the IMU at `start + n / imu_rate`.
//! Device clocks stamp these instants with an offset and a drift of their own
//! ([`CAMERA_DRIFT_PPM`], [`IMU_DRIFT_PPM`]); arrival is later by an exponential delay with a mean
//! of 0.2 ms and a maximum of 2 ms. *Order*: by arrival, in each stream also by number. *At the
//! end*: there is none, unless a [`FaultPlan`] sets it. *On a planned fault*: samples are lost as
//! on a real device, numbers and ticks continue. *While pixels are not needed* nothing is rendered;
//! times and numbers are the same.

use std::ops::Range;

use counter_random as random;
use session_archive::time::{HostTime, NS_PER_S, TickLength};
use video::{PixelFormat, RawImage, RawImageError};

use crate::digest::Digest;

use super::datasets::time_at;
use super::{
    CameraInfo, FrameArrival, ImuInfo, ImuValues, RawFrame, RawImu, Sample, Source, SourceError,
    SourceInfo,
};

mod counter;
mod motion;
mod texture;

/// Streams of random numbers, by purpose.
mod streams {
    pub(super) const TEXTURE: u64 = 0x100;
    pub(super) const PHASES: u64 = 0x200;
    pub(super) const CAMERA_DELAY: u64 = 0x300;
    pub(super) const IMU_DELAY: u64 = 0x400;
    pub(super) const IMU_NOISE: u64 = 0x500;
}

pub use counter::{COUNTER_MODULUS, read_counter, read_eye_counter};
use motion::Motion;
use texture::Wall;

/// Rate deviation of the camera's clock from the host's, parts in 1e6.
pub const CAMERA_DRIFT_PPM: i64 = 20;
/// Rate deviation of the IMU's clock from the host's, parts in 1e6.
pub const IMU_DRIFT_PPM: i64 = -35;
/// Reading of the camera's clock at `start`, ns.
pub const CAMERA_TICKS_AT_START: i64 = 3_600 * NS_PER_S;
/// Reading of the IMU's clock at `start`, ticks of 1/25600 s.
pub const IMU_TICKS_AT_START: i64 = 1_000 * 25_600;

/// rad/s per gyro count and m/s² per accelerometer count: the ZED Mini's ranges of 1000 °/s and 8 g
/// (zed-open-capture, sensorcapture).
pub const IMU_SCALE: (f64, f64) = (
    1000.0 / 32_768.0 * std::f64::consts::PI / 180.0,
    9.8189 * 8.0 / 32_768.0,
);

const EXPOSURE_NS: u32 = 4_000_000;
const MEAN_DELAY_NS: f64 = 200_000.0;
const MAX_DELAY_NS: f64 = 2_000_000.0;
/// Time after the start from which no sample is delivered, ns; keeps sums of times in range.
const NEVER_NS: i64 = i64::MAX / 4;

/// Error of creating the source: correct the arguments.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SyntheticError {
    /// The counter bar needs a minimum width, and each eye an even size.
    #[error(
        "generating images: the stereo frame is {width}x{height}, expected a width that is a multiple of 4 and at \
         least 128, and an even height of at least 32"
    )]
    Size {
        /// Width as given.
        width: u32,
        /// Height as given.
        height: u32,
    },
    /// A rate is out of range.
    #[error("making up {what}: the rate is {rate_hz} Hz, expected at most 10000 and {min}")]
    Rate {
        /// Frames or IMU samples.
        what: &'static str,
        /// The rate as given.
        rate_hz: f64,
        /// Lower limit.
        min: &'static str,
    },
}

/// Intentional faults, for tests. Times are ns after the start. The default is none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FaultPlan {
    /// Numbers of lost frames.
    pub drop_frames: Vec<u64>,
    /// Frames captured in this span are lost.
    pub camera_silence: Option<Range<i64>>,
    /// IMU samples taken in this span are lost.
    pub imu_silence: Option<Range<i64>>,
    /// Frames with these numbers repeat the image before them, bit by bit.
    pub frozen: Option<Range<u64>>,
    /// The source ends before the frame of this number, the IMU at the same instant.
    pub end_after_frames: Option<u64>,
}

/// A synthetic stereo camera. See the module for the contract.
pub struct Synthetic {
    info: SourceInfo,
    seed: u64,
    start: HostTime,
    rate_hz: f64,
    imu_rate_hz: f64,
    wall: Wall,
    motion: Motion,
    faults: FaultPlan,
    camera: Stream,
    imu: Stream,
    /// Whether images are rendered, or frames only counted.
    pixels_needed: bool,
}

impl Synthetic {
    /// A camera whose stereo frame is `width` x `height` pixels, both eyes together.
    ///
    /// `imu_rate_hz` 0 is a camera without an IMU.
    ///
    /// # Errors
    /// [`SyntheticError`].
    pub fn new(
        name: &str,
        width: u32,
        height: u32,
        rate_hz: f64,
        imu_rate_hz: f64,
        seed: u64,
        start: HostTime,
    ) -> Result<Self, SyntheticError> {
        let eye = width / 2;
        let fits = width.is_multiple_of(4)
            && height.is_multiple_of(2)
            && counter::cell(eye, height).is_some()
            && PixelFormat::I420.bytes(width, height).is_ok();
        if !fits {
            return Err(SyntheticError::Size { width, height });
        }
        if !(rate_hz > 0.0 && rate_hz <= 10_000.0) {
            return Err(SyntheticError::Rate {
                what: "frames",
                rate_hz,
                min: "above 0",
            });
        }
        if !(0.0..=10_000.0).contains(&imu_rate_hz) {
            return Err(SyntheticError::Rate {
                what: "IMU samples",
                rate_hz: imu_rate_hz,
                min: "at least 0",
            });
        }
        let info = SourceInfo {
            description: format!("synthetic camera {name}, seed {seed}"),
            camera: CameraInfo {
                width,
                height,
                rate_hz,
                tick: TickLength::NANOSECOND,
                tick_bits: None,
                number_bits: None,
                colour: true,
                still: false,
                stamped: None,
            },
            imu: (imu_rate_hz > 0.0).then_some(ImuInfo {
                rate_hz: imu_rate_hz,
                tick: TickLength::ZED_MINI,
                tick_bits: None,
                number_bits: None,
                scale: Some(IMU_SCALE),
                temperature_scale_c: None,
            }),
            calibration_files: Vec::new(),
        };
        Ok(Self {
            info,
            seed,
            start,
            rate_hz,
            imu_rate_hz,
            wall: Wall::new(seed, width, height),
            motion: Motion::new(seed, eye),
            faults: FaultPlan::default(),
            camera: Stream::default(),
            imu: Stream::default(),
            pixels_needed: true,
        })
    }

    /// The same camera with faults.
    #[must_use]
    pub fn with_faults(mut self, faults: FaultPlan) -> Self {
        self.faults = faults;
        self
    }

    /// Capture time of frame `number`: the ground truth of clock maps.
    pub fn frame_time(&self, number: u64) -> HostTime {
        self.start + time_at(number, self.rate_hz)
    }

    /// Time of sample `number` of the IMU.
    pub fn imu_time(&self, number: u64) -> HostTime {
        self.start + time_at(number, self.imu_rate_hz)
    }

    /// The image of frame `number`, without faults.
    ///
    /// # Errors
    /// None in practice: the size was checked.
    fn image(&self, number: u64) -> Result<RawImage, RawImageError> {
        let (x, y) = self.motion.shift_px(time_at(number, self.rate_hz));
        let mut data = self.wall.draw(x, y);
        let (width, height) = (self.info.camera.width, self.info.camera.height);
        counter::draw(&mut data, width, height, number);
        RawImage::new(width, height, PixelFormat::I420, data)
    }

    fn frame(&self, slot: Slot) -> Result<RawFrame, RawImageError> {
        let shown = match &self.faults.frozen {
            Some(frozen) if frozen.contains(&slot.number) => frozen.start.saturating_sub(1),
            _ => slot.number,
        };
        Ok(RawFrame {
            number: slot.number,
            device_ticks: camera_ticks(slot),
            kernel_time: None,
            host_time: slot.arrival,
            exposure_ns: Some(EXPOSURE_NS),
            eyes_apart_ns: None,
            image: self.image(shown)?,
        })
    }

    fn imu_sample(&self, slot: Slot) -> RawImu {
        let device_ns = i128::from(drifted(slot.taken_ns, IMU_DRIFT_PPM));
        let TickLength { num, den } = TickLength::ZED_MINI;
        let ticks = device_ns * i128::from(den) / i128::from(num);
        let (gyro, accel) = self.motion.measured(slot.taken_ns);
        let (gyro_scale, accel_scale) = IMU_SCALE;
        let noise = |axis: u64| random::bell(self.seed, streams::IMU_NOISE + axis, slot.number);
        // Noise of the ZED Mini's kind of IMU at some hundred Hz: 3 counts rad/s, 8 counts m/s².
        let counts = |si: [f64; 3], scale: f64, sigma: f64, axis: u64| {
            [0, 1, 2].map(|i| {
                let count = si[i] / scale + sigma * noise(axis + i as u64);
                count.round().clamp(-32_768.0, 32_767.0) as i32
            })
        };
        RawImu {
            number: slot.number,
            device_ticks: IMU_TICKS_AT_START + ticks as i64,
            host_time: slot.arrival,
            values: ImuValues::Counts {
                gyro: counts(gyro, gyro_scale, 3.0, 0),
                accel: counts(accel, accel_scale, 8.0, 3),
            },
            temperature: None,
            frame_sync: false,
        }
    }
}

impl Source for Synthetic {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn digest(&self) -> Vec<u8> {
        let mut digest = Digest::new("synthetic");
        digest.value(&(self.seed, self.rate_hz, self.imu_rate_hz));
        digest.value(&self.faults);
        digest.finish().to_vec()
    }

    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError> {
        let faults = &self.faults;
        let end_ns = faults
            .end_after_frames
            .map_or(NEVER_NS, |n| time_at(n, self.rate_hz).min(NEVER_NS));
        let schedule = |rate_hz, delays, silence| Schedule {
            rate_hz,
            seed: self.seed,
            delays,
            silence,
            start: self.start,
            end_ns,
        };
        let frames = schedule(self.rate_hz, streams::CAMERA_DELAY, &faults.camera_silence);
        let frame = self
            .camera
            .peek(&frames, |number| faults.drop_frames.contains(&number));
        let imu = match self.info.imu {
            Some(_) => {
                let samples = schedule(self.imu_rate_hz, streams::IMU_DELAY, &faults.imu_silence);
                self.imu.peek(&samples, |_| false)
            }
            None => None,
        };
        match (frame, imu) {
            (frame, Some(imu)) if frame.is_none_or(|frame| imu.arrival <= frame.arrival) => {
                self.imu.next = None;
                Ok(Some(Sample::Imu(self.imu_sample(imu))))
            }
            (Some(frame), _) if !self.pixels_needed => {
                self.camera.next = None;
                Ok(Some(Sample::Arrival(FrameArrival {
                    number: frame.number,
                    device_ticks: camera_ticks(frame),
                    host_time: frame.arrival,
                })))
            }
            (Some(frame), _) => {
                self.camera.next = None;
                let frame = self.frame(frame).map_err(|error| SourceError::Unusable {
                    source_name: self.info.description.clone(),
                    what: error.to_string(),
                })?;
                Ok(Some(Sample::Frame(frame)))
            }
            (None, _) => Ok(None),
        }
    }

    fn set_pixels_needed(&mut self, needed: bool) {
        self.pixels_needed = needed;
    }

    fn begin_at(&mut self, start: HostTime) {
        self.start = start;
    }
}

/// The next sample of one stream.
#[derive(Clone, Copy, Debug)]
struct Slot {
    number: u64,
    /// ns after the start.
    taken_ns: i64,
    arrival: HostTime,
}

/// Sampling times of a stream, and the samples that never arrive.
struct Schedule<'a> {
    rate_hz: f64,
    seed: u64,
    /// Random stream of the delays.
    delays: u64,
    silence: &'a Option<Range<i64>>,
    start: HostTime,
    end_ns: i64,
}

/// Progress of a stream.
#[derive(Debug, Default)]
struct Stream {
    next: Option<Slot>,
    next_number: u64,
    last_arrival: Option<HostTime>,
}

impl Stream {
    /// The next sample that arrives; it remains the next one until `next` is taken.
    fn peek(&mut self, schedule: &Schedule<'_>, is_lost: impl Fn(u64) -> bool) -> Option<Slot> {
        while self.next.is_none() {
            let number = self.next_number;
            let taken_ns = time_at(number, schedule.rate_hz);
            if taken_ns >= schedule.end_ns {
                return None;
            }
            self.next_number += 1;
            match schedule.silence {
                Some(silence) if silence.contains(&taken_ns) => {
                    // Not one at a time: a silence may be endless.
                    let after = (silence.end as f64 * schedule.rate_hz / 1e9).floor() as u64;
                    self.next_number = self.next_number.max(after);
                    continue;
                }
                _ if is_lost(number) => continue,
                _ => {}
            }
            let delay = random::exponential(schedule.seed, schedule.delays, number);
            let delay_ns = (delay * MEAN_DELAY_NS).min(MAX_DELAY_NS) as i64;
            let arrival = schedule.start + (taken_ns + delay_ns);
            let arrival = self.last_arrival.map_or(arrival, |last| last.max(arrival));
            self.last_arrival = Some(arrival);
            self.next = Some(Slot {
                number,
                taken_ns,
                arrival,
            });
        }
        self.next
    }
}

/// Reading of the camera's clock when a frame is captured.
fn camera_ticks(slot: Slot) -> i64 {
    CAMERA_TICKS_AT_START + drifted(slot.taken_ns, CAMERA_DRIFT_PPM)
}

/// `ns` on a clock that runs faster by `ppm`.
fn drifted(ns: i64, ppm: i64) -> i64 {
    let ns = i128::from(ns);
    (ns + ns * i128::from(ppm) / 1_000_000) as i64
}

#[cfg(test)]
mod tests;
