//! Feet that step on the spot: to where they stood before.
//!
//! Contract: frames that show a foot away from a stance for as long as a swing divide it, and a rest
//! in mid-air between two stances is none.

use std::ops::Range;

use super::pose_check::PoseCheck;
use super::{FootObservation, Stance};
use crate::config::StanceConfig;

/// Least number of frames that show a foot away from its place.
const MIN_AWAY_FRAMES: usize = 2;
/// The stances without those above the ones before and after them with hardly a time in between: a
/// foot that steps on the spot is slow on top of its swing.
pub(super) fn without_hovering(stances: Vec<Stance>, config: &StanceConfig) -> Vec<Stance> {
    let is_above = |k: usize, other: usize| {
        let [own, other] = [k, other].map(|k: usize| &stances[k]);
        let gap_s = own.seconds_until(other).max(other.seconds_until(own));
        let rise = own.world_from_foot.translation().z - other.world_from_foot.translation().z;
        gap_s < config.min_swing_s && rise > config.max_deviation_m
    };
    let hovers = |k: usize| {
        let is_last = k + 1 == stances.len();
        k > 0 && is_above(k, k - 1) && (is_last || is_above(k, k + 1))
    };
    let rests: Vec<bool> = (0..stances.len()).map(|k| !hovers(k)).collect();
    let both = stances.into_iter().zip(rests);
    both.filter_map(|(stance, rests)| rests.then_some(stance))
        .collect()
}

/// The longest run of frames in a stance that do not belong to it, if it is as long as a swing.
pub(super) fn step_on_the_spot(
    observations: &[FootObservation],
    stance: &Stance,
    config: &StanceConfig,
) -> Option<Range<usize>> {
    let check = PoseCheck::new(observations, stance.observations.start, config);
    let mut longest = (config.min_swing_s, None);
    let mut last = stance.observations.start;
    for k in stance.observations.clone() {
        if !check.agrees(&stance.world_from_foot, &observations[k]) {
            continue;
        }
        let away_s = 1e-9 * (observations[k].time_ns - observations[last].time_ns) as f64;
        if k - last > MIN_AWAY_FRAMES && away_s > longest.0 {
            longest = (away_s, Some(last + 1..k));
        }
        last = k;
    }
    longest.1
}
