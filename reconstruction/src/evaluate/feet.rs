//! Evaluation of contacts and poses of feet, and of the ground below them, against ground truth.
//!
//! Contract: positions are compared after the alignment of the trajectory, so they contain its
//! error. A true contact counts if it lies within the recorded time with a margin of half a second;
//! an estimated one belongs to it if their heel strikes are within a quarter of a second. An
//! estimated contact is invented if the foot bore on the ground at none of its times.

use scene_bundle::outputs::contacts::FootContact;
use scene_bundle::outputs::feet::{FootPose, FootStatus};
use scene_bundle::outputs::maps::{KNOWN, MapLevel};
use serde::Serialize;

use super::Similarity;
use super::ground_truth::{GroundTruth, TrueContact};
use super::statistics::Statistics;

/// Time at either end of the recording within which contacts are not compared, ns.
const MARGIN_NS: i64 = 500_000_000;
/// Maximum time between the estimated and the true heel strike of a contact, ns.
const MATCH_NS: i64 = 250_000_000;
/// Maximum height of a level above or below a true footstep that it can be the ground of, m: a
/// cell of another storey is none.
const MAX_LEVEL_M: f64 = 0.3;
/// 95 % of a chi-squared distribution with three degrees of freedom.
const CHI_SQUARED_95: f64 = 7.815;

/// Errors of contacts and poses of feet.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FeetEvaluation {
    /// True contacts within the recording.
    pub contacts: usize,
    /// Those that were found.
    pub found: usize,
    /// Estimated contacts while the foot did not bear on the ground.
    pub invented: usize,
    /// Distances of the middle of the sole at rest from its true position, m.
    pub position_m: Option<Statistics>,
    /// Errors of heel strikes and toe offs, s.
    pub heel_strike_s: Option<Statistics>,
    /// As above.
    pub toe_off_s: Option<Statistics>,
    /// Distances of the middle of the sole in bridged swings, m.
    pub bridged_m: Option<Statistics>,
    /// Share of those within the stated ellipsoid of 95 %.
    pub bridged_within: f64,
    /// Share of all poses that are lost.
    pub lost: f64,
}

/// Compares feet with ground truth.
pub fn evaluate_feet(
    contacts: &[FootContact],
    poses: &[FootPose],
    truth: &GroundTruth,
    true_from_estimated: &Similarity,
) -> FeetEvaluation {
    let times = poses.iter().map(|pose| pose.time_ns);
    let (Some(first), Some(last)) = (times.clone().min(), times.max()) else {
        return FeetEvaluation::default();
    };
    let compared = first + MARGIN_NS..=last - MARGIN_NS;
    let is_whole = |contact: &&TrueContact| {
        let [strike, .., toe_off] = contact.events_ns;
        let inside = |time: Option<i64>| time.is_some_and(|time| compared.contains(&time));
        inside(strike) && inside(toe_off)
    };
    let whole = truth.contacts.iter().filter(is_whole);
    let mut result = FeetEvaluation::default();
    let (mut position, mut strikes, mut toe_offs) = (Vec::new(), Vec::new(), Vec::new());
    for own in whole {
        result.contacts += 1;
        let Some(estimate) = contacts.iter().find(|estimate| matches(estimate, own)) else {
            continue;
        };
        result.found += 1;
        let aligned = true_from_estimated.apply(&estimate.world_from_foot);
        position.push((own.world_from_foot.inverse() * aligned).distance_m());
        for (event, errors) in [(0, &mut strikes), (3, &mut toe_offs)] {
            if let Some(time) = own.events_ns[event] {
                errors.push(1e-9 * (estimate.events[event].time_ns - time).abs() as f64);
            }
        }
    }
    result.invented = contacts
        .iter()
        .filter(|estimate| !truth.contacts.iter().any(|own| overlap(estimate, own)))
        .count();
    let (mut bridged, mut within) = (Vec::new(), 0_usize);
    for pose in poses {
        let truth = truth.world_from_foot(pose.foot, pose.time_ns);
        if let (FootStatus::Bridged, Some(truth)) = (pose.status, truth) {
            let motion = true_from_estimated.apply(&pose.world_from_foot).inverse() * truth;
            bridged.push(motion.distance_m());
            within += usize::from(is_within(pose, motion.translation_m()));
        }
    }
    result.bridged_within = within as f64 / bridged.len().max(1) as f64;
    let lost = poses.iter().filter(|pose| pose.status == FootStatus::Lost);
    result.lost = lost.count() as f64 / poses.len().max(1) as f64;
    FeetEvaluation {
        position_m: Statistics::of(position),
        heel_strike_s: Statistics::of(strikes),
        toe_off_s: Statistics::of(toe_offs),
        bridged_m: Statistics::of(bridged),
        ..result
    }
}

fn matches(estimate: &FootContact, own: &TrueContact) -> bool {
    let strike = own.events_ns[0];
    let is_near = |strike: i64| (estimate.events[0].time_ns - strike).abs() <= MATCH_NS;
    estimate.foot == own.foot && strike.is_some_and(is_near)
}

/// Whether the foot bore on the ground while the estimated contact says that it was at rest.
fn overlap(estimate: &FootContact, own: &TrueContact) -> bool {
    let [strike, .., toe_off] = own.events_ns;
    estimate.foot == own.foot
        && strike.is_none_or(|strike| strike <= estimate.events[2].time_ns)
        && toe_off.is_none_or(|toe_off| toe_off >= estimate.events[1].time_ns)
}

fn is_within(pose: &FootPose, error: [f64; 3]) -> bool {
    let error = nalgebra::Vector3::from(error);
    let square = pose.covariance.as_ref().and_then(|covariance| {
        let own = covariance.matrix().fixed_view::<3, 3>(0, 0).into_owned();
        Some(error.dot(&(own.try_inverse()? * error)))
    });
    square.is_some_and(|square| square <= CHI_SQUARED_95)
}

/// Errors of the ground under true footsteps.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct GroundEvaluation {
    /// True footsteps within the recording.
    pub footsteps: usize,
    /// Those with ground that depth shows.
    pub shown: usize,
    /// Errors of the height below the middle of the sole, from depth and contacts, m.
    pub height_m: Option<Statistics>,
}

/// Compares the maps with the heights of true footsteps within `times` (ns), which are those of
/// the recording.
pub fn evaluate_ground(
    levels: &[MapLevel],
    truth: &GroundTruth,
    times: std::ops::RangeInclusive<i64>,
    true_from_estimated: &Similarity,
) -> GroundEvaluation {
    let estimated_from_true = true_from_estimated.rigid.inverse();
    let mut result = GroundEvaluation::default();
    let mut errors = Vec::new();
    for own in &truth.contacts {
        let is_inside = |time: Option<i64>| time.is_some_and(|time| times.contains(&time));
        if !(is_inside(own.events_ns[1]) && is_inside(own.events_ns[2])) {
            continue;
        }
        result.footsteps += 1;
        let [x, y, z] = estimated_from_true.apply(own.world_from_foot.translation_m());
        let below = levels.iter().filter_map(|level| {
            let cell = level.grid.cell([x, y])?;
            let height = f64::from(*level.elevation.get(cell)?);
            let error = (height - z).abs();
            (level.has_height(cell) && error <= MAX_LEVEL_M)
                .then_some((error, level.flags[cell] & KNOWN != 0))
        });
        if let Some((error, is_shown)) = below.min_by(|a, b| a.0.total_cmp(&b.0)) {
            errors.push(error);
            result.shown += usize::from(is_shown);
        }
    }
    result.height_m = Statistics::of(errors);
    result
}

#[cfg(test)]
mod tests;
