//! A simulated ZED Mini of known truth: start of frames, times of samples, messages, and their
//! arrival.

use std::collections::VecDeque;

use zed::report::{Sample, TICKS_PER_S};

/// Nanoseconds in a second.
pub(crate) const S: f64 = 1e9;
/// Nanoseconds in a millisecond.
pub(crate) const MS: f64 = 1e6;
const TICK_NS: f64 = S / TICKS_PER_S as f64;

/// Minimum latency from the start of a frame to the driver's timestamp: not observable by any
/// method, and not counted against any.
pub(crate) const STAMP_LATENCY: f64 = 2.0 * MS;
/// Minimum latency from a measurement to the host.
const REPORT_LATENCY: f64 = 0.6 * MS;
/// From the beginning of a frame to its last byte.
const FRAME_LATENCY: f64 = 14.0 * MS;
/// Period and duration of bursts, s.
const BURST_S: (f64, f64) = (10.0, 1.0);
/// Mean duration of a busy period of the processor.
const BUSY_NS: f64 = 8.0 * MS;
/// Amplitude and period of the device clock's temperature drift.
const SWING: (f64, f64) = (1e-6, 900.0 * S);
/// Frames counted by the microcontroller before the stream started.
const COUNTED: u32 = 421;

/// A camera, its IMU, and their transport to the host.
#[derive(Clone, Debug)]
pub(crate) struct World {
    pub(crate) seed: u64,
    pub(crate) seconds: f64,
    pub(crate) imu_hz: f64,
    pub(crate) frame_hz: f64,
    /// Uptime of the device at the start.
    pub(crate) uptime_s: f64,
    /// Mean wake-up delay of the IMU's reader, ns; it then reads all pending reports.
    pub(crate) reader_jitter: f64,
    /// Delay of all reports in a burst, ns.
    pub(crate) burst: f64,
    /// Ratio of time in which the processor is busy otherwise.
    pub(crate) load: f64,
    /// Mean delay of the driver's timestamps, ns.
    pub(crate) stamp_jitter: f64,
    /// Mean delay of reading frames from the driver, ns.
    pub(crate) frame_jitter: f64,
}

/// A frame as it arrives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    pub(crate) sequence: u32,
    pub(crate) kernel_ns: i64,
    pub(crate) host_ns: i64,
}

/// A sample as it arrives, and its true time, ns.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrival {
    pub(crate) sample: Sample,
    pub(crate) host_ns: i64,
    pub(crate) taken: f64,
}

/// Next event at the host.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Event {
    Frame(Frame),
    Sample(Arrival),
}

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    /// Uniform in (0, 1].
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (((z ^ (z >> 31)) >> 11) as f64 + 1.0) / (1_u64 << 53) as f64
    }

    fn late(&mut self, mean: f64) -> f64 {
        -mean * self.uniform().ln()
    }
}

impl World {
    /// An hour of uptime, 800 Hz and 30 frames per second; a reader that is 5 ms late on average.
    pub(crate) fn new(seed: u64, seconds: f64) -> Self {
        Self {
            seed,
            seconds,
            imu_hz: 800.0,
            frame_hz: 30.0,
            uptime_s: 3600.0,
            reader_jitter: 5.0 * MS,
            burst: 0.0,
            load: 0.0,
            stamp_jitter: 0.1 * MS,
            frame_jitter: 0.5 * MS,
        }
    }

    /// Passes all events to `tell` in the host's order. Times are ns of the host, from 0.
    pub(crate) fn run(&self, tell: &mut dyn FnMut(Event)) {
        let mut random = Random(self.seed);
        // Each crystal has a rate error of up to 50 ppm.
        let mut off = || 1e-4 * (random.uniform() - 0.5);
        let (device_off, frame_off) = (off(), off());
        let phase = 0.2 * S + random.uniform() * S / self.frame_hz;
        let begun = |k: u32| phase + f64::from(k) * S / self.frame_hz * (1.0 + frame_off);
        // Host time of a device time since the start; the drift is slow, so that one iteration
        // suffices.
        let swing = |t: f64| {
            SWING.0 * SWING.1 / std::f64::consts::TAU * (t / SWING.1 * std::f64::consts::TAU).sin()
        };
        let taken_at = |run: f64| {
            let first = run / (1.0 + device_off);
            (run - swing(first)) / (1.0 + device_off)
        };
        let uptime_ticks = (self.uptime_s * TICKS_PER_S as f64) as u64;

        let mut frame = 0_u32;
        // Frames in transit; they arrive in order.
        let mut coming: VecDeque<(f64, Frame)> = VecDeque::new();
        let mut last_frame = 0.0_f64;
        // Until when the reader is asleep, and the processor busy or free.
        let (mut awake, mut busy_until, mut free_until) = (0.0_f64, 0.0_f64, 0.0_f64);
        for k in 0.. {
            let ticks = (k as f64 * TICKS_PER_S as f64 / self.imu_hz).round() as u64;
            let taken = taken_at(ticks as f64 * TICK_NS);
            if taken > self.seconds * S {
                return;
            }
            let before = frame;
            while begun(frame) <= taken {
                let begin = begun(frame);
                let busy = self.load > 0.0 && begin < busy_until;
                // An interrupt is late only while another is served; taking the frame waits for the
                // processor.
                let stamp = STAMP_LATENCY
                    + random.late(self.stamp_jitter + if busy { 0.3 * MS } else { 0.0 });
                let mut host = begin + FRAME_LATENCY.max(stamp) + random.late(self.frame_jitter);
                if busy {
                    host += random.late(BUSY_NS);
                }
                host = host.max(last_frame);
                last_frame = host;
                coming.push_back((
                    host,
                    Frame {
                        sequence: frame,
                        kernel_ns: (begin + stamp) as i64,
                        host_ns: host as i64,
                    },
                ));
                frame += 1;
            }
            let mut there = taken + REPORT_LATENCY;
            if taken / S % BURST_S.0 < BURST_S.1 {
                there += self.burst;
            }
            if self.load > 0.0 && there >= free_until {
                busy_until = free_until + random.late(BUSY_NS);
                free_until = busy_until + random.late(BUSY_NS * (1.0 - self.load) / self.load);
            }
            if there > awake {
                awake = there + random.late(self.reader_jitter);
                if self.load > 0.0 && awake < busy_until {
                    awake = busy_until;
                }
            }
            while coming.front().is_some_and(|(host, _)| *host <= awake)
                && let Some((_, frame)) = coming.pop_front()
            {
                tell(Event::Frame(frame));
            }
            let sample = Sample {
                valid: true,
                ticks: uptime_ticks + ticks,
                gyro: [0; 3],
                accel: [0; 3],
                frame_sync: frame > before,
                sync_active: true,
                sync_count: COUNTED + frame,
                temperature: 2500,
                magnetic: None,
                environment: None,
                moving_count: 0,
                falling_count: 0,
            };
            tell(Event::Sample(Arrival {
                sample,
                host_ns: awake as i64,
                taken,
            }));
        }
    }
}
