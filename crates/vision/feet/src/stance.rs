//! Where a foot is at rest: its stances, from its poses in frames.
//!
//! Contract: observations come in order of time. A stance is a run of frames in which the foot
//! hardly moves or turns, with one pose, to which frames that contradict it do not contribute. A
//! foot that slides, turns or steps on the spot has two stances. Frames in which it rolls over heel
//! or toe belong to none.

use std::ops::Range;

use cad_transforms::{Covariance, RigidTransform};
use nalgebra::{Matrix6, Vector4, Vector6};

use self::sure_point::{MAX_SIGMA_M, SurePoint, is_small};
use crate::config::StanceConfig;
use crate::poses::motion;

mod sure_point;

/// Standard deviations, in six dimensions, by which motions of a foot at rest seem to differ from
/// none: fewer in 99.5 % of the cases.
const SIGMAS: f64 = 4.3;

/// Least number of frames that show a foot away from its place.
const MIN_AWAY_FRAMES: usize = 2;
/// Number of frames of a run that are tried as its pose.
const SOME_FRAMES: usize = 16;

/// A foot in the world at the time of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootObservation {
    /// Time of the frame, ns.
    pub time_ns: i64,
    /// Takes points of the foot to the world, m.
    pub world_from_foot: RigidTransform,
    /// Covariance of a small motion of the foot in its own axes, without errors that neighboring
    /// frames share.
    pub covariance: Covariance,
}

/// A foot at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Stance {
    /// Its observations, some of which may contradict it.
    pub observations: Range<usize>,
    /// Times of the first and the last one, ns.
    pub times_ns: [i64; 2],
    /// Takes points of the foot to the world, m.
    pub world_from_foot: RigidTransform,
    /// Covariance of a small motion of the foot in its own axes.
    pub covariance: Covariance,
}

impl Stance {
    /// From the first observation to the last, s.
    fn duration_s(&self) -> f64 {
        1e-9 * (self.times_ns[1] - self.times_ns[0]) as f64
    }

    fn seconds_until(&self, next: &Self) -> f64 {
        1e-9 * (next.times_ns[0] - self.times_ns[1]) as f64
    }
}

/// All stances of a foot, in order of time.
///
/// ```
/// use cad_transforms::{Covariance, RigidTransform};
/// use feet::GaitConfig;
/// use feet::stance::{FootObservation, stances};
///
/// // At rest for half a second, then moving at 2 m/s.
/// let covariance = Covariance::from_sigmas([2e-3; 3], [0.01; 3])?;
/// let observations = (0..16).map(|n| {
///     let x = 2.0 / 15.0 * f64::from((n - 8_i32).max(0));
///     Ok(FootObservation {
///         time_ns: i64::from(n) * 66_666_667,
///         world_from_foot: RigidTransform::from_translation_m([x, 0.0, 0.0])?,
///         covariance,
///     })
/// });
/// let observations = observations.collect::<Result<Vec<_>, Box<dyn std::error::Error>>>()?;
/// let found = stances(&observations, &GaitConfig::default().stance);
/// assert_eq!(found.len(), 1);
/// assert_eq!(found[0].observations, 0..9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn stances(observations: &[FootObservation], config: &StanceConfig) -> Vec<Stance> {
    let mut found: Vec<Stance> = Vec::new();
    for run in runs_at_rest(observations, config) {
        let parts = without_drift(observations, run, config).into_iter();
        for stance in parts.flat_map(|part| stances_of(observations, part, config)) {
            match found.last_mut() {
                Some(last) if is_continued(last, &stance, config) => {
                    let whole = last.observations.start..stance.observations.end;
                    match stances_of(observations, whole, config).as_slice() {
                        [joint] => *last = joint.clone(),
                        _ => found.push(stance),
                    }
                }
                // No foot takes a step in between.
                Some(last) if is_part_of_one_contact(last, &stance, config) => {
                    *last = one_contact(last, &stance, config);
                }
                _ => found.push(stance),
            }
        }
    }
    without_hovering(found, config)
}

