//! The method under test and its peers, behind one interface.

use capture_daemon::sync::clock::{ClockConfig, ClockMapper};
use session_archive::time::{HostTime, TickLength};

use super::world::{LATENCY_NS, Sample, TICK_NS};

/// A time with its stated sigma and flag.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stamp {
    /// ns of host time.
    pub time: f64,
    /// One sigma, where the method knows such a thing.
    pub sigma: Option<f64>,
    pub flagged: bool,
}

/// Ticks in, times out, sample by sample.
pub(crate) trait Method {
    fn name(&self) -> &'static str;

    /// Takes a sample and returns its time immediately.
    fn stamp(&mut self, sample: &Sample) -> Option<Stamp>;

    /// At the end: whether times of samples that arrived then are now flagged as unreliable.
    fn is_unreliable(&self, _arrival: i64) -> bool {
        false
    }

    /// At the end: maps again, if the method can.
    fn again(&self, _ticks: i64, _arrival: i64) -> Option<Stamp> {
        None
    }
}

/// All of them. The peers get two advantages: the mean latency above the minimum, and wide
/// counters, since none of them unwraps.
pub(crate) fn all(mean_latency: f64, bits: Option<u8>) -> Vec<Box<dyn Method>> {
    vec![
        Box::new(Ours::new(bits)),
        Box::new(ArrivalStamps { mean_latency }),
        Box::new(LeastSquares::new(mean_latency)),
        Box::new(ZedOpenCapture::new(mean_latency)),
    ]
}

/// [`ClockMapper`].
pub(crate) struct Ours {
    mapper: ClockMapper,
    bits: Option<u8>,
}

impl Ours {
    pub(crate) fn new(bits: Option<u8>) -> Self {
        let config = ClockConfig {
            tick_bits: bits,
            // From the middle of the tick, as a calibration against known instants finds it: the
            // fastest arrivals are those of samples at the beginning of their ticks.
            latency_ns: LATENCY_NS - (TICK_NS / 2.0) as i64,
            ..ClockConfig::new(TickLength::ZED_MINI)
        };
        Self {
            mapper: ClockMapper::new(config),
            bits,
        }
    }
}

impl Method for Ours {
    fn name(&self) -> &'static str {
        "lower envelope (ours)"
    }

    fn stamp(&mut self, &Sample { ticks, arrival, .. }: &Sample) -> Option<Stamp> {
        self.mapper.observe(ticks, HostTime(arrival));
        let mapped = self.mapper.map(ticks)?;
        Some(Stamp {
            time: mapped.time.ns() as f64,
            sigma: Some(mapped.sigma_ns as f64),
            flagged: mapped.flagged,
        })
    }

    fn is_unreliable(&self, arrival: i64) -> bool {
        self.mapper.is_unreliable(HostTime(arrival))
    }

    fn again(&self, ticks: i64, arrival: i64) -> Option<Stamp> {
        let map = self.mapper.current();
        if self.bits.is_some() || arrival < map.since.ns() {
            return None;
        }
        let mapped = map.map(ticks)?;
        Some(Stamp {
            time: mapped.time.ns() as f64,
            sigma: Some(mapped.sigma_ns as f64),
            flagged: map.is_unreliable(HostTime(arrival)),
        })
    }
}

/// Method of most recorders: the arrival is the time.
pub(crate) struct ArrivalStamps {
    mean_latency: f64,
}

impl Method for ArrivalStamps {
    fn name(&self) -> &'static str {
        "arrival stamps"
    }

    fn stamp(&mut self, sample: &Sample) -> Option<Stamp> {
        let time = (sample.arrival - LATENCY_NS) as f64 - self.mean_latency;
        Some(Stamp {
            time,
            sigma: None,
            flagged: false,
        })
    }
}

/// Ordinary least squares over everything so far.
pub(crate) struct LeastSquares {
    mean_latency: f64,
    origin: Option<(i64, i64)>,
    n: f64,
    mean_x: f64,
    mean_y: f64,
    xx: f64,
    xy: f64,
}

