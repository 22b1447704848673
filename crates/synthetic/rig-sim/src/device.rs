//! A simulated device: a stereo camera with its IMU, delivering numbered samples with timestamps of
//! its own clocks, latency, and planned faults.
//!
//! Contract: a device is a function of simulation, camera, faults and seed. It delivers in the
//! order of arrival; frames arrive in the order of their numbers, and so do IMU samples, as on a
//! USB or GMSL link. Frame `n` is exposed in the middle of the `n`-th period, whatever the device
//! clock shows; IMU sample `n` is timed by the IMU's own oscillator. *Losses* are listed with their
//! cause in [`Device::losses`]. *While the device is disconnected* nothing is delivered; after
//! reconnecting it counts from 0 and its clocks restart. *At the end of the walk* delivery ends.

use std::sync::Arc;

use crate::camera::optics::Conditions;
use crate::faults::{CameraFaults, Kind};
use crate::imu::{ImuFaults, ImuSample};
use crate::random;
use crate::rig::PixelFormat;
use crate::simulation::{FrameSource, Simulation, StereoFrame, seconds};

pub mod clock;
mod disconnects;
pub mod pixels;
pub mod report;
mod truth;

use self::clock::DeviceClock;
use self::disconnects::Disconnects;

/// Mean and maximum random latency from exposure or measurement to arrival, ns; without the
/// constant part.
const MEAN_MAX_DELAY_NS: (f64, f64) = (200_000.0, 2_000_000.0);
/// Fraction of frames that are delayed while the fault `late` acts.
const LATE_RATIO: f64 = 0.1;
/// Standard deviation of the oscillator rate error, ppm.
const CLOCK_ERROR_SIGMA_PPM: f64 = 25.0;
/// IMU warm-up: initial temperature, total rise, °C, and half time, s.
const WARMING_C: (f64, f64, f64) = (24.0, 14.0, 120.0);

/// What the device delivers.
#[derive(Clone, Debug, PartialEq)]
pub enum Delivery {
    /// A stereo frame.
    Frame(DeviceFrame),
    /// An IMU sample.
    Imu(DeviceImu),
    /// The device has disconnected; the link noticed it at this time, ns.
    Disconnected(i64),
}

/// A stereo frame from a device.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceFrame {
    /// Sequence number, from 0 since the device connected.
    pub number: u64,
    /// Device clock in the middle of the exposure, ticks.
    pub ticks: i64,
    /// Arrival time, ns since the beginning of the walk.
    pub arrival_ns: i64,
    /// True time of the measurement, ns.
    pub taken_ns: i64,
    /// Index of the frame in the walk.
    pub index: u64,
    /// Pixel layout.
    pub format: PixelFormat,
    /// The image.
    pub image: StereoFrame,
}

/// An IMU sample from a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceImu {
    /// Sequence number, from 0 since the device connected.
    pub number: u64,
    /// Index of the sample in the walk.
    pub index: u64,
    /// IMU clock, ticks.
    pub ticks: i64,
    /// Arrival time, ns since the beginning of the walk.
    pub arrival_ns: i64,
    /// True time of the measurement, ns.
    pub taken_ns: i64,
    /// Angular rate, counts.
    pub gyro: [i16; 3],
    /// Specific force, counts.
    pub accel: [i16; 3],
    /// Temperature, 0.01 °C.
    pub temperature: i16,
    /// Whether a frame was exposed since the previous sample.
    pub frame_sync: bool,
    /// Number of frames since the device connected.
    pub frame_sync_count: u32,
}

/// The two streams of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stream {
    /// Stereo frames.
    Frames,
    /// IMU samples.
    Imu,
}

/// A frame or sample that never arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loss {
    /// Stream.
    pub stream: Stream,
    /// Index of the frame or sample in the walk.
    pub index: u64,
    /// Time of the measurement, ns since the beginning of the walk.
    pub taken_ns: i64,
    /// Cause.
    pub cause: Kind,
}

