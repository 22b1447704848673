//! Clock maps: host time of a device's ticks.
//!
//! A [`ClockMapper`] takes one pair of (device tick, host arrival) per sample and maintains a
//! [`ClockMap`]. Arrivals are late by a latency that is never less than some minimum, so the
//! earliest possible arrivals form a line: offset + rate × device time. The mapper fits that line
//! from below (how: `fit.rs`), detects steps of the device clock, and states the uncertainty of its
//! times.
//!
//! * **Early.** There is a map from the first sample on. Until some 64 samples (and 2 s) have
//!   arrived its sigma is mostly the expected jitter, and everything is flagged.
//! * **Refined.** Later versions of the map move by less than the earlier sigma. [`MonotoneGuard`]
//!   keeps the times of a stream increasing meanwhile, and marks the corrections.
//! * **Lost, repeated, reordered samples** are tolerated: a lost one is one chance less, a repeated
//!   tick is ignored, a reordered one is mapped but not learned from. A clock that has stopped is
//!   flagged as soon as its times fall behind.
//! * **A burst of late arrivals** is not learned from. While it lasts the clock may also have
//!   stepped back, so times are flagged, with a sigma as large as the step would be. If the old
//!   line is reached again it was a burst. If it is not for `burst_ns`, it was a step.
//! * **A step** (the device restarts, its clock is set, it or the host slept) begins a new epoch:
//!   [`Observation::Step`] states from when on times are unreliable, which may be before now, and
//!   the times that follow are flagged until the new line has settled.
//! * **A small step**, within the jitter, is found only after many samples, and a rate that changes
//!   fast is followed late. Every claim of the last minute is therefore checked whenever the map
//!   changes; the time of a wrong one is added to [`ClockMap::unreliable_spans`].
//! * **Not observable**: the constant part of the latency. It is configured, with a sigma, and
//!   comes from calibration. And a latency whose minimum changes for longer than `burst_ns` cannot
//!   be distinguished from a step of the clock; it is reported as one. The minimum step that is
//!   detected, and other measurements: `docs/decisions/0004-clock-maps.md`.
//! * **Memory** is bounded (some 80 KiB). A sample costs O(1) amortized.
//!
//! Code that stores times should store a map whenever [`ClockMapper::version`] has changed.

mod epoch;
mod fit;
mod guard;
mod hull;
mod map;
mod tail;

use std::collections::VecDeque;

use session_archive::time::{HostTime, NS_PER_S, TickLength};

use self::epoch::{Epoch, Sample, ticks_at};
use self::fit::{Line, RatePrior, Terms};
pub use self::guard::MonotoneGuard;
pub use self::map::{ClockMap, Mapped, Model, Residuals, Segment, UnreliableSpan};
use self::tail::Tail;

/// Prior knowledge of a device's clock and of the latency to the host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockConfig {
    /// Length of a device tick.
    pub tick: TickLength,
    /// Width of the counter if it wraps (1 to 63 bits). Half of its range must be longer than any
    /// latency.
    pub tick_bits: Option<u8>,
    /// Minimum latency from the instant of a time to its arrival, ns. Not observable from arrivals.
    pub latency_ns: i64,
    /// One sigma of `latency_ns`.
    pub latency_sigma_ns: u64,
    /// Maximum rate deviation of the device's clock from the host's, parts in 1e6. Crystals: 100.
    pub max_rate_ppm: f64,
    /// Latency jitter to assume until it has been measured, ns.
    pub jitter_ns: u64,
    /// Maximum time for which all arrivals may be late, ns. A longer one is a step of the clock.
    pub burst_ns: i64,
    /// Rate change without samples, parts in 1e9 per second.
    pub wander_ppb_per_s: f64,
}

impl ClockConfig {
    /// A crystal clock with this tick that does not wrap, at an unknown latency around 5 ms.
    pub const fn new(tick: TickLength) -> Self {
        Self {
            tick,
            tick_bits: None,
            latency_ns: 0,
            latency_sigma_ns: 0,
            max_rate_ppm: 200.0,
            jitter_ns: 5_000_000,
            burst_ns: 5 * NS_PER_S,
            wander_ppb_per_s: 20.0,
        }
    }
}