impl LeastSquares {
    fn new(mean_latency: f64) -> Self {
        Self {
            mean_latency,
            origin: None,
            n: 0.0,
            mean_x: 0.0,
            mean_y: 0.0,
            xx: 0.0,
            xy: 0.0,
        }
    }
}

impl Method for LeastSquares {
    fn name(&self) -> &'static str {
        "least squares"
    }

    fn stamp(
        &mut self,
        &Sample {
            counted: ticks,
            arrival,
            ..
        }: &Sample,
    ) -> Option<Stamp> {
        let (tick0, arrival0) = *self.origin.get_or_insert((ticks, arrival));
        let x = (ticks - tick0) as f64 * TICK_NS;
        let y = (arrival - arrival0) as f64 - x;
        self.n += 1.0;
        let (dx, dy) = (x - self.mean_x, y - self.mean_y);
        self.mean_x += dx / self.n;
        self.mean_y += dy / self.n;
        self.xx += dx * (x - self.mean_x);
        self.xy += dx * (y - self.mean_y);
        let rate = if self.xx > 0.0 && self.n > 2.0 {
            self.xy / self.xx
        } else {
            0.0
        };
        let lag = self.mean_y + rate * (x - self.mean_x);
        let time = (arrival0 - LATENCY_NS) as f64 + x + lag - self.mean_latency;
        Some(Stamp {
            time,
            sigma: None,
            flagged: false,
        })
    }
}

/// The method that zed-open-capture publishes for its IMU, from its description: the first sample's
/// host time is the zero point; of every 50 pairs the host's span over the device's span (of pairs
/// 25 to 49 at first, then 5 to 49) is multiplied into a running scale, kept between 0.8 and 1.2;
/// then the mean difference of three pairs is subtracted from the offset. Integer ticks here; the
/// original's 32-bit floats are not reproduced.
pub(crate) struct ZedOpenCapture {
    mean_latency: f64,
    last_ticks: Option<i64>,
    time: f64,
    scale: f64,
    pairs: Vec<(f64, f64)>,
    first_round: bool,
    offsets: Vec<f64>,
    correct_offset: bool,
}

impl ZedOpenCapture {
    fn new(mean_latency: f64) -> Self {
        Self {
            mean_latency,
            last_ticks: None,
            time: 0.0,
            scale: 1.0,
            pairs: Vec::with_capacity(50),
            first_round: true,
            offsets: Vec::with_capacity(3),
            correct_offset: false,
        }
    }
}

impl Method for ZedOpenCapture {
    fn name(&self) -> &'static str {
        "zed-open-capture's"
    }

    fn stamp(
        &mut self,
        &Sample {
            counted: ticks,
            arrival,
            ..
        }: &Sample,
    ) -> Option<Stamp> {
        match self.last_ticks {
            None => self.time = arrival as f64,
            Some(last) => self.time += (ticks - last) as f64 * TICK_NS * self.scale,
        }
        self.last_ticks = Some(ticks);
        if self.correct_offset {
            self.offsets.push(self.time - arrival as f64);
            if let [a, b, c] = self.offsets[..] {
                self.time -= (a + b + c) / 3.0;
                self.offsets.clear();
                self.correct_offset = false;
            }
        }
        self.pairs.push((arrival as f64, self.time));
        if self.pairs.len() == 50 {
            let from = self.pairs[if self.first_round { 25 } else { 5 }];
            let to = self.pairs[49];
            let factor = (to.0 - from.0) / (to.1 - from.1);
            if factor.is_finite() {
                self.scale *= factor.clamp(0.8, 1.2);
            }
            self.pairs.clear();
            self.first_round = false;
            self.correct_offset = true;
        }
        let time = self.time - LATENCY_NS as f64 - self.mean_latency;
        Some(Stamp {
            time,
            sigma: None,
            flagged: false,
        })
    }
}
