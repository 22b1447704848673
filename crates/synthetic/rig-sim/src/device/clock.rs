//! Clock of a simulated device.
//!
//! Contract: the clock has its own rate and offset; planned steps and drifts are added. The
//! sampling rate of an IMU follows the undisturbed oscillator.

use session_archive::time::TickLength;

use crate::faults::{CameraFaults, Fault, Kind};

/// Camera timestamps are in microseconds, as with USB video drivers.
pub(crate) const CAMERA_TICK: TickLength = TickLength { num: 1000, den: 1 };
/// The ZED Mini's IMU counts 1/25600 s.
pub const IMU_TICK: TickLength = TickLength::ZED_MINI;
/// Width of counters that wrap, bits.
const WRAP_BITS: u8 = 32;
/// Clock value of a device after reconnecting, ns.
const BOOT_NS: f64 = 1e9;

/// Clock of a simulated device; see the module documentation.
#[derive(Clone, Debug)]
pub struct DeviceClock {
    tick: TickLength,
    start_ns: i64,
    rate_error_ppm: f64,
    steps: Vec<Fault>,
    drifts: Vec<Fault>,
    /// Offset added to ticks, which are then reduced to [`WRAP_BITS`].
    wrap: Option<i64>,
}

impl DeviceClock {
    /// A clock that shows `start_ns` at the beginning of the walk and runs `rate_error_ppm` too
    /// fast.
    pub fn new(
        tick: TickLength,
        start_ns: i64,
        rate_error_ppm: f64,
        faults: &CameraFaults,
    ) -> Self {
        let of = |kind| faults.of_kind(kind).cloned().collect::<Vec<_>>();
        let mut clock = Self {
            tick,
            start_ns,
            rate_error_ppm,
            steps: of(Kind::ClockStep),
            drifts: of(Kind::ClockDrift),
            wrap: None,
        };
        let wraps = of(Kind::TickWrap);
        let first = wraps.iter().map(|f| (f.from_s * 1e9) as i64).min();
        clock.wrap = first.map(|at_ns| (1 << WRAP_BITS) - clock.ticks(at_ns));
        clock
    }

    /// Length of a tick.
    pub fn tick(&self) -> TickLength {
        self.tick
    }

    /// Width of the counter if it wraps, bits.
    pub fn tick_bits(&self) -> Option<u8> {
        self.wrap.map(|_| WRAP_BITS)
    }

    /// Rate of true time relative to the undisturbed clock, minus one, parts per billion.
    pub(crate) fn host_rate_ppb(&self) -> f64 {
        (1.0 / (1.0 + self.rate_error_ppm * 1e-6) - 1.0) * 1e9
    }

    /// Clock value at a time, ns since the beginning of the walk; ticks.
    pub fn ticks(&self, time_ns: i64) -> i64 {
        self.counted(self.start_ns as f64 + self.run(time_ns))
    }

    /// Clock value at a time if the device connected at `on_ns`; ticks.
    pub(crate) fn ticks_since(&self, on_ns: i64, time_ns: i64) -> i64 {
        self.counted(BOOT_NS + self.run(time_ns) - self.run(on_ns))
    }

    /// True time of sample `n` at `rate_hz` of the device's own seconds, ns since the beginning of
    /// the walk.
    pub fn taken_ns(&self, n: u64, rate_hz: f64) -> i64 {
        (n as f64 / rate_hz / (1.0 + self.rate_error_ppm * 1e-6) * 1e9).round() as i64
    }

    /// Elapsed clock time since the beginning of the walk, ns.
    fn run(&self, time_ns: i64) -> f64 {
        let time_s = time_ns as f64 * 1e-9;
        let drifted: f64 = self
            .drifts
            .iter()
            .map(|f| 1e3 * f.strength * f.acted_s(time_s))
            .sum();
        let stepped: f64 = self
            .steps
            .iter()
            .filter(|f| f.from_s <= time_s)
            .map(|f| 1e9 * f.strength)
            .sum();
        time_ns as f64 * (1.0 + self.rate_error_ppm * 1e-6) + drifted + stepped
    }

    fn counted(&self, shown_ns: f64) -> i64 {
        let TickLength { num, den } = self.tick;
        let ticks = i128::from(shown_ns as i64) * i128::from(den);
        let ticks = ticks.div_euclid(i128::from(num)) as i64;
        match self.wrap {
            Some(offset) => (ticks + offset) & ((1 << WRAP_BITS) - 1),
            None => ticks,
        }
    }
}