/// A simulated device; see the module documentation.
pub struct Device {
    simulation: Arc<Simulation>,
    camera: usize,
    faults: CameraFaults,
    source: Box<dyn FrameSource>,
    seed: u64,
    disconnects: Disconnects,
    clocks: [DeviceClock; 2],
    frames: Queue,
    samples: Queue,
    /// Frames that the IMU has reported since the device connected.
    synced: u32,
    /// Previous image, for frozen and torn frames.
    before: Option<StereoFrame>,
    again: Option<DeviceFrame>,
    losses: Vec<Loss>,
}

/// Progress of one stream.
#[derive(Clone, Debug, Default)]
struct Queue {
    /// Index of the next measurement.
    index: u64,
    /// Index of the first measurement since the device connected.
    first: u64,
    /// Connection epoch.
    epoch: usize,
    arrival_ns: i64,
    next: Option<Slot>,
}

/// A measurement that will arrive.
#[derive(Clone, Copy, Debug)]
struct Slot {
    index: u64,
    taken_ns: i64,
    arrival_ns: i64,
}

impl Device {
    /// Device of the camera with index `camera`, with images from `source`.
    pub fn new(
        simulation: &Arc<Simulation>,
        camera: usize,
        faults: CameraFaults,
        source: Box<dyn FrameSource>,
    ) -> Self {
        let seed = random::bits(simulation.settings().seed, random::DEVICE, camera as u64);
        let clock = |k: u64, tick| {
            let off = CLOCK_ERROR_SIGMA_PPM * random::bell(seed, random::DEVICE, k);
            let hours = 2.0 + 20.0 * random::uniform(seed, random::DEVICE + 1, k);
            DeviceClock::new(tick, (hours * 3.6e12) as i64, off, &faults)
        };
        Self {
            clocks: [clock(0, clock::CAMERA_TICK), clock(1, clock::IMU_TICK)],
            disconnects: Disconnects::of(&faults),
            simulation: simulation.clone(),
            camera,
            faults,
            source,
            seed,
            frames: Queue::default(),
            samples: Queue::default(),
            synced: 0,
            before: None,
            again: None,
            losses: Vec::new(),
        }
    }

    /// Device whose images are rendered from the scene.
    pub fn rendered(simulation: &Arc<Simulation>, camera: usize, faults: CameraFaults) -> Self {
        let frame_renderer = simulation.frames(camera).with_faults(faults.clone());
        Self::new(simulation, camera, faults, Box::new(frame_renderer))
    }

    /// Clocks of frames and of IMU samples.
    pub fn clocks(&self) -> &[DeviceClock; 2] {
        &self.clocks
    }

    /// Times of disconnection: begin and end, ns since the beginning of the walk, ascending.
    pub fn disconnects(&self) -> &[(i64, i64)] {
        self.disconnects.spans()
    }

    /// Losses so far.
    pub fn losses(&self) -> &[Loss] {
        &self.losses
    }

    /// Drops frames that would arrive before `time_ns` (ns since the beginning of the walk), as on
    /// a device that is not read in time. Returns the sequence numbers of those frames.
    pub fn skip_frames_to(&mut self, time_ns: i64) -> Vec<u64> {
        let mut skipped = Vec::new();
        while let Some(slot) = self.next_frame().filter(|s| s.arrival_ns < time_ns) {
            self.frames.next = None;
            skipped.push(slot.index - self.frames.first);
            self.lose(Stream::Frames, slot.index, slot.taken_ns, Kind::Dropped);
        }
        skipped
    }