/// Classification of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Observation {
    /// Part of the map, now or at its next refinement.
    Accepted,
    /// Repeats the previous tick. Not learned from; if the clock has stopped, its times are flagged
    /// as soon as they fall behind.
    Duplicate,
    /// The tick is before an earlier sample's. Mapped, but not learned from.
    OutOfOrder,
    /// Does not fit the map: a late arrival or the beginning of a step. Held until decided.
    Suspect,
    /// This and earlier samples show that the device clock has stepped. A new epoch has begun.
    Step(Step),
    /// The tick is beyond the range of `i64` nanoseconds. Ignored.
    Unusable,
}

/// A step of the device clock, or of the host's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Arrivals with unreliable times. Begins where the old map was last confirmed; unflagged times
    /// given since then have to be flagged now.
    pub mark_unreliable: UnreliableSpan,
    /// Delay of the samples' arrival against the old map, ns: positive if the device clock stepped
    /// back.
    pub shift_ns: i64,
}

/// Number of sigmas below the map from which a sample is no refinement.
const STEP_SIGMAS: f64 = 4.0;
/// Factor on the 99th percentile of lateness above which a single sample is suspicious.
const SUSPECT_LATENESS_RATIO: f64 = 3.0;
/// Quantile of lateness up to which a sample is on time.
const ON_TIME_QUANTILE: f64 = 0.5;
/// Maximum number of samples held before early ones are judged.
const MAX_EARLY_SAMPLES: usize = 16;
/// Minimum number of early samples among them for a step.
const MIN_EARLY_STEP_SAMPLES: usize = 3;
/// Number of consecutive samples behind the newest tick that indicate a restarted counter.
const MIN_RESTART_SAMPLES: usize = 4;
/// Minimum number of samples in a burst for a step.
const MIN_LATE_STEP_SAMPLES: u64 = 32;
/// Lower bound of every sigma, ns: host timestamps are rounded, some to 1 us.
const SIGMA_FLOOR_NS: f64 = 250.0;
/// Five sigmas are at least the size of a step that can remain undetected for this long, ns.
const UNNOTICED_STEP_NS: f64 = 10.0 * NS_PER_S as f64;
/// Maximum device time between published maps, ns.
const MAX_PUBLISH_INTERVAL_NS: f64 = 10.0 * NS_PER_S as f64;
/// Maximum number of claims that are checked later, one for each fit of the line.
const MAX_CLAIMS: usize = 256;
/// Maximum error of a claim against later knowledge, in its sigmas.
const MAX_CLAIM_ERROR_SIGMAS: f64 = 3.0;
/// Maximum number of unreliable spans stored; older ones are merged.
const MAX_UNRELIABLE_SPANS: usize = 64;

/// Learns a device clock from arrivals, one sample at a time. See the [module](self).
#[derive(Clone, Debug)]
pub struct ClockMapper {
    config: ClockConfig,
    wander: f64,
    epoch: Option<Epoch>,
    tail: Tail,
    suspicion: Option<Suspicion>,
    /// Consecutive samples behind the newest tick.
    behind: Vec<Sample>,
    last: Option<LatestSample>,
    /// Arrival of the newest sample that was on time: until then there was no step.
    on_time: i64,
    map: ClockMap,
    published: Line,
    min_sigma: f64,
    /// Recent claims.
    claims: VecDeque<Claim>,
}

/// Line by which times were given at device time `x`, to be checked against later knowledge.
#[derive(Clone, Copy, Debug)]
struct Claim {
    x: f64,
    line: Line,
    sigma: f64,
    arrival: i64,
}

#[derive(Clone, Copy, Debug)]
struct LatestSample {
    ticks: i64,
    arrival: i64,
    /// Height above the line, ns.
    height: f64,
}

/// Samples that may be the beginning of a new epoch.
#[derive(Clone, Debug)]
enum Suspicion {
    /// Consecutive late arrivals: a burst, or the device clock stepped back.
    Late { next: Box<Epoch>, since: i64 },
    /// Samples that arrived before they could have been sent: the device clock stepped forward, or
    /// a tick is wrong, or the minimum latency had not been observed yet.
    Early { early_samples: Vec<Early> },
}

#[derive(Clone, Copy, Debug)]
struct Early {
    sample: Sample,
    height: f64,
    low: bool,
}

