//! The poses of a foot in the world, from one of its tags in each frame.
//!
//! Contract: of the two poses of a tag that images hardly distinguish, those count that fit each
//! other from frame to frame, and whose soles are more level. The covariance is that of the tag's
//! pose; errors of the rig's pose are not in it.

use cad_transforms::{Covariance, CovarianceError, RigidTransform};
use nalgebra::Vector3;

use self::tilt_prior::{TagPlace, TiltPrior, seconds_between, speed_before, tag_speed, tilt_prior};
use crate::config::FootConfig;
use crate::poses::motion;
use crate::stance::FootObservation;

mod tilt_prior;

/// A tag in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TagPose {
    /// Takes points of the tag to the rig, m.
    pub rig_from_tag: RigidTransform,
    /// Covariance of a small motion of the tag in its own axes.
    pub covariance: Covariance,
    /// Share of the tag that is visible, in the eye in which most of it is.
    pub visible_share: f64,
    /// A second pose that images hardly contradict more, and its cost above that of the first, in
    /// units of the variance of a pixel's noise.
    pub second: Option<(RigidTransform, f64)>,
}

/// A foot in a frame: its pose, and another one that images hardly contradict more.
#[derive(Clone, Debug, PartialEq)]
pub struct FootCandidates {
    time_ns: i64,
    /// Poses in the world, and the excess of their costs.
    poses: Vec<(RigidTransform, f64)>,
    covariance: Covariance,
    /// The middle of the tag in the world, which both poses agree about, m.
    tag_place: Vector3<f64>,
}

/// The poses of the foot that a tag is on, at a time, ns.
///
/// Its covariance is that of the tag, widened by the errors that fits have beyond it, in particular
/// where something covers a part of the tag.
///
/// # Errors
/// A configuration with which it is no covariance.
pub fn foot_candidates(
    time_ns: i64,
    world_from_rig: &RigidTransform,
    tag: &TagPose,
    foot_from_tag: &RigidTransform,
    config: &FootConfig,
) -> Result<FootCandidates, CovarianceError> {
    let tag_from_foot = foot_from_tag.inverse();
    let first = Some((tag.rig_from_tag, 0.0));
    let poses = first.into_iter().chain(tag.second);
    let in_world =
        |(pose, excess): (RigidTransform, f64)| (*world_from_rig * pose * tag_from_foot, excess);
    let factor = match tag.visible_share < config.whole_share {
        true => config.covered_sigma_factor,
        false => config.sigma_factor,
    };
    let wider = tag.covariance.moved(foot_from_tag).matrix() * (factor * factor);
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| wider[(i, j)]));
    Ok(FootCandidates {
        time_ns,
        poses: poses.map(in_world).collect(),
        covariance: Covariance::from_rows(rows)?,
        tag_place: Vector3::from((*world_from_rig * tag.rig_from_tag).translation_m()),
    })
}

/// The poses of a foot, at most one for each time, from candidates in order of time.
///
/// Of several tags at a time the surest counts. Of its poses that one counts with which the whole
/// sequence is most probable (Viterbi).
///
/// ```
/// use cad_transforms::{Covariance, RigidTransform};
/// use feet::FootConfig;
/// use feet::observation::{TagPose, foot_candidates, foot_observations};
///
/// // Both poses of a tag below the rig: one is that of a level sole.
/// let tilted = |angle| RigidTransform::from_rotation_vector([angle, 0.0, 0.0], [0.2, 0.1, -1.2]);
/// let tag = TagPose {
///     rig_from_tag: tilted(0.4)?,
///     covariance: Covariance::from_sigmas([1e-3; 3], [0.02; 3])?,
///     visible_share: 1.0,
///     second: Some((tilted(0.0)?, 3.0)),
/// };
/// let foot_from_tag = RigidTransform::from_translation_m([0.05, 0.0, 0.08])?;
/// let rig = RigidTransform::from_translation_m([0.0, 0.0, 1.3])?;
/// let config = FootConfig::default();
/// let foot = foot_candidates(0, &rig, &tag, &foot_from_tag, &config)?;
/// let foot = foot_observations([foot], &config);
/// assert!((foot[0].world_from_foot.translation_m()[2] - 0.02).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn foot_observations(
    candidates: impl IntoIterator<Item = FootCandidates>,
    config: &FootConfig,
) -> Vec<FootObservation> {
    let frames = surest(candidates);
    let places = places(&frames);
    let costs = costs(&frames, |k| tilt_prior(&places, k, config), config);
    let mut next = costs.last().and_then(|last| cheapest(last));
    let mut found = Vec::with_capacity(frames.len());
    for (frame, ends) in frames.iter().zip(&costs).rev() {
        let Some(chosen) = next else {
            break;
        };
        found.push(frame.observation(chosen));
        next = Some(ends[chosen].1);
    }
    found.reverse();
    without_outliers(found, config)
}

/// Observations without those that are rotated against the ones before and after them, which agree
/// with each other: fits of a tag that ended in a wrong pose.
fn without_outliers(found: Vec<FootObservation>, config: &FootConfig) -> Vec<FootObservation> {
    let is_outlier = |k: usize| {
        let (Some(before), Some(after)) = (k.checked_sub(1).map(|k| &found[k]), found.get(k + 1))
        else {
            return false;
        };
        let cost = |a: &FootObservation, b: &FootObservation| {
            let seconds = 1e-9 * (b.time_ns - a.time_ns) as f64;
            change_cost(a, b, config.turn_rate * seconds, config)
        };
        let own = cost(before, &found[k]).min(cost(&found[k], after));
        own >= config.max_change_cost && cost(before, after) < config.agreeing_change_cost
    };
    let is_sound: Vec<bool> = (0..found.len()).map(|k| !is_outlier(k)).collect();
    let parts = found.into_iter().zip(is_sound);
    parts
        .filter_map(|(own, is_sound)| is_sound.then_some(own))
        .collect()
}