    /// Next delivery.
    pub fn deliver(&mut self) -> Option<Delivery> {
        if let Some(again) = self.again.take() {
            return Some(Delivery::Frame(again));
        }
        let frame = self.next_frame();
        let sample = self.next_sample();
        let first = [frame, sample].into_iter().flatten();
        let first = first.map(|s| s.arrival_ns).min();
        if let Some(disconnected_ns) = self.disconnects.next_before(first) {
            return Some(Delivery::Disconnected(disconnected_ns));
        }
        match (frame, sample) {
            (frame, Some(sample)) if frame.is_none_or(|f| sample.arrival_ns <= f.arrival_ns) => {
                self.samples.next = None;
                Some(Delivery::Imu(self.imu_sample(sample)))
            }
            (Some(frame), _) => {
                self.frames.next = None;
                Some(Delivery::Frame(self.frame(frame)))
            }
            (None, _) => None,
        }
    }

    fn next_frame(&mut self) -> Option<Slot> {
        while self.frames.next.is_none() {
            let settings = self.simulation.settings();
            let index = self.frames.index;
            if index >= settings.frame_count() {
                return None;
            }
            let taken_ns = settings.frame_ns(index);
            let time_s = seconds(taken_ns);
            let late_s = self.faults.strength(Kind::Late, time_s);
            let is_late = random::uniform(self.seed, random::DEVICE + 2, index) < LATE_RATIO;
            let late_ns = if is_late { late_s * 1e9 } else { 0.0 };
            let lost = self.faults.hits(Kind::Dropped, index, time_s);
            let lost = lost.then_some(Kind::Dropped);
            self.enqueue(Stream::Frames, taken_ns, late_ns as i64, lost);
            if lost.is_some() {
                // The frame was exposed, so the exposure control adapts to it.
                self.before = Some(self.source.render_frame(index, taken_ns));
            }
        }
        self.frames.next
    }

    fn next_sample(&mut self) -> Option<Slot> {
        while self.samples.next.is_none() {
            let imu = &self.simulation.imus()[self.camera].imu;
            let (index, rate_hz) = (self.samples.index, imu.model().rate_hz);
            let taken_ns = self.clocks[1].taken_ns(index, rate_hz);
            if seconds(taken_ns) > self.simulation.settings().seconds {
                return None;
            }
            let lost = self.faults.is_during(Kind::ImuGap, seconds(taken_ns));
            self.enqueue(Stream::Imu, taken_ns, 0, lost.then_some(Kind::ImuGap));
        }
        self.samples.next
    }

    /// Takes the next measurement of a stream and computes its arrival time, or records its loss.
    fn enqueue(&mut self, stream: Stream, taken_ns: i64, late_ns: i64, lost: Option<Kind>) {
        let epoch = self.disconnects.epoch(taken_ns);
        let (queue, of_delay) = match stream {
            Stream::Frames => (&mut self.frames, random::DEVICE + 3),
            Stream::Imu => (&mut self.samples, random::DEVICE + 4),
        };
        let index = queue.index;
        queue.index += 1;
        let Some(epoch) = epoch else {
            self.lose(stream, index, taken_ns, Kind::Disconnect);
            return;
        };
        if epoch != queue.epoch {
            queue.epoch = epoch;
            queue.first = index;
        }
        if let Some(cause) = lost {
            self.lose(stream, index, taken_ns, cause);
            return;
        }
        let (mean, most) = MEAN_MAX_DELAY_NS;
        let delay = (mean * random::exponential(self.seed, of_delay, index)).min(most);
        let burst_s = self.faults.strength(Kind::LatencyBurst, seconds(taken_ns));
        let burst = burst_s * 1e9 * random::exponential(self.seed, of_delay + 2, index);
        let arrival_ns = taken_ns + delay as i64 + burst as i64 + late_ns;
        queue.arrival_ns = queue.arrival_ns.max(arrival_ns);
        let arrival_ns = queue.arrival_ns;
        if self.disconnects.epoch(arrival_ns) != Some(epoch) {
            self.lose(stream, index, taken_ns, Kind::Disconnect);
            return;
        }
        queue.next = Some(Slot {
            index,
            taken_ns,
            arrival_ns,
        });
    }

