use proptest::prelude::*;

use super::publication::MAX_UNRELIABLE_SPANS;
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
/// Constant latency of all devices here; configured, so that mapped times can be compared.
const LATENCY: i64 = 2_000_000;

/// A device with a known clock: ticks of 1/25600 s, a crystal with an error of 100 ppm, 1 ms of
/// exponential jitter.
struct Device {
    random: Random,
    rate_hz: f64,
    ppm: f64,
    /// Latency beyond the minimum and the jitter, ns: a burst.
    late: f64,
    /// Sum of the steps of the device clock, ns.
    leapt: f64,
    bits: Option<u8>,
    /// Host time, ns.
    now: f64,
    mapper: ClockMapper,
    steps: Vec<Step>,
}

/// Result for a sample, with the ground truth.
#[derive(Clone, Copy, Debug)]
struct Verdict {
    ticks: i64,
    arrival: HostTime,
    truth: f64,
    time: HostTime,
    sigma: f64,
    flagged: bool,
}

impl Verdict {
    fn error(&self) -> f64 {
        (self.time.ns() as f64 - self.truth).abs()
    }
}

impl Device {
    fn new(seed: u64, rate_hz: f64) -> Self {
        let config = ClockConfig {
            latency_ns: LATENCY,
            ..ClockConfig::new(TickLength::ZED_MINI)
        };
        Self {
            random: Random(seed),
            rate_hz,
            ppm: 100.0,
            late: 0.0,
            leapt: 0.0,
            bits: None,
            now: 5000.0 * S,
            mapper: ClockMapper::new(config),
            steps: Vec::new(),
        }
    }

    fn wrapping(mut self, bits: u8) -> Self {
        let config = ClockConfig {
            tick_bits: Some(bits),
            ..self.mapper.config
        };
        self.mapper = ClockMapper::new(config);
        self.bits = Some(bits);
        self
    }

    /// The next sample: its tick, the time at which the counter reached it, its arrival.
    fn sample(&mut self) -> (i64, f64, HostTime) {
        let device = (self.now - 3.0 * S) / (1.0 + self.ppm * 1e-6) + self.leapt;
        let ticks = (device * 25_600.0 / S).ceil();
        let truth = (ticks * S / 25_600.0 - self.leapt) * (1.0 + self.ppm * 1e-6) + 3.0 * S;
        let arrival = truth + LATENCY as f64 + self.late + self.random.exponential(MS);
        self.now += S / self.rate_hz;
        let turn = self.bits.map_or(i64::MAX, |bits| (1 << bits) - 1);
        (ticks as i64 & turn, truth, HostTime(arrival as i64))
    }

    fn give(&mut self, ticks: i64, truth: f64, arrival: HostTime) -> Option<Verdict> {
        if let Observation::Step(step) = self.mapper.observe(ticks, arrival) {
            self.steps.push(step);
        }
        let mapped = self.mapper.map(ticks)?;
        Some(Verdict {
            ticks,
            arrival,
            truth,
            time: mapped.time,
            sigma: without_granularity(mapped.sigma_ns),
            flagged: mapped.flagged,
        })
    }

    /// Some seconds of samples, with flags from later updates.
    fn run(&mut self, seconds: f64) -> Vec<Verdict> {
        let end = self.now + seconds * S;
        let mut verdicts = Vec::new();
        while self.now < end {
            let (ticks, truth, arrival) = self.sample();
            verdicts.extend(self.give(ticks, truth, arrival));
        }
        verdicts
    }

    /// No sample, with flags from later updates, may be silently wrong; then the map must be
    /// settled.
    #[track_caller]
    fn assert_consistent_and_settled(&mut self, mut verdicts: Vec<Verdict>) {
        verdicts.extend(self.run(15.0));
        for (i, v) in verdicts.iter().enumerate() {
            let flagged = v.flagged || self.mapper.is_unreliable(v.arrival);
            let wrong = v.error() > 5.0 * v.sigma;
            let of = verdicts.len();
            assert!(
                !wrong || flagged,
                "sample {i} of {of}, error {}: {v:?}",
                v.error()
            );
        }
        let after = self.run(5.0);
        assert!(quantile(&after, 0.99) < 0.1 * MS);
        assert!(after.iter().filter(|v| v.flagged).count() * 20 < after.len());
    }
}