impl ClockMapper {
    /// A mapper without samples.
    pub fn new(config: ClockConfig) -> Self {
        let map = ClockMap {
            version: 0,
            epoch: 0,
            since: HostTime::MIN,
            model: Model::Constant,
            tick: config.tick,
            latency_ns: config.latency_ns,
            latency_sigma_ns: config.latency_sigma_ns,
            segments: Vec::new(),
            ticks_to: 0,
            wander_ppb_per_s: config.wander_ppb_per_s,
            samples_used: 0,
            residuals: Residuals::default(),
            unreliable_spans: Vec::new(),
        };
        Self {
            config,
            wander: config.wander_ppb_per_s * 1e-18,
            epoch: None,
            tail: Tail::new(),
            suspicion: None,
            behind: Vec::new(),
            last: None,
            on_time: i64::MIN,
            map,
            published: Line::default(),
            min_sigma: 0.0,
            claims: VecDeque::with_capacity(MAX_CLAIMS),
        }
    }

    /// Learns from a sample. If samples come in batches, only the last one of a batch arrives when
    /// it is read; observe that one.
    pub fn observe(&mut self, ticks: i64, arrival: HostTime) -> Observation {
        let arrival = arrival.ns();
        let ticks = self.unwrap_at(ticks, arrival);
        let Some(device_ns) = self
            .config
            .tick
            .ns(ticks)
            .filter(|_| self.config.tick.num > 0)
        else {
            return Observation::Unusable;
        };
        let sample = Sample { device_ns, arrival };
        if let Some(last) = &mut self.last
            && last.ticks == ticks
        {
            // A stopped clock falls ever farther behind; its times become suspicious soon.
            if let Some(epoch) = &self.epoch {
                let p = epoch.point(sample);
                last.height = p.lag - epoch.line().lag(p.x);
                last.arrival = last.arrival.max(arrival);
            }
            return Observation::Duplicate;
        }
        let Some(epoch) = &self.epoch else {
            self.last = Some(LatestSample {
                ticks,
                arrival,
                height: 0.0,
            });
            self.map.unreliable_spans.push(UnreliableSpan {
                from: HostTime(arrival),
                to: HostTime::MAX,
            });
            self.begin(
                Epoch::starting(sample, self.first_terms()),
                HostTime(arrival),
            );
            return Observation::Accepted;
        };
        let p = epoch.point(sample);
        let line = epoch.line();
        let height = p.lag - line.lag(p.x);
        let tolerance = STEP_SIGMAS * line.sigma(p.x, self.wander);
        self.last = Some(LatestSample {
            ticks,
            arrival,
            height,
        });
        if p.x <= epoch.newest_x() {
            return self.observe_behind(sample, height);
        }
        self.behind.clear();
        // Before the line has settled the minimum latency is unknown, but no latency is longer than
        // a burst.
        let possible = -(self.config.burst_ns as f64);
        let low = height < -tolerance && (epoch.settled() || height < possible);
        if low || matches!(self.suspicion, Some(Suspicion::Early { .. })) {
            return self.observe_early(
                Early {
                    sample,
                    height,
                    low,
                },
                tolerance,
            );
        }
        if let Some(alarm) = self.tail.watch(p, height, arrival, tolerance) {
            return self.observe_late(sample, alarm);
        }
        self.suspicion = None;
        if height <= self.tail.quantile(ON_TIME_QUANTILE) + tolerance {
            self.on_time = arrival;
        }
        self.tail.learn(height);
        if self.epoch.as_mut().is_some_and(|epoch| epoch.push(p)) {
            self.refit();
        }
        Observation::Accepted
    }

    /// Host time of a tick of the current epoch, as delivered by the device (a wrapped counter is
    /// taken to be near the newest sample). `None` before the first sample.
    ///
    /// Flagged while the clock has not settled or a step is suspected. Never later than the
    /// newest arrival allows, if the tick is not beyond the newest.
    pub fn map(&self, ticks: i64) -> Option<Mapped> {
        let ticks = self.ticks(ticks);
        let last = self.last?;
        let mut mapped = self.map.map(ticks)?;
        let suspected = self.suspicion.is_some()
            || !self.behind.is_empty()
            || last.height > SUSPECT_LATENESS_RATIO * self.map.residuals.p99_ns as f64;
        mapped.flagged = self.unsettled() || suspected;
        if suspected && last.height > self.config.burst_ns as f64 {
            // No latency is that long: the counter restarted, or has stopped. The only information
            // on the sample is its arrival.
            mapped.time = mapped.time.saturating_add(last.height.round() as i64);
            mapped.sigma_ns = mapped.sigma_ns.max(self.config.burst_ns.unsigned_abs());
        } else if suspected {
            mapped.sigma_ns = mapped.sigma_ns.max(last.height.abs().ceil() as u64);
        }
        let latest = HostTime(last.arrival.saturating_sub(self.config.latency_ns));
        let too_late = mapped.time.since(latest);
        if ticks <= last.ticks && too_late > 0 {
            mapped.flagged |= too_late as u64 > mapped.sigma_ns.saturating_mul(5);
            mapped.sigma_ns = mapped.sigma_ns.saturating_add(too_late as u64);
            mapped.time = latest;
        }
        Some(mapped)
    }

