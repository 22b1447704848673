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

mod claim;
mod config;
mod epoch;
mod fit;
mod guard;
mod hull;
mod map;
mod publication;
mod steps;
mod suspicion;
mod tail;

use std::collections::VecDeque;

use session_archive::time::{HostTime, NS_PER_S, TickLength};

use self::claim::Claim;
use self::config::Config;
use self::epoch::{Epoch, Sample, ticks_at};
use self::fit::{Line, RatePrior, Terms};
pub use self::guard::MonotoneGuard;
pub use self::map::{ClockMap, MappedTime, Model, Residuals, Segment, UnreliableSpan};
use self::suspicion::{Early, Suspicion};
use self::tail::Tail;

/// Prior knowledge of a device's clock and of the latency to the host.
///
/// Where a field names no source, its default was chosen on the simulated streams of `cargo xtask
/// bench sync`; docs/decisions/0004-clock-maps.md has the errors over jitter, rate and bursts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockConfig {
    /// Length of a device tick.
    pub tick: TickLength,
    /// Width of the counter if it wraps (1 to 63 bits). Half of its range must be longer than any
    /// latency.
    pub tick_bits: Option<u8>,
    /// Minimum latency from the instant of a time to its arrival, ns. Not observable from arrivals.
    /// Source: calibration of the device. An error shifts all times by as much.
    pub latency_ns: i64,
    /// One sigma of `latency_ns`, ns. It is part of every stated sigma.
    pub latency_sigma_ns: u64,
    /// Maximum rate deviation of the device's clock from the host's, parts in 1e6. A crystal has up
    /// to 100, so that two differ by up to 200. Lower bends the line of a worse crystal and reports
    /// steps, higher needs more samples until the rate is known.
    pub max_rate_ppm: f64,
    /// Latency jitter to assume until it has been measured, ns. Lower gives the first times too
    /// small a sigma, higher states large sigmas for longer.
    pub jitter_ns: u64,
    /// Maximum time for which all arrivals may be late, ns. A longer one is a step of the clock.
    /// Lower reports a busy host as a step, higher flags the times after a step for longer.
    pub burst_ns: i64,
    /// Rate change without samples, parts in 1e9 per second. Lower is overconfident after a
    /// gap, higher states larger sigmas there.
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

/// Maximum number of claims that are checked later, one for each fit of the line.
const MAX_CLAIMS: usize = 256;

/// Learns a device clock from arrivals, one sample at a time. See the [module](self).
#[derive(Clone, Debug)]
pub struct ClockMapper {
    config: ClockConfig,
    tuning: Config,
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

#[derive(Clone, Copy, Debug)]
struct LatestSample {
    ticks: i64,
    arrival: i64,
    /// Height above the line, ns.
    height: f64,
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
            tuning: Config::default(),
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
                Epoch::starting(sample, self.first_terms(), &self.tuning),
                HostTime(arrival),
            );
            return Observation::Accepted;
        };
        let p = epoch.point(sample);
        let line = epoch.line();
        let height = p.lag - line.lag(p.x);
        let tolerance = self.tuning.steps.tolerance_sigmas * line.sigma(p.x, self.wander);
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
        let low = height < -tolerance && (epoch.settled(&self.tuning) || height < possible);
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
        if let Some(alarm) = self
            .tail
            .watch(p, height, arrival, tolerance, &self.tuning.tail)
        {
            return self.observe_late(sample, alarm);
        }
        self.suspicion = None;
        if height <= self.tail.quantile(self.tuning.steps.on_time_quantile) + tolerance {
            self.on_time = arrival;
        }
        self.tail.learn(height, &self.tuning.tail);
        if self
            .epoch
            .as_mut()
            .is_some_and(|epoch| epoch.push(p, &self.tuning))
        {
            self.refit();
        }
        Observation::Accepted
    }

    /// Host time of a tick of the current epoch, as delivered by the device (a wrapped counter is
    /// taken to be near the newest sample). `None` before the first sample.
    ///
    /// Flagged while the clock has not settled or a step is suspected. Never later than the
    /// newest arrival allows, if the tick is not beyond the newest.
    pub fn map(&self, ticks: i64) -> Option<MappedTime> {
        let ticks = self.ticks(ticks);
        let last = self.last?;
        let mut mapped = self.map.map(ticks)?;
        let flags = &self.tuning.flags;
        let suspected = self.suspicion.is_some()
            || !self.behind.is_empty()
            || last.height > flags.suspect_lateness_ratio * self.map.residuals.p99_ns as f64;
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
            let max_excess = mapped.sigma_ns.saturating_mul(flags.max_excess_sigmas);
            mapped.flagged |= too_late as u64 > max_excess;
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
            floor: self.tuning.fit.sigma_floor_ns,
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