/// The same by what frames show until then: each pose is the most probable one without later
/// frames.
pub fn causal_observations(
    candidates: impl IntoIterator<Item = FootCandidates>,
    config: &FootConfig,
) -> Vec<FootObservation> {
    let frames = surest(candidates);
    let places = places(&frames);
    let prior = |k: usize| TiltPrior::of_speed(speed_before(&places, k, config), config);
    let costs = costs(&frames, prior, config);
    let parts = frames.iter().zip(&costs);
    parts
        .filter_map(|(frame, ends)| Some(frame.observation(cheapest(ends)?)))
        .collect()
}

/// The pose with which a sequence ends at the least cost.
fn cheapest(ends: &[(f64, usize)]) -> Option<usize> {
    let ends = ends.iter().enumerate();
    let least = ends.min_by(|a, b| a.1.0.total_cmp(&b.1.0));
    least.map(|(chosen, _)| chosen)
}

fn places(frames: &[FootCandidates]) -> Vec<TagPlace> {
    frames.iter().map(FootCandidates::place).collect()
}

impl FootCandidates {
    fn place(&self) -> TagPlace {
        TagPlace {
            time_ns: self.time_ns,
            place: self.tag_place,
        }
    }

    fn observation(&self, chosen: usize) -> FootObservation {
        FootObservation {
            time_ns: self.time_ns,
            world_from_foot: self.poses[chosen].0,
            covariance: self.covariance,
        }
    }
}

/// By frame and pose: the least cost with which a sequence ends there, and the pose before it.
fn costs(
    frames: &[FootCandidates],
    prior: impl Fn(usize) -> TiltPrior,
    config: &FootConfig,
) -> Vec<Vec<(f64, usize)>> {
    let mut costs: Vec<Vec<(f64, usize)>> = Vec::with_capacity(frames.len());
    for (k, frame) in frames.iter().enumerate() {
        let prior = prior(k);
        let cost = |(m, pose): (usize, &(RigidTransform, f64))| {
            let own = own_cost(pose, &prior, config);
            let Some(before) = k.checked_sub(1).map(|before| &frames[before]) else {
                return (own, 0);
            };
            let here = frame.observation(m);
            let through = costs[k - 1].iter().enumerate().map(|(n, (cost, _))| {
                let (from, places) = (before.observation(n), [before.place(), frame.place()]);
                let seconds = seconds_between(&places[0], &places[1]);
                let rate = turn_rate(tag_speed(&places[0], &places[1]), config);
                let change = change_cost(&from, &here, rate * seconds, config);
                (own + cost + change, n)
            });
            let least = through.min_by(|a, b| a.0.total_cmp(&b.0));
            least.unwrap_or((own, 0))
        };
        let ends: Vec<(f64, usize)> = frame.poses.iter().enumerate().map(cost).collect();
        costs.push(ends);
    }
    costs
}

/// How improbable a pose is by itself.
fn own_cost((pose, excess): &(RigidTransform, f64), prior: &TiltPrior, config: &FootConfig) -> f64 {
    let [toe, left] = [Vector3::x(), Vector3::y()].map(|axis| (pose.rotation() * axis).z);
    let [pitch, roll] = [toe, left].map(|rise| libm::asin(rise.clamp(-1.0, 1.0)));
    let square = (pitch - prior.pitch).powi(2) + roll * roll;
    square / (prior.sigma * prior.sigma) + excess / config.excess_per_square
}

/// Angular rate of a foot whose tag moves at a speed, m/s: a foot that rolls moves its tag.
fn turn_rate(tag_speed: f64, config: &FootConfig) -> f64 {
    (config.rest_turn_rate + config.turn_rate_per_speed * tag_speed).min(config.turn_rate)
}

/// How improbable the rotation from a frame to the next one is, of a foot that usually turns by an
/// angle in that time, rad.
fn change_cost(
    a: &FootObservation,
    b: &FootObservation,
    usual_rad: f64,
    config: &FootConfig,
) -> f64 {
    let turn = motion(&a.world_from_foot, &b.world_from_foot)
        .fixed_rows::<3>(3)
        .norm();
    let sigma = |own: &FootObservation| {
        own.covariance.sigmas()[3..]
            .iter()
            .fold(0.0, |a: f64, b| a.max(*b))
    };
    let tilt = sigma(a).hypot(sigma(b));
    let spread = tilt.hypot(usual_rad);
    (turn / spread).powi(2).min(config.max_change_cost)
}

/// At most one for each time, the surest.
fn surest(candidates: impl IntoIterator<Item = FootCandidates>) -> Vec<FootCandidates> {
    let mut surest: Vec<FootCandidates> = Vec::new();
    let sigma = |own: &FootCandidates| own.covariance.matrix().trace();
    for own in candidates {
        match surest.last_mut() {
            Some(last) if last.time_ns == own.time_ns => {
                if sigma(&own) < sigma(last) {
                    *last = own;
                }
            }
            _ => surest.push(own),
        }
    }
    surest
}

#[cfg(test)]
mod tests;