/// The map's own sigma: here the ground truth is that of the tick, not of an instant within it.
fn without_granularity(sigma_ns: u64) -> f64 {
    let tick = S / 25_600.0;
    ((sigma_ns as f64).powi(2) - tick * tick / 12.0)
        .max(1.0)
        .sqrt()
}

fn quantile(verdicts: &[Verdict], share: f64) -> f64 {
    let mut errors: Vec<f64> = verdicts.iter().map(Verdict::error).collect();
    errors.sort_by(f64::total_cmp);
    errors[((errors.len() - 1) as f64 * share) as usize]
}

const RATES: [f64; 2] = [30.0, 400.0];

/// A short excerpt of the full test in `bench`.
#[test]
fn p99_error_is_below_100_us_after_ten_seconds() {
    for rate_hz in RATES {
        for seed in 0..8 {
            let mut device = Device::new(seed, rate_hz);
            let early = device.run(10.0);
            let later = device.run(10.0);
            let p99 = quantile(&later, 0.99);
            assert!(p99 < 0.1 * MS, "{rate_hz} Hz, seed {seed}: {p99} ns");
            let within = later.iter().filter(|v| v.error() <= v.sigma).count();
            assert!(
                within * 10 >= later.len() * 9,
                "{within} of {}",
                later.len()
            );
            let sigma = later[later.len() - 1].sigma;
            // Rare fast arrivals must be detected, which gives all others a wide sigma.
            assert!(sigma < 0.15 * MS, "a sigma of {sigma} ns says nothing");
            device.assert_consistent_and_settled([early, later].concat());
            assert!(device.steps.is_empty());
        }
    }
}

#[test]
fn map_is_consistent_from_the_first_sample() {
    for seed in 0..50 {
        let mut device = Device::new(seed, 30.0);
        assert_eq!(device.mapper.map(0), None);
        assert_eq!(device.mapper.version(), 0);
        let first = device.run(2.0);
        assert!(first[0].flagged && first[0].sigma >= 5.0 * MS);
        for v in &first {
            assert!(v.error() <= 5.0 * v.sigma, "{v:?}");
            assert!(v.time.ns() <= v.arrival.ns() - LATENCY);
        }
    }
}

#[test]
fn steps_of_either_sign_are_flagged_until_a_new_line_settles() {
    for rate_hz in RATES {
        for leap in [-1000.0, -1.0, -0.02, -0.003, 0.003, 0.02, 1.0, 1000.0] {
            let mut device = Device::new(7, rate_hz);
            let mut verdicts = device.run(20.0);
            device.leapt = leap * S;
            verdicts.extend(device.run(15.0));
            device.assert_consistent_and_settled(verdicts);
            let [step] = device.steps[..] else {
                panic!("{leap} s at {rate_hz} Hz: {:?}", device.steps)
            };
            let off = (step.shift_ns as f64 + leap * S).abs();
            assert!(off < 20.0 * MS + 2e-4 * leap.abs() * S, "{step:?}");
            assert_eq!(device.mapper.current().epoch, 1);
        }
    }
}

/// Whatever the minimum latency, it is no hour.
#[test]
fn large_step_is_detected_before_the_first_line_settles() {
    for rate_hz in RATES {
        for leap in [-3600.0, -10.0, 10.0, 3600.0] {
            let mut device = Device::new(9, rate_hz);
            let mut verdicts = device.run(1.0);
            device.leapt = leap * S;
            verdicts.extend(device.run(15.0));
            device.assert_consistent_and_settled(verdicts);
            assert_eq!(device.steps.len(), 1, "{leap} s at {rate_hz} Hz");
        }
    }
}

