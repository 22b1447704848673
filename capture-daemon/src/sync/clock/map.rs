//! The clock map: a few line segments, plain data that maps ticks without its mapper.

use session_archive::time::{HostTime, TickLength};

/// Host time of one device clock's ticks, as estimated from the samples up to now.
///
/// A map holds for one *epoch*: a time in which the device clock ran without a step. A later
/// version of the same epoch replaces an earlier one; the map of a new epoch does not apply to
/// ticks of the old one.
#[derive(Clone, Debug, PartialEq)]
pub struct ClockMap {
    /// Counts up from 1; 0 before the first sample.
    pub version: u32,
    /// Counts the steps of the device clock, from 0.
    pub epoch: u32,
    /// First arrival of the epoch.
    pub since: HostTime,
    /// Model that the samples support.
    pub model: Model,
    /// Length of a device tick.
    pub tick: TickLength,
    /// Latency from the instant of a time to its arrival, as configured; subtracted. ns.
    pub latency_ns: i64,
    /// One sigma of `latency_ns`; part of every mapped sigma.
    pub latency_sigma_ns: u64,
    /// In the order of `ticks_from`; empty before the first sample.
    pub segments: Vec<Segment>,
    /// Last tick of the samples used; sigma grows beyond.
    pub ticks_to: i64,
    /// Rate change without samples, parts in 1e9 per second.
    pub wander_ppb_per_s: f64,
    /// Number of samples used.
    pub samples_used: u64,
    /// Distribution of the samples' lateness.
    pub residuals: Residuals,
    /// Spans of arrival time with unreliable times, of all epochs.
    pub unreliable_spans: Vec<UnreliableSpan>,
}

/// Number of parameters that the samples justify.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// An offset. The rate does not differ significantly from the expected one.
    #[default]
    Constant,
    /// An offset and a rate.
    Affine,
    /// Several joined lines, because the rate changed.
    Piecewise,
}

/// A segment of the map: `host(ticks) = host_ref + d + d * rate_ppb / 1e9 - latency` with `d` the
/// ns from `ticks_ref`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// First tick of the segment. The first segment also holds for ticks before it.
    pub ticks_from: i64,
    /// Reference point, device side.
    pub ticks_ref: i64,
    /// Reference point, host side: the earliest possible arrival, latency not yet subtracted.
    pub host_ref: HostTime,
    /// Host ns gained per device ns, parts in 1e9.
    pub rate_ppb: f64,
    /// Sigma at the reference point without the latency's, ns.
    pub sigma_ns: u64,
    /// Sigma of `rate_ppb`, independent of `sigma_ns`.
    pub rate_sigma_ppb: f64,
}

/// Heights of the samples above the map: how much later than the fastest ones they arrived.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Residuals {
    /// Half of the samples are later than this, ns.
    pub median_ns: u64,
    /// One in a hundred is later than this, ns.
    pub p99_ns: u64,
}

/// A span of arrival time whose samples have unreliable times: a clock that had not settled yet, or
/// the surroundings of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnreliableSpan {
    /// First arrival.
    pub from: HostTime,
    /// Last arrival; [`HostTime::MAX`] while it lasts.
    pub to: HostTime,
}

/// A device tick on the host's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MappedTime {
    /// The instant.
    pub time: HostTime,
    /// One sigma, ns, of the instant that the device stamped with this tick: of the clock map, of
    /// the latency, and of a tick's length.
    pub sigma_ns: u64,
    /// Version of the map used.
    pub map_version: u32,
    /// Not reliable within its sigma: the clock has not settled, or a step is suspected.
    pub flagged: bool,
}

impl ClockMap {
    /// Host time of a tick of this epoch (unwrapped, as from [`super::ClockMapper::ticks`]).
    ///
    /// Increases with the tick: strictly, for ticks that are at least 2 ns apart. `None` before the
    /// first sample and for ticks beyond the range of `i64` ns. Never `flagged`: whether a tick's
    /// time is unreliable depends on its arrival, see [`ClockMap::is_unreliable`].
    pub fn map(&self, ticks: i64) -> Option<MappedTime> {
        let after = self.segments.partition_point(|s| s.ticks_from <= ticks);
        let segment = self.segments.get(after.saturating_sub(1))?;
        let device_ns = self.tick.ns(ticks.checked_sub(segment.ticks_ref)?)?;
        let gained = device_ns as f64 * segment.rate_ppb * 1e-9;
        let time = segment
            .host_ref
            .saturating_add(device_ns)
            .saturating_add(gained.round() as i64)
            .saturating_add(self.latency_ns.saturating_neg());
        let beyond = self
            .tick
            .ns(ticks
                .saturating_sub(self.ticks_to)
                .max(segment.ticks_from.saturating_sub(ticks)))
            .map_or(f64::INFINITY, |ns| ns.max(0) as f64 * 1e-9);
        let statistical = (segment.sigma_ns as f64)
            .hypot(segment.rate_sigma_ppb * device_ns as f64 * 1e-9)
            + 0.5 * self.wander_ppb_per_s * beyond * beyond;
        // The instant is anywhere in the tick; a calibrated latency counts from its middle.
        let granularity = f64::from(self.tick.num) / f64::from(self.tick.den) / 12_f64.sqrt();
        let sigma = statistical
            .hypot(self.latency_sigma_ns as f64)
            .hypot(granularity);
        Some(MappedTime {
            time,
            sigma_ns: sigma.ceil() as u64,
            map_version: self.version,
            flagged: false,
        })
    }

    /// Whether samples that arrived then have unreliable times.
    pub fn is_unreliable(&self, arrival: HostTime) -> bool {
        self.unreliable_spans
            .iter()
            .any(|d| d.from <= arrival && arrival <= d.to)
    }
}