    /// A delivered tick unwrapped: equal to `ticks` modulo 2^`tick_bits`, and the same as `ticks`
    /// if the counter does not wrap. Maps and archives contain these.
    pub fn ticks(&self, ticks: i64) -> i64 {
        let near = self.last.map_or(0, |last| last.ticks);
        unwrap(ticks, near, self.config.tick_bits)
    }

    /// Copy of the present map, to be stored.
    pub fn snapshot(&self) -> ClockMap {
        self.map.clone()
    }

    /// The present map.
    pub fn current(&self) -> &ClockMap {
        &self.map
    }

    /// Whether samples that arrived then have unreliable times, by present knowledge.
    pub fn is_unreliable(&self, arrival: HostTime) -> bool {
        self.map.is_unreliable(arrival)
    }

    /// Version of the present map. It increases when the map has changed by a considerable part of
    /// its sigma, at a step, when the clock has settled, and every 10 s. 0 before the first sample.
    pub fn version(&self) -> u32 {
        self.map.version
    }

    fn first_terms(&self) -> Terms {
        let limit = (self.config.max_rate_ppm * 1e-6).clamp(1e-9, 0.5);
        Terms {
            prior: RatePrior {
                expected: 0.0,
                limit,
            },
            jitter: self.config.jitter_ns as f64,
            floor: SIGMA_FLOOR_NS,
            min_sigma: 0.0,
        }
    }

    fn unwrap_at(&self, ticks: i64, arrival: i64) -> i64 {
        let near = match &self.epoch {
            Some(epoch) if self.config.tick_bits.is_some() => {
                ticks_at(self.config.tick, epoch.device_ns_at(arrival))
            }
            _ => 0,
        };
        unwrap(ticks, near, self.config.tick_bits)
    }

    /// The tick is not beyond the newest: reordered in transit, or the counter restarted.
    fn observe_behind(&mut self, sample: Sample, height: f64) -> Observation {
        if self
            .behind
            .last()
            .is_some_and(|last| last.device_ns >= sample.device_ns)
        {
            self.behind.clear();
        }
        self.behind.push(sample);
        if self.behind.len() < MIN_RESTART_SAMPLES {
            return Observation::OutOfOrder;
        }
        let samples = std::mem::take(&mut self.behind);
        let next = self.epoch_of(samples.iter().copied());
        let after = HostTime(samples[0].arrival.saturating_sub(1));
        self.step(next, after, height)
    }

    /// An arrival earlier than possible, or one that came while such an arrival is being judged.
    fn observe_early(&mut self, early: Early, tolerance: f64) -> Observation {
        let mut early_samples = match self.suspicion.take() {
            Some(Suspicion::Early { early_samples }) => early_samples,
            _ => Vec::with_capacity(MAX_EARLY_SAMPLES),
        };
        early_samples.push(early);
        let newest = early_samples
            .iter()
            .rev()
            .find(|e| e.low)
            .map_or(0.0, |e| e.height);
        let reach = 3.0 * self.tail.quantile(0.99) + tolerance;
        let agrees = |e: &&Early| (e.height - newest).abs() <= reach;
        let low_and_agreeing = early_samples
            .iter()
            .filter(|e| e.low)
            .filter(agrees)
            .count();
        if early.low && low_and_agreeing >= MIN_EARLY_STEP_SAMPLES {
            let first = early_samples
                .iter()
                .position(|e| e.low && agrees(&e))
                .unwrap_or(0);
            let lowest = early_samples
                .iter()
                .filter(agrees)
                .map(|e| e.height)
                .fold(0.0, f64::min);
            let next = self.epoch_of(
                early_samples[first..]
                    .iter()
                    .filter(agrees)
                    .map(|e| e.sample),
            );
            let unnoticed =
                self.tail.overdue(-lowest) as f64 * self.epoch.as_ref().map_or(0.0, Epoch::period);
            let after = early_samples[first]
                .sample
                .arrival
                .saturating_sub(unnoticed as i64);
            return self.step(next, HostTime(after).max(self.map.since), lowest);
        }
        if early_samples.len() < MAX_EARLY_SAMPLES {
            self.suspicion = Some(Suspicion::Early { early_samples });
            return Observation::Suspect;
        }
        // No step. Far below the usual spread it is a wrong tick, else a new minimum latency.
        let wrong = 10.0 * self.tail.quantile(0.5) + tolerance;
        if let Some(epoch) = &mut self.epoch {
            for e in early_samples.iter().filter(|e| e.height >= -wrong) {
                let p = epoch.point(e.sample);
                if p.x > epoch.newest_x() {
                    epoch.push(p);
                }
            }
        }
        self.refit();
        Observation::Accepted
    }

