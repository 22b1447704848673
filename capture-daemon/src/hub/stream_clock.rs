//! Times of one stream: its device clock's map, published when it has changed, and a guard that
//! makes times increase. If a driver stamps with the host clock, nothing is estimated: timestamps
//! are times.

use session_archive::record::ClockMap as ClockMapRecord;
use session_archive::record::paws::clock_map::{Model as ModelRecord, Piece, UnreliableSpan};
use session_archive::time::{HostTime, NS_PER_S, TickLength};

use super::outgoing::{Out, Outgoing};
use crate::sources::TimestampRelation;
use crate::sync::clock::{
    ClockConfig, ClockMap, ClockMapper, MappedTime, Model, MonotoneGuard, Observation,
};

/// Maximum time in transit from a device, ns.
pub(super) const MAX_TRANSIT_NS: i64 = 60 * NS_PER_S;

/// Maximum time by which a timestamp may lie after the arrival, ns. The timestamp is taken before
/// the arrival, so a later one is invalid.
const MAX_FUTURE_NS: i64 = 1_000_000;
/// Version of the clock map of a stream with host timestamps.
const STAMPS_VERSION: u32 = 1;

/// A clock and the times that it assigns to one stream.
pub(super) struct StreamClock {
    name: String,
    mapper: ClockMapper,
    stamped: Option<TimestampRelation>,
    guard: MonotoneGuard,
    announced: u32,
    tick: TickLength,
}

impl StreamClock {
    /// With `stamped`, ticks are ns of the host clock.
    pub(super) fn new(name: &str, config: ClockConfig, stamped: Option<TimestampRelation>) -> Self {
        let stamped = stamped.map(|stamped| TimestampRelation {
            latency_ns: stamped.latency_ns + config.latency_ns,
            sigma_ns: (stamped.sigma_ns as f64).hypot(config.latency_sigma_ns as f64) as u64,
        });
        Self {
            name: name.to_owned(),
            mapper: ClockMapper::new(config),
            stamped,
            guard: MonotoneGuard::default(),
            announced: 0,
            tick: config.tick,
        }
    }

    /// Updates the map with a sample and maps its ticks, which are returned unwrapped. Publishes
    /// the map if it has changed.
    pub(super) fn map(&mut self, ticks: i64, arrival: HostTime, out: &Out) -> (i64, MappedTime) {
        match self.stamped {
            Some(stamped) => (ticks, self.stamp(stamped, ticks, arrival, out)),
            None => self.learn(ticks, arrival, out),
        }
    }

    /// Host time of an instant on the device's clock, by the current map.
    pub(super) fn time_of(&self, ticks: i64) -> Option<HostTime> {
        self.mapper.map(ticks).map(|mapped| mapped.time)
    }

    fn stamp(
        &mut self,
        stamped: TimestampRelation,
        ticks: i64,
        arrival: HostTime,
        out: &Out,
    ) -> MappedTime {
        if self.announced != STAMPS_VERSION {
            self.announced = STAMPS_VERSION;
            let map = stamps_record(&self.name, self.tick, stamped, ticks);
            out(Outgoing::Clock { at: arrival, map });
        }
        let way_ns = arrival.0.saturating_sub(ticks);
        let is_believed = (-MAX_FUTURE_NS..MAX_TRANSIT_NS).contains(&way_ns);
        let mapped = MappedTime {
            time: if is_believed {
                HostTime(ticks.saturating_sub(stamped.latency_ns))
            } else {
                arrival
            },
            sigma_ns: if is_believed {
                stamped.sigma_ns
            } else {
                NS_PER_S as u64
            },
            map_version: STAMPS_VERSION,
            flagged: !is_believed,
        };
        self.guard.pass(ticks, mapped)
    }

    fn learn(&mut self, ticks: i64, arrival: HostTime, out: &Out) -> (i64, MappedTime) {
        let observation = self.mapper.observe(ticks, arrival);
        if let Observation::Step(step) = observation {
            self.guard.step();
            let text = format!(
                "{}: the device clock stepped by {} ns",
                self.name, step.shift_ns
            );
            let stream = self.name.clone();
            out(Outgoing::Notice {
                at: arrival,
                text,
                stream,
            });
        }
        let version = self.mapper.version();
        if version != self.announced {
            self.announced = version;
            let map = clock_record(&self.name, self.tick, self.mapper.current());
            out(Outgoing::Clock { at: arrival, map });
        }
        let unwrapped = self.mapper.ticks(ticks);
        // A tick beyond the range of time, or long before its arrival, has no better time than its
        // arrival.
        let unknown = MappedTime {
            time: arrival,
            sigma_ns: NS_PER_S as u64,
            map_version: version,
            flagged: true,
        };
        let mapped = self.mapper.map(ticks);
        let mapped = mapped.filter(|m| arrival.since(m.time) < MAX_TRANSIT_NS);
        let mapped = mapped.unwrap_or(unknown);
        (unwrapped, self.guard.pass(unwrapped, mapped))
    }
}

/// Clock map from timestamps to times: identical but for the latency.
fn stamps_record(
    clock: &str,
    tick: TickLength,
    stamped: TimestampRelation,
    since: i64,
) -> ClockMapRecord {
    ClockMapRecord {
        clock: clock.to_owned(),
        version: STAMPS_VERSION,
        tick_num: tick.num,
        tick_den: tick.den,
        model: ModelRecord::Constant.into(),
        pieces: vec![Piece {
            ticks_from: since,
            ..Piece::default()
        }],
        latency_ns: stamped.latency_ns,
        latency_sigma_ns: stamped.sigma_ns,
        ..ClockMapRecord::default()
    }
}

/// A clock map as the archive stores it.
fn clock_record(clock: &str, tick: TickLength, map: &ClockMap) -> ClockMapRecord {
    let model = match map.model {
        Model::Constant => ModelRecord::Constant,
        Model::Affine => ModelRecord::Affine,
        Model::Piecewise => ModelRecord::Piecewise,
    };
    let pieces = map.segments.iter().map(|s| Piece {
        ticks_from: s.ticks_from,
        ticks_ref: s.ticks_ref,
        host_ref: s.host_ref.0,
        rate_ppb: s.rate_ppb,
        sigma_ns: s.sigma_ns,
        rate_sigma_ppb: s.rate_sigma_ppb,
    });
    ClockMapRecord {
        clock: clock.to_owned(),
        version: map.version,
        tick_num: tick.num,
        tick_den: tick.den,
        model: model.into(),
        pieces: pieces.collect(),
        latency_ns: map.latency_ns,
        latency_sigma_ns: map.latency_sigma_ns,
        samples: map.samples_used,
        epoch: map.epoch,
        ticks_to: map.ticks_to,
        wander_ppb_per_s: map.wander_ppb_per_s,
        residual_median_ns: map.residuals.median_ns,
        residual_p99_ns: map.residuals.p99_ns,
        unreliable_spans: map
            .unreliable_spans
            .iter()
            .map(|d| UnreliableSpan {
                from: d.from.0,
                to: d.to.0,
            })
            .collect(),
    }
}