    fn lose(&mut self, stream: Stream, index: u64, taken_ns: i64, cause: Kind) {
        self.losses.push(Loss {
            stream,
            index,
            taken_ns,
            cause,
        });
    }

    fn frame(&mut self, slot: Slot) -> DeviceFrame {
        let Slot {
            index,
            taken_ns,
            arrival_ns,
        } = slot;
        let time_s = seconds(taken_ns);
        let mut image = self.source.render_frame(index, taken_ns);
        if let Some(before) = &self.before {
            if self.faults.hits(Kind::Frozen, index, time_s) {
                image.i420.clone_from(&before.i420);
            }
            if self.faults.hits(Kind::Torn, index, time_s) {
                let at = random::uniform(self.seed, random::DEVICE + 7, index);
                image.tear(before, at);
            }
        }
        self.before = Some(image.clone());
        let frame = DeviceFrame {
            number: index - self.frames.first,
            ticks: self.ticks(Stream::Frames, self.frames.epoch, taken_ns),
            arrival_ns,
            taken_ns,
            index,
            format: self.simulation.cameras()[self.camera].format,
            image,
        };
        if self.faults.hits(Kind::Duplicated, index, time_s) {
            self.again = Some(frame.clone());
        }
        frame
    }

    fn imu_sample(&mut self, slot: Slot) -> DeviceImu {
        let Slot {
            index,
            taken_ns,
            arrival_ns,
        } = slot;
        let time_s = seconds(taken_ns);
        let settings = self.simulation.settings();
        // Frames are exposed in the middle of their periods.
        let taken_by = |ns: i64| (seconds(ns) * settings.rate_hz + 0.5).floor().max(0.0) as u64;
        let begin = self.disconnects.began(self.samples.epoch);
        let synced = (taken_by(taken_ns) - taken_by(begin).min(taken_by(taken_ns))) as u32;
        let frame_sync = std::mem::replace(&mut self.synced, synced) != synced;
        let rotation = Conditions::of(&self.faults, time_s).rotation;
        let faults = ImuFaults {
            range_share: 1.0 - self.faults.strength(Kind::ImuClipping, time_s),
            slip: self.simulation.cameras()[self.camera].slip(&rotation),
        };
        let imu = &self.simulation.imus()[self.camera].imu;
        let walker = self.simulation.walker();
        let measured = imu.sample(walker, index as usize, time_s, &faults);
        let [gyro, accel] = imu.counts(&measured);
        let (cold, warmer, half_s) = WARMING_C;
        let warmth = cold + warmer * (1.0 - libm::exp2(-time_s / half_s));
        DeviceImu {
            number: index - self.samples.first,
            index,
            ticks: self.ticks(Stream::Imu, self.samples.epoch, taken_ns),
            arrival_ns,
            taken_ns,
            gyro,
            accel,
            temperature: (100.0 * warmth) as i16,
            frame_sync,
            frame_sync_count: synced,
        }
    }

    /// Clock value of a stream at a time in a connection epoch, ticks.
    fn ticks(&self, stream: Stream, epoch: usize, taken_ns: i64) -> i64 {
        let clock = &self.clocks[stream as usize];
        match epoch {
            0 => clock.ticks(taken_ns),
            _ => clock.ticks_since(self.disconnects.began(epoch), taken_ns),
        }
    }
}

impl DeviceImu {
    /// In SI units: gyro rad/s, accelerometer m/s².
    pub fn si(&self, scales: [f64; 2], time_s: f64) -> ImuSample {
        let vector = |counts: [i16; 3], scale: f64| {
            nalgebra::Vector3::from(counts.map(|c| f64::from(c) * scale))
        };
        ImuSample {
            time_s,
            gyro: vector(self.gyro, scales[0]),
            accel: vector(self.accel, scales[1]),
        }
    }
}

#[cfg(test)]
mod tests;
