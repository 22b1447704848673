//! Steps of a clock: samples that do not fit the line, until they are a step or none.

use session_archive::time::HostTime;

use super::epoch::{Epoch, Sample};
use super::map::UnreliableSpan;
use super::suspicion::{Early, Suspicion};
use super::tail;
use super::{ClockMapper, Observation, Step};

impl ClockMapper {
    /// The tick is not beyond the newest: reordered in transit, or the counter restarted.
    pub(super) fn observe_behind(&mut self, sample: Sample, height: f64) -> Observation {
        if self
            .behind
            .last()
            .is_some_and(|last| last.device_ns >= sample.device_ns)
        {
            self.behind.clear();
        }
        self.behind.push(sample);
        if self.behind.len() < self.tuning.steps.min_restart_samples {
            return Observation::OutOfOrder;
        }
        let samples = std::mem::take(&mut self.behind);
        let next = self.epoch_of(samples.iter().copied());
        let after = HostTime(samples[0].arrival.saturating_sub(1));
        self.step(next, after, height)
    }

    /// An arrival earlier than possible, or one that came while such an arrival is being judged.
    pub(super) fn observe_early(&mut self, early: Early, tolerance: f64) -> Observation {
        let config = &self.tuning.steps;
        let mut early_samples = match self.suspicion.take() {
            Some(Suspicion::Early { early_samples }) => early_samples,
            _ => Vec::with_capacity(config.max_early_samples),
        };
        early_samples.push(early);
        let newest = early_samples
            .iter()
            .rev()
            .find(|e| e.low)
            .map_or(0.0, |e| e.height);
        let reach = config.agreement_ratio * self.tail.quantile(0.99) + tolerance;
        let agrees = |e: &&Early| (e.height - newest).abs() <= reach;
        let low_and_agreeing = early_samples
            .iter()
            .filter(|e| e.low)
            .filter(agrees)
            .count();
        if early.low && low_and_agreeing >= config.min_early_samples {
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
            let unnoticed = self.tail.overdue(-lowest, &self.tuning.tail) as f64
                * self.epoch.as_ref().map_or(0.0, Epoch::period);
            let after = early_samples[first]
                .sample
                .arrival
                .saturating_sub(unnoticed as i64);
            return self.step(next, HostTime(after).max(self.map.since), lowest);
        }
        if early_samples.len() < config.max_early_samples {
            self.suspicion = Some(Suspicion::Early { early_samples });
            return Observation::Suspect;
        }
        // No step. Far below the usual spread it is a wrong tick, else a new minimum latency.
        let wrong = config.wrong_tick_ratio * self.tail.quantile(0.5) + tolerance;
        if let Some(epoch) = &mut self.epoch {
            for e in early_samples.iter().filter(|e| e.height >= -wrong) {
                let p = epoch.point(e.sample);
                if p.x > epoch.newest_x() {
                    epoch.push(p, &self.tuning);
                }
            }
        }
        self.refit();
        Observation::Accepted
    }

    /// One of a run of arrivals that are all too late.
    pub(super) fn observe_late(&mut self, sample: Sample, alarm: tail::Alarm) -> Observation {
        if let Some(Suspicion::Late { next, .. }) = &mut self.suspicion {
            let p = next.point(sample);
            if p.x > next.newest_x() && next.push(p, &self.tuning) {
                next.refit(0.0, &self.tuning);
            }
        } else {
            let terms = self.epoch.as_ref().map_or(self.first_terms(), |epoch| {
                epoch.terms_for_next(&self.tuning)
            });
            let next = Box::new(Epoch::starting(sample, terms, &self.tuning));
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
            && next.samples() >= self.tuning.steps.min_late_samples;
        let impossible = alarm.height > burst as f64
            && next.samples() >= self.tuning.steps.min_early_samples as u64;
        if !lasted && !impossible {
            return Observation::Suspect;
        }
        let Some(Suspicion::Late { mut next, .. }) = self.suspicion.take() else {
            return Observation::Suspect;
        };
        next.refit(0.0, &self.tuning);
        let after = alarm.after.map_or(self.map.since, HostTime);
        self.step(*next, after, alarm.height)
    }

    /// An epoch of samples in order; samples whose tick does not increase are skipped.
    pub(super) fn epoch_of(&self, mut samples: impl Iterator<Item = Sample>) -> Option<Epoch> {
        let terms = self.epoch.as_ref().map_or(self.first_terms(), |epoch| {
            epoch.terms_for_next(&self.tuning)
        });
        let mut epoch = Epoch::starting(samples.next()?, terms, &self.tuning);
        for sample in samples {
            let p = epoch.point(sample);
            if p.x > epoch.newest_x() {
                epoch.push(p, &self.tuning);
            }
        }
        epoch.refit(0.0, &self.tuning);
        Some(epoch)
    }

    /// The clock has stepped: `next` replaces the epoch. Times after `after` are unreliable.
    pub(super) fn step(
        &mut self,
        next: impl Into<Option<Epoch>>,
        after: HostTime,
        shift: f64,
    ) -> Observation {
        let (Some(next), Some(last)) = (next.into(), self.last) else {
            return Observation::Suspect;
        };
        let now = HostTime(last.arrival);
        // Samples that were all late may be from either side of it.
        let after = after.min(HostTime(self.on_time)).max(self.map.since);
        let mark_unreliable = UnreliableSpan {
            from: after,
            to: if next.settled(&self.tuning) {
                now
            } else {
                HostTime::MAX
            },
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

    pub(super) fn begin(&mut self, epoch: Epoch, since: HostTime) {
        self.epoch = Some(epoch);
        self.map.since = since;
        self.on_time = since.ns();
        self.claims.clear();
        self.tail.restart();
        self.publish();
    }

    /// Time for which a step of `height` can remain undetected, ns of host time.
    pub(super) fn unnoticed(&self, height: f64) -> i64 {
        let period = self.epoch.as_ref().map_or(0.0, Epoch::period);
        (self.tail.overdue(height, &self.tuning.tail) as f64 * period) as i64
    }
}