    /// One of a run of arrivals that are all too late.
    fn observe_late(&mut self, sample: Sample, alarm: tail::Alarm) -> Observation {
        if let Some(Suspicion::Late { next, .. }) = &mut self.suspicion {
            let p = next.point(sample);
            if p.x > next.newest_x() && next.push(p) {
                next.refit(0.0);
            }
        } else {
            let terms = self
                .epoch
                .as_ref()
                .map_or(self.first_terms(), Epoch::terms_for_next);
            let next = Box::new(Epoch::starting(sample, terms));
            self.suspicion = Some(Suspicion::Late {
                next,
                since: sample.arrival,
            });
        }
        let Some(Suspicion::Late { next, since }) = &self.suspicion else {
            return Observation::Suspect;
        };
        let burst = self.config.burst_ns;
        let lasted = sample.arrival.saturating_sub(*since) >= burst
            && next.samples() >= MIN_LATE_STEP_SAMPLES;
        let impossible =
            alarm.height > burst as f64 && next.samples() >= MIN_EARLY_STEP_SAMPLES as u64;
        if !lasted && !impossible {
            return Observation::Suspect;
        }
        let Some(Suspicion::Late { mut next, .. }) = self.suspicion.take() else {
            return Observation::Suspect;
        };
        next.refit(0.0);
        let after = alarm.after.map_or(self.map.since, HostTime);
        self.step(*next, after, alarm.height)
    }

    /// An epoch of samples in order; samples whose tick does not increase are skipped.
    fn epoch_of(&self, mut samples: impl Iterator<Item = Sample>) -> Option<Epoch> {
        let terms = self
            .epoch
            .as_ref()
            .map_or(self.first_terms(), Epoch::terms_for_next);
        let mut epoch = Epoch::starting(samples.next()?, terms);
        for sample in samples {
            let p = epoch.point(sample);
            if p.x > epoch.newest_x() {
                epoch.push(p);
            }
        }
        epoch.refit(0.0);
        Some(epoch)
    }

    /// The clock has stepped: `next` replaces the epoch. Times after `after` are unreliable.
    fn step(&mut self, next: impl Into<Option<Epoch>>, after: HostTime, shift: f64) -> Observation {
        let (Some(next), Some(last)) = (next.into(), self.last) else {
            return Observation::Suspect;
        };
        let now = HostTime(last.arrival);
        // Samples that were all late may be from either side of it.
        let after = after.min(HostTime(self.on_time)).max(self.map.since);
        let mark_unreliable = UnreliableSpan {
            from: after,
            to: if next.settled() { now } else { HostTime::MAX },
        };
        self.mark_unreliable(mark_unreliable);
        self.suspicion = None;
        self.behind.clear();
        self.map.epoch += 1;
        let since = next.arrival(0.0);
        self.begin(next, since);
        Observation::Step(Step {
            mark_unreliable,
            shift_ns: shift.round() as i64,
        })
    }

    fn begin(&mut self, epoch: Epoch, since: HostTime) {
        self.epoch = Some(epoch);
        self.map.since = since;
        self.on_time = since.ns();
        self.claims.clear();
        self.tail.restart();
        self.publish();
    }

    /// Time for which a step of `height` can remain undetected, ns of host time.
    fn unnoticed(&self, height: f64) -> i64 {
        let period = self.epoch.as_ref().map_or(0.0, Epoch::period);
        (self.tail.overdue(height) as f64 * period) as i64
    }

    /// Adds an unreliable span, merged with overlapping ones.
    fn mark_unreliable(&mut self, mark_unreliable: UnreliableSpan) {
        let unreliable_spans = &mut self.map.unreliable_spans;
        unreliable_spans.push(mark_unreliable);
        unreliable_spans.sort_by_key(|d| d.from);
        unreliable_spans.dedup_by(|next, first| {
            let joined = next.from <= first.to;
            if joined {
                first.to = first.to.max(next.to);
            }
            joined
        });
        if unreliable_spans.len() > MAX_UNRELIABLE_SPANS {
            unreliable_spans[1].from = unreliable_spans[0].from;
            unreliable_spans.remove(0);
        }
    }

