//! A ZED Mini whose truth is known: when frames begin, when samples are taken, what is sent, and when it arrives.

use std::collections::VecDeque;

use zed::report::{Sample, TICKS_PER_S};

/// Nanoseconds in a second.
pub(crate) const S: f64 = 1e9;
/// Nanoseconds in a millisecond.
pub(crate) const MS: f64 = 1e6;
const TICK_NS: f64 = S / TICKS_PER_S as f64;

/// From the beginning of a frame to the driver's stamp at the least: not to be seen by any method, and not held against any.
pub(crate) const STAMP_LATENCY: f64 = 2.0 * MS;
/// From a measurement to the host at the least.
const REPORT_LATENCY: f64 = 0.6 * MS;
/// From the beginning of a frame to its last byte.
const FRAME_LATENCY: f64 = 14.0 * MS;
/// Bursts begin every so often, and last so long, s.
const BURST_S: (f64, f64) = (10.0, 1.0);
/// The processor is busy for so long at a time, on average, when it is busy.
const BUSY_NS: f64 = 8.0 * MS;
/// The device's clock swings by so much with the temperature, in so long.
const SWING: (f64, f64) = (1e-6, 900.0 * S);
/// Frames that the microcontroller was told of before the stream began.
const COUNTED: u32 = 421;

/// A camera, its IMU, and the way from them.
#[derive(Clone, Debug)]
pub(crate) struct World {
    pub(crate) seed: u64,
    pub(crate) seconds: f64,
    pub(crate) imu_hz: f64,
    pub(crate) frame_hz: f64,
    /// The device has been on for so long at the start.
    pub(crate) uptime_s: f64,
    /// The IMU's reader wakes up late by this on average, ns, and then takes all that is there.
    pub(crate) reader_jitter: f64,
    /// All reports are late by this in a burst, ns.
    pub(crate) burst: f64,
    /// Share of time in which the processor is busy with something else.
    pub(crate) load: f64,
    /// The driver's stamps are late by this on average, ns.
    pub(crate) stamp_jitter: f64,
    /// Frames are taken from the driver late by this on average, ns.
    pub(crate) frame_jitter: f64,
}

/// A frame as it arrives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    pub(crate) sequence: u32,
    pub(crate) kernel_ns: i64,
    pub(crate) host_ns: i64,
}

/// A sample as it arrives, and when it was really taken, ns.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrival {
    pub(crate) sample: Sample,
    pub(crate) host_ns: i64,
    pub(crate) taken: f64,
}

/// What the host sees next.
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

    /// Hands over all that the host sees, in its order. Times are ns of the host, from 0.
    pub(crate) fn run(&self, tell: &mut dyn FnMut(Event)) {
        let mut random = Random(self.seed);
        // Each crystal is off by up to 50 ppm.
        let mut off = || 1e-4 * (random.uniform() - 0.5);
        let (device_off, frame_off) = (off(), off());
        let phase = 0.2 * S + random.uniform() * S / self.frame_hz;
        let begun = |k: u32| phase + f64::from(k) * S / self.frame_hz * (1.0 + frame_off);
        // When the device's clock has run so long since the start; its swing is slow, so that one step of iteration does.
        let swing = |t: f64| {
            SWING.0 * SWING.1 / std::f64::consts::TAU * (t / SWING.1 * std::f64::consts::TAU).sin()
        };
        let taken_at = |run: f64| {
            let first = run / (1.0 + device_off);
            (run - swing(first)) / (1.0 + device_off)
        };
        let uptime_ticks = (self.uptime_s * TICKS_PER_S as f64) as u64;

        let mut frame = 0_u32;
        // Frames on their way; they come in their order.
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
                // An interrupt is late only while another is served; taking the frame waits for the processor.
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