/// A step among samples that were all late and arrived together: nobody can decide which of them
/// came before it.
#[test]
fn step_within_a_burst_makes_the_whole_burst_unreliable() {
    for (rate_hz, leap) in [(30.0, 0.7), (30.0, 0.3), (400.0, 0.7), (400.0, 0.3)] {
        let mut device = Device::new(10, rate_hz);
        let mut verdicts = device.run(20.0);
        let mut burst = Vec::new();
        let count = (1.2 * rate_hz) as usize;
        for n in 0..count {
            if n == count / 2 {
                device.leapt = leap * S;
            }
            burst.push(device.sample());
        }
        let latest = burst.iter().map(|h| h.2).max().unwrap();
        for (ticks, truth, _) in burst {
            verdicts.extend(device.give(ticks, truth, latest));
        }
        verdicts.extend(device.run(20.0));
        device.assert_consistent_and_settled(verdicts);
        assert!(!device.steps.is_empty(), "{leap}");
    }
}

#[test]
fn restarted_counter_is_a_step() {
    for rate_hz in RATES {
        let mut device = Device::new(3, rate_hz);
        let mut verdicts = device.run(20.0);
        device.leapt = 3.0 * S - device.now;
        verdicts.extend(device.run(1.0));
        device.assert_consistent_and_settled(verdicts);
        assert_eq!(device.steps.len(), 1);
        assert!(device.mapper.current().segments[0].ticks_from < 25_600);
    }
}

#[test]
fn times_after_a_counter_restart_are_not_hours_wrong() {
    for uptime in [-3600.0, 3600.0] {
        let mut device = Device::new(5, 30.0);
        device.run(20.0);
        device.leapt = uptime * S;
        let mut verdicts = device.run(0.3);
        for v in &verdicts {
            assert!(v.flagged && v.error() < 0.1 * S, "{uptime}: {v:?}");
        }
        verdicts.clear();
        device.assert_consistent_and_settled(verdicts);
    }
}

#[test]
fn stopped_clock_is_flagged() {
    let mut device = Device::new(6, 30.0);
    device.run(20.0);
    let (stuck, ..) = device.sample();
    for n in 0..300 {
        let (_, truth, arrival) = device.sample();
        let verdict = device.give(stuck, truth, arrival).unwrap();
        // Within the first few the samples may also have been late.
        assert!(
            verdict.flagged || verdict.error() < 5.0 * verdict.sigma || n < 2,
            "{n}: {verdict:?}"
        );
        assert!(verdict.error() < 6.0 * S, "{n}: {verdict:?}");
    }
    // The clock continues from its last reading.
    device.leapt -= 301.0 / 30.0 * S;
    device.assert_consistent_and_settled(Vec::new());
}

#[test]
fn burst_of_late_arrivals_is_no_step() {
    for rate_hz in RATES {
        let mut device = Device::new(5, rate_hz);
        let mut verdicts = device.run(20.0);
        let version_before = device.mapper.current().epoch;
        for _ in 0..3 {
            device.late = 15.0 * MS;
            let burst = device.run(2.0);
            device.late = 0.0;
            assert!(quantile(&burst, 1.0) < 0.1 * MS, "the old line still holds");
            assert!(
                burst[burst.len() / 2..]
                    .iter()
                    .all(|v| v.flagged && v.sigma > 10.0 * MS)
            );
            verdicts.extend(burst);
            verdicts.extend(device.run(3.0));
        }
        device.assert_consistent_and_settled(verdicts);
        assert_eq!(device.mapper.current().epoch, version_before);
    }
}

#[test]
fn silence_increases_sigma_only() {
    let mut device = Device::new(11, 30.0);
    let before = device.run(20.0);
    device.now += 600.0 * S;
    let after = device.run(0.1);
    assert!(after[0].sigma > 3.0 * before[before.len() - 1].sigma);
    device.assert_consistent_and_settled([before, after].concat());
    assert!(device.steps.is_empty());
}