    fn unsettled(&self) -> bool {
        self.map
            .unreliable_spans
            .last()
            .is_some_and(|d| d.to == HostTime::MAX)
    }

    /// Fits the line again and publishes it if that matters.
    fn refit(&mut self) {
        let (Some(epoch), Some(last)) = (&mut self.epoch, self.last) else {
            return;
        };
        epoch.refit(self.min_sigma);
        let line = *epoch.line();
        let settles = epoch.settled();
        self.tail.follow(&line);
        self.min_sigma = self
            .tail
            .unnoticed(UNNOTICED_STEP_NS / epoch.period().max(1.0))
            / 5.0;
        let (x, old) = (line.to_x, self.published);
        let (sigma, old_sigma) = (line.sigma(x, self.wander), old.sigma(x, self.wander));
        let moved = (line.lag(x) - old.lag(x)).abs();
        let settles = settles && self.unsettled();
        if settles && let Some(mark_unreliable) = self.map.unreliable_spans.last_mut() {
            mark_unreliable.to = HostTime(last.arrival);
        }
        let outdated = x - old.to_x > MAX_PUBLISH_INTERVAL_NS;
        if settles
            || moved > 0.5 * old_sigma
            || !(0.7..1.4).contains(&(sigma / old_sigma))
            || outdated
        {
            self.audit();
            self.publish();
        }
        if self.claims.len() == MAX_CLAIMS {
            self.claims.pop_front();
        }
        let line = self.published;
        let sigma = line.sigma(x, self.wander);
        self.claims.push_back(Claim {
            x,
            line,
            sigma,
            arrival: last.arrival,
        });
    }

    /// Marks the times of claims that proved wrong as unreliable.
    fn audit(&mut self) {
        let Some(epoch) = &self.epoch else { return };
        let mut before: Option<&Claim> = None;
        let mut unreliable_spans = Vec::new();
        for (i, claim) in self.claims.iter().enumerate() {
            let next = self.claims.get(i + 1);
            // It gave times until the next one, so it is checked at both ends.
            let wrong = |x: f64| {
                let (lag, sigma) = epoch.best(x);
                let off = (lag - claim.line.lag(x)).abs();
                (off > sigma.hypot(MAX_CLAIM_ERROR_SIGMAS * claim.sigma)).then_some(off)
            };
            let to = HostTime(next.unwrap_or(claim).arrival);
            if let Some(off) = wrong(claim.x) {
                // Wrong since the line was last confirmed, or since the error could have been
                // detected.
                let confirmed = epoch.last_touch(&claim.line, claim.x, 0.5 * off);
                let noticed = HostTime(claim.arrival.saturating_sub(self.unnoticed(off)));
                let from = before.map_or(claim.arrival, |b| b.arrival);
                let from = confirmed.max(noticed).min(HostTime(from));
                unreliable_spans.push(UnreliableSpan { from, to });
            } else if next.is_some_and(|next| wrong(next.x).is_some()) {
                let from = HostTime(claim.arrival);
                unreliable_spans.push(UnreliableSpan { from, to });
            }
            before = Some(claim);
        }
        unreliable_spans
            .into_iter()
            .for_each(|mark_unreliable| self.mark_unreliable(mark_unreliable));
    }

    fn publish(&mut self) {
        let Some(epoch) = &self.epoch else { return };
        self.published = *epoch.line();
        self.map.version += 1;
        self.map.model = epoch.model();
        self.map.segments = epoch.segments(self.config.tick);
        self.map.ticks_to = self.last.map_or(0, |last| last.ticks);
        self.map.samples_used = epoch.samples();
        self.map.residuals = Residuals {
            median_ns: self.tail.quantile(0.5) as u64,
            p99_ns: self.tail.quantile(0.99) as u64,
        };
    }
}

/// The value nearest to `near` that equals `ticks` in the lowest `bits` bits.
fn unwrap(ticks: i64, near: i64, bits: Option<u8>) -> i64 {
    let Some(bits @ 1..=63) = bits else {
        return ticks;
    };
    let modulus = 1_i128 << bits;
    let ahead = (i128::from(ticks) - i128::from(near)).rem_euclid(modulus);
    let nearest = i128::from(near)
        + if ahead >= modulus / 2 {
            ahead - modulus
        } else {
            ahead
        };
    nearest.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
}

#[cfg(test)]
mod tests;
