//! Devices of known clocks: ticks, arrivals and ground truth, generated from a seed.

/// Nanoseconds in a second.
pub(crate) const S: f64 = 1e9;
/// Nanoseconds in a millisecond.
pub(crate) const MS: f64 = 1e6;
/// Nanoseconds in a microsecond.
pub(crate) const US: f64 = 1e3;

/// Length of a tick, ns: the ZED Mini's 1/25600 s.
pub(crate) const TICK_NS: f64 = 39_062.5;
/// Minimum latency of all devices. Every method is given it, as by calibration.
pub(crate) const LATENCY_NS: i64 = 2_000_000;
/// Host time at which a device begins to send.
const START: f64 = 60.0 * S;
/// Time before that at which its counter started.
const UPTIME: f64 = 1000.0 * S;

/// SplitMix64 (Steele, Lea and Flood 2014).
#[derive(Clone)]
pub(crate) struct Random(pub(crate) u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in (0, 1].
    pub(crate) fn uniform(&mut self) -> f64 {
        ((self.next() >> 11) as f64 + 1.0) / (1_u64 << 53) as f64
    }

    pub(crate) fn normal(&mut self) -> f64 {
        let (a, b) = (self.uniform(), self.uniform());
        (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }
}

/// Distribution of latencies above the minimum; the strength is their mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Shape {
    /// Queueing.
    Exponential,
    /// Polling: from 0 to twice the mean.
    Uniform,
    /// Normal around its most frequent value, cut off one standard deviation below it.
    Truncated,
    /// Pareto of the second kind with tail exponent 2.5: infinite variance is near.
    Heavy,
    /// Sum of two exponentials: the least latency itself never occurs.
    Gamma,
    /// Log-normal, sigma 1: latencies near the least one practically never occur.
    LogNormal,
}

impl Shape {
    pub(crate) const ALL: [Self; 6] = [
        Self::Exponential,
        Self::Uniform,
        Self::Truncated,
        Self::Heavy,
        Self::Gamma,
        Self::LogNormal,
    ];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Exponential => "exponential",
            Self::Uniform => "uniform",
            Self::Truncated => "truncated normal",
            Self::Heavy => "heavy tail",
            Self::Gamma => "gamma(2)",
            Self::LogNormal => "log-normal",
        }
    }

    fn draw(self, random: &mut Random, mean: f64) -> f64 {
        match self {
            Self::Exponential => -mean * random.uniform().ln(),
            Self::Uniform => 2.0 * mean * random.uniform(),
            Self::Truncated => loop {
                // Mean of 1 + z given z > -1 is 1.2876.
                let value = 1.0 + random.normal();
                if value > 0.0 {
                    return mean * value / 1.2876;
                }
            },
            Self::Heavy => mean * 1.5 * (random.uniform().powf(-1.0 / 2.5) - 1.0),
            Self::Gamma => -0.5 * mean * (random.uniform() * random.uniform()).ln(),
            Self::LogNormal => mean * (random.normal() - 0.5).exp(),
        }
    }
}

/// Faults of a device and of its transport.
#[derive(Clone, Debug)]
pub(crate) struct World {
    pub seed: u64,
    pub rate_hz: f64,
    pub seconds: f64,
    pub shape: Shape,
    /// Mean latency above the minimum, ns.
    pub jitter: f64,
    /// Device clock's rate error, parts in 1e6.
    pub drift_ppm: f64,
    /// The rate swings by ± this, as by temperature …
    pub swing_ppm: f64,
    /// … once in this time, s.
    pub swing_s: f64,
    /// Share of samples that never arrive.
    pub lost: f64,
    /// Share of samples that arrive twice.
    pub doubled: f64,
    /// Share of samples that arrive after the next one.
    pub overtaken: f64,
    /// Share of samples with a wrong tick.
    pub corrupt: f64,
    /// Bursts of late arrivals: their mean distance and length, s, and how late, ns.
    pub bursts: Option<(f64, f64, f64)>,
    /// At these seconds the device clock leaps by this many ns.
    pub steps: Vec<(f64, f64)>,
    /// At this second the counter begins at 0.
    pub restart: Option<f64>,
    /// Width of the counter.
    pub bits: Option<u8>,
}

impl World {
    pub(crate) fn new(seed: u64, rate_hz: f64, seconds: f64) -> Self {
        Self {
            seed,
            rate_hz,
            seconds,
            shape: Shape::Exponential,
            jitter: MS,
            drift_ppm: 100.0,
            swing_ppm: 0.0,
            swing_s: 300.0,
            lost: 0.0,
            doubled: 0.0,
            overtaken: 0.0,
            corrupt: 0.0,
            bursts: None,
            steps: Vec::new(),
            restart: None,
            bits: None,
        }
    }

