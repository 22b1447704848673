use super::*;

/// SplitMix64 (Steele, Lea and Flood 2014): all randomness of these tests comes from a seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in (0, 1].
    fn uniform(&mut self) -> f64 {
        ((self.next() >> 11) as f64 + 1.0) / (1_u64 << 53) as f64
    }

    fn exponential(&mut self, mean: f64) -> f64 {
        -mean * self.uniform().ln()
    }
}

const S: f64 = 1e9;
const MS: f64 = 1e6;
/// Constant latency of all these devices; configured, so that mapped times can be compared.
const LATENCY: i64 = 2_000_000;

/// A device whose clock the test knows: samples at `rate_hz`, ticks of 1/25600 s.
struct Device {
    random: Random,
    rate_hz: f64,
    jitter: f64,
    ppm: f64,
    /// Device time minus what it would be without steps, ns.
    stepped: f64,
    /// Host time, ns.
    now: f64,
}

/// What happened and what was made of it.
#[derive(Debug)]
struct Verdict {
    arrival: HostTime,
    error: f64,
    sigma: f64,
    flagged: bool,
}

impl Device {
    fn new(seed: u64, rate_hz: f64) -> Self {
        let random = Random(seed);
        Self {
            random,
            rate_hz,
            jitter: MS,
            ppm: 100.0,
            stepped: 0.0,
            now: 5.0 * S,
        }
    }

    /// Tick at the current host time; its true host time; when it arrives.
    fn sample(&mut self) -> (i64, f64, HostTime) {
        let device = (self.now - 3.0 * S) / (1.0 + self.ppm * 1e-6) + self.stepped;
        let ticks = (device * 25_600.0 / S).ceil();
        // The host time at which the counter reached this value.
        let truth = (ticks * S / 25_600.0 - self.stepped) * (1.0 + self.ppm * 1e-6) + 3.0 * S;
        let arrival = truth + LATENCY as f64 + self.random.exponential(self.jitter);
        self.now += S / self.rate_hz;
        (ticks as i64, truth, HostTime(arrival as i64))
    }

    /// Feeds `seconds` of samples; what was reported for each, flags from later news included.
    fn feed(&mut self, mapper: &mut ClockMapper, seconds: f64) -> Vec<Verdict> {
        let end = self.now + seconds * S;
        let mut verdicts: Vec<Verdict> = Vec::new();
        while self.now < end {
            let (ticks, truth, arrival) = self.sample();
            verdicts.extend(judge(mapper, ticks, truth, arrival));
        }
        for v in &mut verdicts {
            v.flagged |= mapper.snapshot().is_doubtful(v.arrival);
        }
        verdicts
    }
}

fn judge(mapper: &mut ClockMapper, ticks: i64, truth: f64, arrival: HostTime) -> Option<Verdict> {
    mapper.observe(ticks, arrival);
    let mapped = mapper.map(ticks)?;
    Some(Verdict {
        arrival,
        error: mapped.time.ns() as f64 - truth,
        sigma: mapped.sigma_ns as f64,
        flagged: mapped.flagged,
    })
}

fn mapper() -> ClockMapper {
    ClockMapper::new(ClockConfig {
        latency_ns: LATENCY,
        ..ClockConfig::new(TickLength::ZED_MINI)
    })
}

fn quantile(verdicts: &[Verdict], share: f64) -> f64 {
    let mut errors: Vec<f64> = verdicts
        .iter()
        .filter(|v| !v.flagged)
        .map(|v| v.error.abs())
        .collect();
    errors.sort_by(f64::total_cmp);
    errors[((errors.len() - 1) as f64 * share) as usize]
}

#[track_caller]
fn none_silently_wrong(verdicts: &[Verdict]) {
    for (i, v) in verdicts.iter().enumerate() {
        let wrong = v.error.abs() > 5.0 * v.sigma && !v.flagged;
        assert!(!wrong, "sample {i} of {}: {v:?}", verdicts.len());
    }
}

#[test]
fn p99_is_under_a_tenth_of_a_millisecond_after_ten_seconds() {
    for rate_hz in [30.0, 400.0] {
        for seed in 0..20 {
            let (mut device, mut mapper) = (Device::new(seed, rate_hz), mapper());
            let early = device.feed(&mut mapper, 10.0);
            let later = device.feed(&mut mapper, 10.0);
            none_silently_wrong(&early);
            none_silently_wrong(&later);
            let p99 = quantile(&later, 0.99);
            println!(
                "{rate_hz} Hz seed {seed}: median {:.1} us, p99 {:.1} us, sigma {:.1} us, version {}",
                quantile(&later, 0.5) / 1e3,
                p99 / 1e3,
                later[later.len() - 1].sigma / 1e3,
                mapper.version(),
            );
            assert!(p99 < 0.1 * MS, "{rate_hz} Hz, seed {seed}: {p99} ns");
        }
    }
}