/// The stances without those above the ones before and after them with hardly a time in between: a
/// foot that steps on the spot is slow on top of its swing.
fn without_hovering(stances: Vec<Stance>, config: &StanceConfig) -> Vec<Stance> {
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

/// Runs of observations between which a foot hardly moves, besides single ones that contradict
/// those before and after them.
pub(crate) fn runs_at_rest(
    observations: &[FootObservation],
    config: &StanceConfig,
) -> Vec<Range<usize>> {
    let mut runs = Vec::new();
    let (mut begin, mut last) = (0, 0);
    let agrees = |a: usize, b: usize| {
        let next = observations.get(b);
        next.is_some_and(|next| is_at_rest(&observations[a], next, config))
    };
    for k in 1..=observations.len() {
        if agrees(last, k) {
            last = k;
        } else if !agrees(last, k + 1) {
            if last + 1 - begin >= config.min_frames {
                runs.push(begin..last + 1);
            }
            (begin, last) = (k, k);
        }
    }
    runs
}

fn is_at_rest(a: &FootObservation, b: &FootObservation, config: &StanceConfig) -> bool {
    let seconds = 1e-9 * (b.time_ns - a.time_ns) as f64;
    let motion = motion(&a.world_from_foot, &b.world_from_foot);
    let covariance = a.covariance.matrix() + b.covariance.matrix();
    let tolerance = [config.max_speed * seconds, config.max_rate * seconds];
    let whole = || is_within(&motion, &covariance, tolerance);
    let place = || {
        let point = SurePoint::of(&a.covariance);
        let displacement = point.displacement(&a.world_from_foot, &b.world_from_foot);
        let covariance = point.covariance(&a.covariance) + point.covariance(&b.covariance);
        is_small(&displacement, &covariance, config.max_place_speed * seconds)
    };
    seconds <= config.max_gap_s && (whole() || place())
}

/// Whether a motion is none, within a tolerance of its translation and rotation and errors of
/// poses. A pose whose tilt is uncertain tells the place of its tag well all the same, which moves
/// when the foot rolls: both are in its covariance.
fn is_within(motion: &Vector6<f64>, covariance: &Matrix6<f64>, [m, rad]: [f64; 2]) -> bool {
    let [m, rad] = [m, rad].map(|tolerance| (tolerance / SIGMAS).powi(2));
    let spread = known(covariance) + Matrix6::from_diagonal(&Vector6::new(m, m, m, rad, rad, rad));
    let square = spread
        .try_inverse()
        .map(|inverse| motion.dot(&(inverse * motion)));
    square.is_some_and(|square| square < SIGMAS * SIGMAS)
}

/// A covariance with which a pose tells something: position uncertain by at most `MAX_SIGMA_M`.
fn known(covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let position = covariance.try_inverse().and_then(|inverse| {
        let position = inverse.fixed_view::<3, 3>(0, 0).into_owned();
        position.try_inverse()
    });
    let variance = position.map_or(0.0, |position| position.diagonal().max());
    let scale = MAX_SIGMA_M * MAX_SIGMA_M / variance.max(1e-18);
    covariance * scale.min(1.0)
}

/// The parts of a run between which the foot does not slide or turn.
fn without_drift(
    observations: &[FootObservation],
    run: Range<usize>,
    config: &StanceConfig,
) -> Vec<Range<usize>> {
    let mut parts = Vec::new();
    let mut rest = vec![run];
    while let Some(run) = rest.pop() {
        match largest_step(&observations[run.clone()], config) {
            Some(at) => {
                rest.push(run.start + at..run.end);
                rest.push(run.start..run.start + at);
            }
            None => parts.push(run),
        }
    }
    parts.retain(|part| part.len() >= config.min_frames);
    parts
}

/// Where the places and headings before and after differ most, if they differ more than those of a
/// foot at rest do. A foot that tilts moves its tag.
fn largest_step(run: &[FootObservation], config: &StanceConfig) -> Option<usize> {
    let first = run.first()?;
    let point = SurePoint::of(&first.covariance);
    let zero = (Vector4::zeros(), [0.0; 2], 0.0);
    let contradicts = |k: usize| {
        let inside = k > 0 && k + 1 < run.len();
        inside
            && !is_at_rest(&run[k - 1], &run[k], config)
            && !is_at_rest(&run[k], &run[k + 1], config)
    };
    let sums = (run.iter().enumerate()).scan(zero, |(sum, squares, count), (k, own)| {
        if !contradicts(k) {
            let [x, y, z] = point
                .displacement(&first.world_from_foot, &own.world_from_foot)
                .into();
            let heading = motion(&first.world_from_foot, &own.world_from_foot)[5];
            *sum += Vector4::new(x, y, z, heading);
            let variances = [
                point.covariance(&own.covariance).diagonal().max(),
                own.covariance.matrix()[(5, 5)],
            ];
            *squares = [0, 1].map(|k| squares[k] + variances[k]);
            *count += 1.0;
        }
        Some((*sum, *squares, *count))
    });
    let sums: Vec<(Vector4<f64>, [f64; 2], f64)> = sums.collect();
    let (all, all_squares, all_count) = sums.last()?;
    let candidates = config.min_frames..(run.len() + 1).saturating_sub(config.min_frames);
    let mut largest = (1.0, None);
    for at in candidates {
        let (sum, squares, count) = &sums[at - 1];
        let [before, after] = [*count, all_count - count];
        let change = (all - sum) / after - sum / before;
        let (distance, angle) = (change.xyz().norm(), change.w.abs());
        let [sigma_m, sigma_rad] = [0, 1].map(|k| {
            let of_after = (all_squares[k] - squares[k]) / (after * after);
            (squares[k] / (before * before) + of_after).sqrt()
        });
        let drift = (distance / (config.max_drift_m + 3.0 * sigma_m))
            .max(angle / (config.max_drift_rad + 3.0 * sigma_rad));
        if drift > largest.0 {
            largest = (drift, Some(at));
        }
    }
    largest.1
}

/// The stances of a run: more than one if the foot leaves its place and returns to it.
fn stances_of(
    observations: &[FootObservation],
    run: Range<usize>,
    config: &StanceConfig,
) -> Vec<Stance> {
    let Some(stance) = stance(observations, run, config) else {
        return Vec::new();
    };
    match step_on_the_spot(observations, &stance, config) {
        Some(step) => {
            let Range { start, end } = stance.observations;
            let both = [start..step.start, step.end..end].into_iter();
            both.flat_map(|run| stances_of(observations, run, config))
                .collect()
        }
        None => vec![stance],
    }
}

/// The longest run of frames in a stance that do not belong to it, if it is as long as a swing.
fn step_on_the_spot(
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

/// Whether frames show a foot at a pose.
struct PoseCheck<'a> {
    point: SurePoint,
    config: &'a StanceConfig,
}

impl<'a> PoseCheck<'a> {
    fn new(observations: &[FootObservation], first: usize, config: &'a StanceConfig) -> Self {
        let point = SurePoint::of(&observations[first].covariance);
        Self { point, config }
    }

    fn agrees(&self, world_from_foot: &RigidTransform, own: &FootObservation) -> bool {
        let config = self.config;
        let motion = motion(world_from_foot, &own.world_from_foot);
        let tolerance = [config.max_deviation_m, config.max_deviation_rad];
        is_within(&motion, own.covariance.matrix(), tolerance) || {
            let displacement = self
                .point
                .displacement(world_from_foot, &own.world_from_foot);
            let covariance = self.point.covariance(&own.covariance);
            is_small(&displacement, &covariance, 0.5 * config.max_deviation_m)
        }
    }
}

/// The stance of a run, trimmed to the frames that belong to it; `None` if these are too few.
fn stance(
    observations: &[FootObservation],
    mut run: Range<usize>,
    config: &StanceConfig,
) -> Option<Stance> {
    let check = PoseCheck::new(observations, run.start, config);
    let mut pose = mean(&observations[run.clone()], config);
    loop {
        let belongs = |k: usize| check.agrees(&pose.0, &observations[k]);
        let first = run.clone().find(|k| belongs(*k))?;
        let last = run.clone().rfind(|k| belongs(*k))?;
        let trimmed = first..last + 1;
        if trimmed.len() < config.min_frames {
            return None;
        }
        if trimmed == run {
            break;
        }
        run = trimmed;
        pose = mean(&observations[run.clone()], config);
    }
    let [plane, normal, tilt, heading] = config.shared_sigma;
    let shared = [plane, plane, normal, tilt, tilt, heading].map(|sigma| sigma * sigma);
    let covariance = pose.1 + Matrix6::from_diagonal(&Vector6::from(shared));
    Some(Stance {
        times_ns: [run.start, run.end - 1].map(|k| observations[k].time_ns),
        observations: run,
        world_from_foot: pose.0,
        covariance: crate::poses::covariance(&covariance)?,
    })
}

/// Whether a foot that was hidden has not moved in between.
fn is_continued(a: &Stance, b: &Stance, config: &StanceConfig) -> bool {
    let [distance, angle] = sizes(&motion(&a.world_from_foot, &b.world_from_foot));
    let [sigma_m, sigma_rad] = sigmas(&(a.covariance.matrix() + b.covariance.matrix()));
    a.seconds_until(b) < config.max_hidden_s
        && distance < config.max_deviation_m + 2.0 * sigma_m
        && angle < config.max_deviation_rad + 2.0 * sigma_rad
}

/// Whether one of two stances is too short, and too near to the other one, to be one of its own.
fn is_part_of_one_contact(a: &Stance, b: &Stance, config: &StanceConfig) -> bool {
    let shorter_s = a.duration_s().min(b.duration_s());
    a.seconds_until(b) < config.min_swing_s && shorter_s < config.min_swing_s
}

/// The stance of two that are parts of one contact: the longer one. The foot rests in the shorter
/// one as well if it is hardly displaced there; otherwise it comes down or lifts in it.
fn one_contact(a: &Stance, b: &Stance, config: &StanceConfig) -> Stance {
    let longer = if b.duration_s() > a.duration_s() {
        b
    } else {
        a
    };
    let [distance, angle] = sizes(&motion(&a.world_from_foot, &b.world_from_foot));
    let rests = distance < config.max_settling_m && angle < config.max_settling_rad;
    let mut stance = longer.clone();
    if rests {
        stance.observations = a.observations.start..b.observations.end;
        stance.times_ns = [a.times_ns[0], b.times_ns[1]];
    }
    stance
}

/// Mean pose, and covariance of it by independent errors of the frames. Frames far from it count
/// less.
fn mean(run: &[FootObservation], config: &StanceConfig) -> (RigidTransform, Matrix6<f64>) {
    const ROUNDS: usize = 4;
    let mut pose = usual_pose(run, config);
    let [m, rad] = config.frame_sigma.map(|sigma| sigma * sigma);
    let of_frame = Matrix6::from_diagonal(&Vector6::new(m, m, m, rad, rad, rad));
    let mut information = Matrix6::zeros();
    for _ in 0..ROUNDS {
        let (mut sum, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
        for own in run {
            let motion = motion(&pose, &own.world_from_foot);
            let weight = 1.0 / (1.0 + deviation(&motion, config).powi(2));
            let Some(inverse) = (own.covariance.matrix() + of_frame).try_inverse() else {
                continue;
            };
            sum += inverse * weight;
            gradient += inverse * motion * weight;
        }
        let Some(inverse) = sum.try_inverse() else {
            break;
        };
        information = sum;
        let [x, y, z, a, b, c]: [f64; 6] = (inverse * gradient).into();
        let Ok(step) = RigidTransform::from_rotation_vector([a, b, c], [x, y, z]) else {
            break;
        };
        pose = pose * step;
    }
    (
        pose,
        information.try_inverse().unwrap_or_else(Matrix6::identity),
    )
}

/// The pose of the frame, of some of a run, to which the others are nearest: far ones all alike.
fn usual_pose(run: &[FootObservation], config: &StanceConfig) -> RigidTransform {
    let some = |count: usize| run.iter().step_by(run.len().div_ceil(count));
    let distance = |own: &FootObservation| {
        let others = some(4 * SOME_FRAMES).map(|other| {
            let motion = motion(&own.world_from_foot, &other.world_from_foot);
            deviation(&motion, config).powi(2).min(1.0)
        });
        others.sum::<f64>()
    };
    let candidates = some(SOME_FRAMES).map(|own| (distance(own), own.world_from_foot));
    let usual = candidates.min_by(|a, b| a.0.total_cmp(&b.0));
    usual.map_or(run[0].world_from_foot, |(_, pose)| pose)
}

/// A motion relative to what frames of a stance deviate by at most.
fn deviation(motion: &Vector6<f64>, config: &StanceConfig) -> f64 {
    let [distance, angle] = sizes(motion);
    (distance / config.max_deviation_m).max(angle / config.max_deviation_rad)
}

/// Distance, m, and angle, rad, of a motion.
fn sizes(motion: &Vector6<f64>) -> [f64; 2] {
    [
        motion.fixed_rows::<3>(0).norm(),
        motion.fixed_rows::<3>(3).norm(),
    ]
}

/// Largest standard deviations of translation, m, and rotation, rad, along an axis.
fn sigmas(covariance: &Matrix6<f64>) -> [f64; 2] {
    let largest = |from: usize| {
        let variances = (from..from + 3).map(|k| covariance[(k, k)]);
        variances.fold(0.0, f64::max).sqrt()
    };
    [largest(0), largest(3)]
}

#[cfg(test)]
mod tests;
