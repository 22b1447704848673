//! The published map: when it changes, and which of its times later turn out to be unreliable.

use session_archive::time::HostTime;

use super::claim::Claim;
use super::map::{Residuals, UnreliableSpan};
use super::{ClockMapper, MAX_CLAIMS};

/// Maximum number of unreliable spans stored; older ones are merged.
pub(super) const MAX_UNRELIABLE_SPANS: usize = 64;

impl ClockMapper {
    /// Adds an unreliable span, merged with overlapping ones.
    pub(super) fn mark_unreliable(&mut self, mark_unreliable: UnreliableSpan) {
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

    pub(super) fn unsettled(&self) -> bool {
        self.map
            .unreliable_spans
            .last()
            .is_some_and(|d| d.to == HostTime::MAX)
    }

    /// Fits the line again and publishes it if that matters.
    pub(super) fn refit(&mut self) {
        let (Some(epoch), Some(last)) = (&mut self.epoch, self.last) else {
            return;
        };
        let config = &self.tuning.publication;
        epoch.refit(self.min_sigma, &self.tuning);
        let line = *epoch.line();
        let settles = epoch.settled(&self.tuning);
        self.tail.follow(&line, &self.tuning.tail);
        let samples = config.max_detection_ns / epoch.period().max(1.0);
        self.min_sigma = self.tail.unnoticed(samples, &self.tuning.tail) / config.max_error_sigmas;
        let (x, old) = (line.to_x, self.published);
        let (sigma, old_sigma) = (line.sigma(x, self.wander), old.sigma(x, self.wander));
        let moved = (line.lag(x) - old.lag(x)).abs();
        let settles = settles && self.unsettled();
        if settles && let Some(mark_unreliable) = self.map.unreliable_spans.last_mut() {
            mark_unreliable.to = HostTime(last.arrival);
        }
        let outdated = x - old.to_x > config.max_interval_ns;
        let [low, high] = config.sigma_ratio;
        if settles
            || moved > config.min_shift_sigmas * old_sigma
            || !(low..high).contains(&(sigma / old_sigma))
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
    pub(super) fn audit(&mut self) {
        let Some(epoch) = &self.epoch else { return };
        let config = &self.tuning.publication;
        let mut before: Option<&Claim> = None;
        let mut unreliable_spans = Vec::new();
        for (i, claim) in self.claims.iter().enumerate() {
            let next = self.claims.get(i + 1);
            // It gave times until the next one, so it is checked at both ends.
            let wrong = |x: f64| {
                let (lag, sigma) = epoch.best(x);
                let off = (lag - claim.line.lag(x)).abs();
                (off > sigma.hypot(config.max_claim_error_sigmas * claim.sigma)).then_some(off)
            };
            let to = HostTime(next.unwrap_or(claim).arrival);
            if let Some(off) = wrong(claim.x) {
                // Wrong since the line was last confirmed, or since the error could have been
                // detected.
                let confirmed =
                    epoch.last_touch(&claim.line, claim.x, config.confirmation_ratio * off);
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

    pub(super) fn publish(&mut self) {
        let Some(epoch) = &self.epoch else { return };
        self.published = *epoch.line();
        self.map.version += 1;
        self.map.model = epoch.model();
        self.map.segments = epoch.segments(self.config.tick, &self.tuning);
        self.map.ticks_to = self.last.map_or(0, |last| last.ticks);
        self.map.samples_used = epoch.samples();
        self.map.residuals = Residuals {
            median_ns: self.tail.quantile(0.5) as u64,
            p99_ns: self.tail.quantile(0.99) as u64,
        };
    }
}