    /// Everything that arrives, in the order of arrival at the reader.
    pub(crate) fn samples(&self) -> Vec<Sample> {
        let mut random = Random(self.seed.wrapping_mul(0x5851_f42d_4c95_7f2d) ^ 0x1405);
        let count = (self.seconds * self.rate_hz) as usize;
        let mut samples = Vec::with_capacity(count);
        let mut burst_from = f64::INFINITY;
        let mut burst_to = 0.0;
        if let Some((every, _, _)) = self.bursts {
            burst_from = 10.0 - every * random.uniform().ln();
        }
        let swing_rad = std::f64::consts::TAU / self.swing_s;
        for i in 0..count {
            // The device is not paced by the host: a phase that wanders over all ticks.
            let t = (i as f64 + 0.02 * random.uniform()) / self.rate_hz;
            let wobble = self.swing_ppm * 1e-6 / swing_rad * (1.0 - (swing_rad * t).cos()) * S;
            let stepped: f64 = self.steps.iter().filter(|s| s.0 <= t).map(|s| s.1).sum();
            let device = UPTIME + t * S * (1.0 - self.drift_ppm * 1e-6) - wobble + stepped;
            let since = match self.restart {
                Some(at) if t >= at => UPTIME + at * S * (1.0 - self.drift_ppm * 1e-6) - 1e8,
                _ => 0.0,
            };
            let counter = ((device - since) / TICK_NS).floor();
            let taken = START + t * S;
            let mut late = self.shape.draw(&mut random, self.jitter);
            if let Some((every, length, height)) = self.bursts {
                if t >= burst_from {
                    burst_to = t + length * (0.5 + random.uniform());
                    burst_from = burst_to - every * random.uniform().ln();
                }
                if t < burst_to {
                    late += height * (0.5 + random.uniform());
                }
            }
            let [lost, doubled, overtaken, corrupt, by] = std::array::from_fn(|_| random.uniform());
            if lost <= self.lost {
                continue;
            }
            let mut counted = counter as i64;
            if corrupt <= self.corrupt {
                counted += ((by + (by - 0.5).signum()) * 1e6) as i64;
            }
            let mut ticks = counted;
            if let Some(bits) = self.bits {
                ticks &= (1 << bits) - 1;
            }
            let arrival = (taken + LATENCY_NS as f64 + late).round() as i64;
            let sample = Sample {
                ticks,
                counted,
                taken,
                arrival,
                corrupt: corrupt <= self.corrupt,
            };
            if overtaken <= self.overtaken && samples.len() > 1 {
                let before = samples.len() - 1;
                samples.insert(before, sample);
            } else {
                samples.push(sample);
            }
            if doubled <= self.doubled {
                samples.push(Sample {
                    arrival: arrival + (MS * by) as i64,
                    ..sample
                });
            }
        }
        // Samples wait for earlier ones, as on a bus, except those that overtake.
        let mut newest = i64::MIN;
        for sample in samples.iter_mut().filter(|_| self.overtaken == 0.0) {
            newest = newest.max(sample.arrival);
            sample.arrival = newest;
        }
        samples
    }
}

/// One sample as it arrives, and the truth about it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    /// As the device delivers it.
    pub ticks: i64,
    /// The same without wraps.
    pub counted: i64,
    /// Host time at which the sample was taken, ns: less than a tick after the counter reached
    /// `ticks`.
    pub taken: f64,
    /// Host time at which it was read, ns.
    pub arrival: i64,
    /// The tick is wrong; its true time cannot be recovered.
    pub corrupt: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_arrive_after_they_are_taken_at_any_phase_of_their_ticks() {
        let world = World {
            drift_ppm: 0.0,
            ..World::new(1, 400.0, 20.0)
        };
        let samples = world.samples();
        let within: Vec<f64> = samples
            .iter()
            .map(|s| s.taken - START + UPTIME - s.counted as f64 * TICK_NS)
            .collect();
        for (s, within) in samples.iter().zip(&within) {
            assert!((-1.0..TICK_NS + 1.0).contains(within), "{s:?}");
            let late = s.arrival as f64 - s.taken;
            assert!(late >= LATENCY_NS as f64 - 1.0, "{s:?}");
        }
        for tenth in 0..10 {
            let part = f64::from(tenth) * TICK_NS / 10.0;
            let here = within
                .iter()
                .filter(|w| (part..part + TICK_NS / 10.0).contains(w));
            assert!(here.count() > within.len() / 20, "tenth {tenth}");
        }
    }
}
