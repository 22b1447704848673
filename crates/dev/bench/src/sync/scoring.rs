//! One method in one world: errors and consistency.
//!
//! Errors are against the instant at which the sample was taken, which a tick gives only to its own
//! length: that is part of the error, and of the sigma that a method has to claim.

use super::methods::Method;
use super::world::{MS, Sample};
use crate::meter::quantile;

/// Errors are scored from here on, s after the start of the device.
pub(crate) const SCORED_FROM: f64 = 10.0;
/// A method without a sigma is silently wrong beyond this, ns.
pub(crate) const UNCLAIMED_NS: f64 = MS;
/// A method with a sigma is silently wrong beyond this many, …
pub(crate) const SIGMAS: f64 = 5.0;
/// … and has in effect raised a flag where it claims no better than this, ns.
pub(crate) const USELESS_NS: f64 = MS;

/// How a method did in a world.
#[derive(Clone, Debug, Default)]
pub(crate) struct Score {
    /// Errors after [`SCORED_FROM`] that nothing warned of, ns, ascending.
    pub errors: Vec<f64>,
    /// Like `errors`, for times mapped once more at the end.
    pub again: Vec<f64>,
    /// Samples in all, from the first.
    pub samples: usize,
    /// Flagged when their time was given, or later.
    pub flagged: usize,
    /// Wrong and not flagged when their time was given.
    pub silent_at_first: usize,
    /// Wrong and never flagged.
    pub silent: usize,
    /// Largest error in sigmas of those not flagged.
    pub worst_sigmas: f64,
    /// Sum of sigma over samples after [`SCORED_FROM`], not flagged.
    pub sigma_sum: f64,
}

/// How it ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Class {
    Ok,
    Flagged,
    SilentlyWrong,
}

impl Class {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Flagged => "flagged",
            Self::SilentlyWrong => "silently wrong",
        }
    }
}

impl Score {
    pub(crate) fn quantile(&self, share: f64) -> f64 {
        quantile(&self.errors, share)
    }

    pub(crate) fn mean_sigma(&self) -> f64 {
        self.sigma_sum / self.errors.len().max(1) as f64
    }

    /// *Flagged* when more than a hundredth of the samples after settling is.
    pub(crate) fn class(&self) -> Class {
        if self.silent > 0 {
            Class::SilentlyWrong
        } else if self.flagged * 100 > self.samples || self.errors.is_empty() {
            Class::Flagged
        } else {
            Class::Ok
        }
    }

    fn sort(&mut self) {
        for errors in [&mut self.errors, &mut self.again] {
            errors.sort_by(f64::total_cmp);
        }
    }

    /// The same method in several worlds.
    pub(crate) fn join(scores: Vec<Self>) -> Self {
        let mut all = Self::default();
        for score in scores {
            all.errors.extend(score.errors);
            all.again.extend(score.again);
            all.samples += score.samples;
            all.flagged += score.flagged;
            all.silent_at_first += score.silent_at_first;
            all.silent += score.silent;
            all.worst_sigmas = all.worst_sigmas.max(score.worst_sigmas);
            all.sigma_sum += score.sigma_sum;
        }
        all.sort();
        all
    }
}

/// Runs a method over samples.
pub(crate) fn run(method: &mut dyn Method, samples: &[Sample]) -> Score {
    let stamps: Vec<_> = samples.iter().map(|s| method.stamp(s)).collect();

    let mut score = Score::default();
    let scored_from = samples.first().map_or(0.0, |s| s.taken) + SCORED_FROM * 1e9;
    for (sample, stamp) in samples.iter().zip(stamps) {
        let Some(stamp) = stamp else { continue };
        let error = (stamp.time - sample.taken).abs();
        let allowed = stamp.sigma.map_or(UNCLAIMED_NS, |sigma| SIGMAS * sigma);
        let wrong = error > allowed || sample.corrupt;
        let unsure = stamp.flagged || stamp.sigma.is_some_and(|s| s > USELESS_NS);
        let scored = sample.taken >= scored_from;
        score.silent_at_first += usize::from(wrong && !unsure);
        let flagged = unsure || method.is_unreliable(sample.arrival);
        if scored {
            score.samples += 1;
            score.flagged += usize::from(flagged);
        }
        if !flagged {
            score.silent += usize::from(wrong && (stamp.sigma.is_some() || scored));
            if !sample.corrupt {
                let sigmas = error / stamp.sigma.unwrap_or(UNCLAIMED_NS);
                score.worst_sigmas = score.worst_sigmas.max(sigmas);
            }
            if scored && !sample.corrupt {
                score.errors.push(error);
                score.sigma_sum += stamp.sigma.unwrap_or(0.0);
                if let Some(again) = method.again(sample.ticks, sample.arrival) {
                    score.again.push((again.time - sample.taken).abs());
                }
            }
        }
    }
    score.sort();
    score
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sync::methods::Stamp;
    use crate::sync::world::World;

    /// Knows the true time, and states another one.
    struct Off {
        by: f64,
        sigma: f64,
        flagged: bool,
    }

    impl Method for Off {
        fn name(&self) -> &'static str {
            "off"
        }

        fn stamp(&mut self, sample: &Sample) -> Option<Stamp> {
            Some(Stamp {
                time: sample.taken + self.by,
                sigma: Some(self.sigma),
                flagged: self.flagged,
            })
        }
    }

    #[test]
    fn wrong_times_are_silent_unless_sigma_or_a_flag_says_so() {
        let samples = World::new(1, 400.0, 30.0).samples();
        for (by, sigma, flagged, class) in [
            (0.0, 1.0, false, Class::Ok),
            (4.9e3, 1e3, false, Class::Ok),
            (5.1e3, 1e3, false, Class::SilentlyWrong),
            (5.1e3, 1e3, true, Class::Flagged),
            (0.0, 2.0 * USELESS_NS, false, Class::Flagged),
        ] {
            let score = run(&mut Off { by, sigma, flagged }, &samples);
            assert_eq!(score.class(), class, "{by} {sigma} {flagged}");
        }
    }
}
