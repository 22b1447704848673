//! A stereo camera with its IMU, as the device delivers what it takes: numbered, stamped by its own
//! clocks, some time later, and with the faults that were planned.
//!
//! Contract: a device is a function of simulation, camera, faults and seed. It delivers in the order of arrival;
//! frames arrive in the order of their numbers, and so do samples of the IMU, as on a USB or GMSL link.
//! Frame `n` is taken in the middle of the `n`-th period, whatever the device's clock shows; IMU sample `n` when
//! the IMU's own oscillator says so. *What is lost* is listed with its cause in [`Device::losses`]. *While the
//! device is gone* nothing is taken; back again it counts from 0 and its clocks start anew. *At the end
//! of the walk* there is nothing more.

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

/// Mean and longest time from exposure or measurement to arrival, beyond what is constant, ns.
const MEAN_MAX_DELAY_NS: (f64, f64) = (200_000.0, 2_000_000.0);
/// One frame in so many is late, where frames are.
const LATE_RATIO: f64 = 0.1;
/// How far oscillators are off, ppm.
const CLOCK_ERROR_SIGMA_PPM: f64 = 25.0;
/// Temperature of an IMU when it is switched on, how much warmer it gets, degC, and in what time by half, s.
const WARMING_C: (f64, f64, f64) = (24.0, 14.0, 120.0);

/// What the device hands over.
#[derive(Clone, Debug, PartialEq)]
pub enum Delivery {
    /// A stereo frame.
    Frame(DeviceFrame),
    /// An IMU sample.
    Imu(DeviceImu),
    /// The device has gone; the link noticed it at this time, ns.
    Disconnected(i64),
}

/// A stereo frame from a device.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceFrame {
    /// Sequence number, from 0 since the device is there.
    pub number: u64,
    /// The device's clock in the middle of the exposure.
    pub ticks: i64,
    /// When it arrived, ns since the beginning of the walk.
    pub arrival_ns: i64,
    /// When it was really taken, ns.
    pub taken_ns: i64,
    /// Which frame of the walk it is.
    pub index: u64,
    /// How the device lays out its pixels.
    pub format: PixelFormat,
    /// What it shows.
    pub image: StereoFrame,
}

/// An IMU sample from a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceImu {
    /// Sequence number, from 0 since the device is there.
    pub number: u64,
    /// Which sample of the walk it is.
    pub index: u64,
    /// The IMU's clock.
    pub ticks: i64,
    /// When it arrived, ns since the beginning of the walk.
    pub arrival_ns: i64,
    /// When it was really taken, ns.
    pub taken_ns: i64,
    /// What was measured, in counts.
    pub gyro: [i16; 3],
    /// See `gyro`.
    pub accel: [i16; 3],
    /// Hundredths of a degree Celsius.
    pub temperature: i16,
    /// Whether a frame was taken since the sample before.
    pub frame_sync: bool,
    /// How many frames were since the device is there.
    pub frame_sync_count: u32,
}

/// Which of a device's two streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stream {
    /// Stereo frames.
    Frames,
    /// IMU samples.
    Imu,
}

/// Something that was taken, or would have been, and never arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loss {
    /// Of which stream.
    pub stream: Stream,
    /// Which frame or sample of the walk.
    pub index: u64,
    /// When, ns since the beginning of the walk.
    pub taken_ns: i64,
    /// Why.
    pub cause: Kind,
}

/// See the module.
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
    /// Frames that the IMU has been told of since the device is there.
    synced: u32,
    /// The picture before, for frames that show it again.
    before: Option<StereoFrame>,
    again: Option<DeviceFrame>,
    losses: Vec<Loss>,
}

/// How far a stream has come.
#[derive(Clone, Debug, Default)]
struct Queue {
    /// The next that is taken.
    index: u64,
    /// The first since the device is there.
    first: u64,
    /// Which of the times that the device was there.
    epoch: usize,
    arrival_ns: i64,
    next: Option<Slot>,
}

/// Something that will arrive.
#[derive(Clone, Copy, Debug)]
struct Slot {
    index: u64,
    taken_ns: i64,
    arrival_ns: i64,
}

impl Device {
    /// A camera of the simulation, by its position, with pictures by `source`.
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

    /// The same with pictures of the scene.
    pub fn rendered(simulation: &Arc<Simulation>, camera: usize, faults: CameraFaults) -> Self {
        let frame_renderer = simulation.frames(camera).with_faults(faults.clone());
        Self::new(simulation, camera, faults, Box::new(frame_renderer))
    }

    /// The clock that stamps frames and the one that stamps IMU samples.
    pub fn clocks(&self) -> &[DeviceClock; 2] {
        &self.clocks
    }

    /// When the device is gone: begin and end, ns since the beginning of the walk, in order.
    pub fn disconnects(&self) -> &[(i64, i64)] {
        self.disconnects.spans()
    }

    /// What was lost so far.
    pub fn losses(&self) -> &[Loss] {
        &self.losses
    }

    /// Leaves out frames that would arrive before this time: they are lost as on a device that is not read
    /// in time. ns since the beginning of the walk. The numbers of those frames.
    pub fn skip_frames_to(&mut self, time_ns: i64) -> Vec<u64> {
        let mut skipped = Vec::new();
        while let Some(slot) = self.next_frame().filter(|s| s.arrival_ns < time_ns) {
            self.frames.next = None;
            skipped.push(slot.index - self.frames.first);
            self.lose(Stream::Frames, slot.index, slot.taken_ns, Kind::Dropped);
        }
        skipped
    }

    /// What arrives next.
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
                // It was taken, and the exposure learned from it.
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

    /// Takes the next of a stream and finds out when, and whether, it arrives.
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
        // Frames are taken in the middle of their periods.
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

    /// What a stream's clock shows at a time in an epoch of the device.
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