#[test]
fn lost_repeated_reordered_and_wrong_ticks_are_tolerated() {
    for rate_hz in RATES {
        let mut device = Device::new(13, rate_hz);
        let mut verdicts = device.run(10.0);
        let end = device.now + 20.0 * S;
        while device.now < end {
            let (ticks, truth, arrival) = device.sample();
            match device.random.next() % 40 {
                0..10 => {}
                10..12 => {
                    verdicts.extend(device.give(ticks, truth, arrival));
                    let before = device.mapper.current().clone();
                    let again = device.mapper.observe(ticks, arrival + 1_000_000);
                    assert_eq!(again, Observation::Duplicate);
                    assert_eq!(device.mapper.current(), &before);
                }
                12..14 => {
                    let (ticks_next, truth_next, _) = device.sample();
                    verdicts.extend(device.give(ticks_next, truth_next, arrival + 50_000_000));
                    verdicts.extend(device.give(ticks, truth, arrival + 50_000_000));
                }
                14 => {
                    let wrong = ticks + 25_600 * (device.random.next() % 2000) as i64 - 25_600_000;
                    device.mapper.observe(wrong, arrival);
                    assert!(device.mapper.map(wrong).is_some_and(|m| m.flagged));
                }
                _ => verdicts.extend(device.give(ticks, truth, arrival)),
            }
        }
        device.assert_consistent_and_settled(verdicts);
        assert!(device.steps.is_empty());
    }
}

#[test]
fn narrow_counter_wraps_transparently() {
    // 2^15 ticks are 1.28 s.
    let mut narrow = Device::new(17, 30.0).wrapping(15);
    let mut wide = Device::new(17, 30.0);
    for (a, b) in narrow.run(30.0).iter().zip(wide.run(30.0)) {
        assert_eq!((a.time, a.sigma, a.flagged), (b.time, b.sigma, b.flagged));
        assert_eq!(narrow.mapper.ticks(a.ticks) & 0x7fff, b.ticks & 0x7fff);
    }
    assert!(narrow.steps.is_empty());
}

#[test]
fn model_has_only_parameters_the_samples_support() {
    for seed in 0..5 {
        let mut still = Device {
            ppm: 0.0,
            ..Device::new(seed, 400.0)
        };
        still.run(30.0);
        assert_eq!(still.mapper.current().model, Model::Constant, "seed {seed}");
        assert_eq!(still.mapper.current().segments[0].rate_ppb, 0.0);

        let mut steady = Device::new(seed, 400.0);
        steady.run(0.1);
        assert_eq!(
            steady.mapper.current().model,
            Model::Constant,
            "not yet visible"
        );
        steady.run(30.0);
        let map = steady.mapper.snapshot();
        assert_eq!(
            (map.model, map.segments.len()),
            (Model::Affine, 1),
            "seed {seed}"
        );
        assert!((map.segments[0].rate_ppb - 1e5).abs() < 1e3);
        assert!(
            (600_000..900_000).contains(&map.residuals.median_ns),
            "{:?}",
            map.residuals
        );

        // The device warms up: its rate changes by 30 ppm within half a minute.
        for _ in 0..300 {
            steady.ppm -= 0.1;
            // The clock has no step where its rate changes.
            steady.leapt -= (steady.now - 3.0 * S) * 1e-7;
            steady.run(0.1);
        }
        steady.run(30.0);
        let map = steady.mapper.snapshot();
        assert_eq!(map.model, Model::Piecewise, "seed {seed}");
        assert!(
            (3..100).contains(&map.segments.len()),
            "{}",
            map.segments.len()
        );
    }
}

#[test]
fn stored_map_equals_its_mapper_and_is_monotonic() {
    let mut device = Device::new(23, 30.0);
    let first = device.sample();
    device.give(first.0, first.1, first.2);
    for _ in 0..60 {
        device.ppm += 0.5;
        device.leapt += (device.now - 3.0 * S) * 5e-7;
        device.run(2.0);
    }
    let map = device.mapper.snapshot();
    assert_eq!(map.model, Model::Piecewise);
    let mut before = HostTime::MIN;
    for ticks in (first.0 - 1000..map.ticks_to + 50_000).step_by(7) {
        let mapped = map.map(ticks).expect("within range");
        assert!(mapped.time > before);
        before = mapped.time;
    }
    let newest = device.mapper.map(map.ticks_to).expect("seen");
    assert_eq!(
        newest.sigma_ns,
        map.map(map.ticks_to).expect("seen").sigma_ns
    );
    assert_eq!(map.map(i64::MAX), None, "beyond the range of time");
}

