//! Times in which no frame shows a foot.
//!
//! Contract: while a person walks a foot is at rest where a camera sees it, or the next one is. In
//! a longer time without either foot, frames or poses of the rig are missing. A foot may have done
//! anything in it.

use crate::checks::unseen_intervals;
use crate::contact::{FootStances, seconds};

/// Time without either foot from which on events may be anywhere in it, s. Of people who run or who
/// take long steps, whose tags are outside of the image for a step, it is up to 1.2 s, and the gait
/// determines events better.
const MIN_UNSEEN_S: f64 = 1.25;
/// Time from the last frame of a foot at rest to such a time, without a frame of it, after which it
/// has left, s; likewise before its first frame at rest.
const NEAR_S: f64 = 0.3;

/// Ordered times in which no frame shows a foot: begin and end, s.
#[derive(Clone, Debug, Default)]
pub(super) struct UnseenIntervals(Vec<[f64; 2]>);

impl UnseenIntervals {
    pub(super) fn of(feet: &[FootStances<'_>; 2]) -> Self {
        let observations = feet.each_ref().map(|foot| foot.observations);
        Self(unseen_intervals(observations, MIN_UNSEEN_S))
    }

    /// The one before a stance, if no frame shows that foot between both.
    pub(super) fn before(&self, foot: &FootStances<'_>, index: usize) -> Option<[f64; 2]> {
        let stance = &foot.stances[index];
        let first_s = seconds(stance.times_ns[0]);
        let before = stance.observations.start.checked_sub(1);
        let seen_s = before.map_or(f64::NEG_INFINITY, |k| seconds(foot.observations[k].time_ns));
        let mut near = self.0.iter().rev();
        let own = near.find(|own| own[1] <= first_s)?;
        (first_s - own[1] < NEAR_S && seen_s <= own[0]).then_some(*own)
    }

    /// The one after a stance, likewise.
    pub(super) fn after(&self, foot: &FootStances<'_>, index: usize) -> Option<[f64; 2]> {
        let stance = &foot.stances[index];
        let last_s = seconds(stance.times_ns[1]);
        let after = foot.observations.get(stance.observations.end);
        let seen_s = after.map_or(f64::INFINITY, |own| seconds(own.time_ns));
        let own = self.0.iter().find(|own| own[0] >= last_s)?;
        (own[0] - last_s < NEAR_S && seen_s >= own[1]).then_some(*own)
    }
}