#[test]
fn latency_is_subtracted_and_its_sigma_added() {
    let known = ClockConfig::new(TickLength::NANOSECOND);
    let late = ClockConfig {
        latency_ns: 7_000,
        latency_sigma_ns: 30_000,
        ..known
    };
    let [mut a, mut b] = [ClockMapper::new(known), ClockMapper::new(late)];
    for i in 0..1000 {
        for mapper in [&mut a, &mut b] {
            mapper.observe(i * 5_000_000, HostTime(i * 5_000_000 + 40_000 + i % 7));
        }
    }
    let (a, b) = (a.map(4_000_000_000), b.map(4_000_000_000));
    let (a, b) = (a.expect("mapped"), b.expect("mapped"));
    assert_eq!(a.time - b.time, 7_000);
    let expected = (a.sigma_ns as f64).hypot(30_000.0);
    assert!(
        (b.sigma_ns as f64 - expected).abs() < 3.0,
        "{} {expected}",
        b.sigma_ns
    );
}

#[test]
fn guarded_times_increase_and_large_corrections_are_flagged() {
    let mut random = Random(29);
    let mut guard = MonotoneGuard::default();
    let mut last = HostTime::MIN;
    let (mut moved, mut flagged) = (0, 0);
    for ticks in 0..1000 {
        let refined = (random.uniform() * 4e6) as i64;
        let mapped = MappedTime {
            time: HostTime(ticks * 1_000_000 - refined),
            sigma_ns: 1_000_000,
            map_version: 0,
            flagged: false,
        };
        let out = guard.pass(ticks, mapped);
        let shift = out.time - mapped.time;
        assert!(out.time > last);
        assert_eq!(out.sigma_ns, 1_000_000 + shift as u64);
        assert_eq!(out.flagged, shift > 1_000_000);
        moved += usize::from(shift > 0);
        flagged += usize::from(out.flagged);
        last = out.time;
    }
    assert!(
        moved > 100 && flagged > 10,
        "{moved} {flagged}: the test shows nothing"
    );
    let older = MappedTime {
        time: HostTime(1),
        sigma_ns: 1,
        map_version: 1,
        flagged: false,
    };
    assert_eq!(
        guard.pass(-1, older),
        older,
        "an overtaken sample really is older"
    );
    guard.step();
    assert!(
        guard.pass(-1, older).time > last,
        "after a restart times still grow"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// For any input, nothing panics, memory is bounded, and a mapped time is never later than its
    /// arrival.
    #[test]
    fn any_ticks_and_arrivals(
        bits in prop::option::of(0_u8..=70),
        num in 0_u32..100_000,
        den in 0_u32..3,
        samples in prop::collection::vec(
            (prop_oneof![any::<i64>(), -1000_i64..1000], any::<i64>(), 1_u8..40), 1..60
        ),
    ) {
        let mut mapper = ClockMapper::new(ClockConfig {
            tick_bits: bits,
            ..ClockConfig::new(TickLength { num, den })
        });
        for (ticks, arrival, run) in samples {
            for i in 0..i64::from(run) {
                let ticks = ticks.wrapping_add(i * 1000);
                let arrival = HostTime(arrival.wrapping_add(i * 30_000_000));
                let taken = !matches!(
                    mapper.observe(ticks, arrival),
                    Observation::Duplicate | Observation::Unusable
                );
                if let Some(mapped) = mapper.map(ticks).filter(|_| taken) {
                    prop_assert!(mapped.time <= arrival);
                }
                mapper.map(ticks.wrapping_mul(3));
            }
        }
        let map = mapper.snapshot();
        prop_assert!(map.unreliable_spans.len() <= MAX_UNRELIABLE_SPANS);
        prop_assert!(map.segments.len() <= 600);
        prop_assert!(mapper.claims.len() <= MAX_CLAIMS);
    }
}
