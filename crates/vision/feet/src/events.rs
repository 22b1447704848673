//! Times of contacts: heel strike, foot flat, heel off, toe off.
//!
//! Contract: each event has a standard deviation and says whether images show it or it follows from
//! the gait. Heel strikes come from the approach of the heel to where it then rests and from when
//! the sole is flat, as the mean of their distribution over time; one that no frame shows is in the
//! middle between those of the other foot. Where toes leave the ground no camera sees them: their
//! time follows from the strike of the other foot.
//!
//! Source of the share of a stride in which a foot bears, 0.642 - 0.035 v for a speed v in m/s:
//! Kirtley, Whittle, Jefferson, "Influence of walking speed on gait parameters", J. Biomed. Eng. 7,
//! 1985. Heels lift after 0.30 to 0.40 of a stride: Perry, Burnfield, "Gait Analysis", 2nd ed.,
//! 2010.

use nalgebra::{Matrix2, Vector2, Vector3};

use crate::config::EventConfig;
use crate::stance::{FootObservation, Stance};

/// An instant of a contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// Its time, s, from the same zero as that of observations.
    pub time_s: f64,
    /// Standard deviation of that, s.
    pub sigma_s: f64,
    /// Whether images show it.
    pub is_seen: bool,
}

/// A contact of a foot with the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    /// The foot at rest.
    pub stance: Stance,
    /// First contact, of the heel.
    pub heel_strike: Event,
    /// From here on the whole sole bears.
    pub foot_flat: Event,
    /// The heel lifts.
    pub heel_off: Event,
    /// Last contact, of the toe.
    pub toe_off: Event,
}

/// What is seen of one foot.
#[derive(Clone, Copy, Debug)]
pub struct FootStances<'a> {
    /// Its poses in frames, in order of time.
    pub observations: &'a [FootObservation],
    /// Its stances, see [`stances`](crate::stance::stances).
    pub stances: &'a [Stance],
    /// From the middle of the sole to its rear edge, m.
    pub heel_m: f64,
}

/// The contacts of both feet, left and right, from their stances.
pub fn contacts(feet: [FootStances<'_>; 2], config: &EventConfig) -> [Vec<Contact>; 2] {
    let shown = feet.map(|foot| -> Vec<Strike> {
        let stances = 0..foot.stances.len();
        stances.map(|k| strike(&foot, k, None, config)).collect()
    });
    // A strike that no frame shows is in the middle between those of the other foot.
    let strikes = [0, 1].map(|side| -> Vec<Strike> {
        let (foot, own, other) = (&feet[side], &shown[side], &shown[1 - side]);
        let again = |k: usize| match own[k].heel_strike.is_seen {
            true => own[k].clone(),
            false => strike(foot, k, between(&own[k], other), config),
        };
        (0..own.len()).map(again).collect()
    });
    [0, 1].map(|side| {
        let (foot, own, other) = (&feet[side], &strikes[side], &strikes[1 - side]);
        let contact = |k: usize| {
            let strike = &own[k];
            let (heel_off, toe_off) = lift(foot, k, own, other, config);
            Contact {
                stance: foot.stances[k].clone(),
                heel_strike: strike.heel_strike,
                foot_flat: strike.foot_flat,
                heel_off,
                toe_off,
            }
        };
        (0..foot.stances.len()).map(contact).collect()
    })
}

#[derive(Clone, Debug)]
struct Strike {
    heel_strike: Event,
    foot_flat: Event,
}

/// Deviation of a strike from the middle between those of the other foot, as a share of the time
/// between these, and the longest such time, s.
const ASYMMETRY: f64 = 0.04;
const MAX_STRIDE_S: f64 = 1.6;
/// Longest time for which a foot at rest is hidden, s.
const MAX_HIDDEN_S: f64 = 0.5;

/// Mean and standard deviation of a strike by those of the other foot before and after it, s.
fn between(own: &Strike, other: &[Strike]) -> Option<[f64; 2]> {
    let time_s = own.heel_strike.time_s;
    let next = other.partition_point(|other| other.heel_strike.time_s < time_s);
    let [before, after] = [next.checked_sub(1)?, next].map(|k| other.get(k));
    let (before, after) = (before?.heel_strike, after?.heel_strike);
    let stride_s = after.time_s - before.time_s;
    let of_others = 0.5 * before.sigma_s.hypot(after.sigma_s);
    (stride_s < MAX_STRIDE_S).then(|| {
        let mean_s = 0.5 * (before.time_s + after.time_s);
        [mean_s, of_others.hypot(ASYMMETRY * stride_s)]
    })
}

/// Times that are tried, s.
const STEP_S: f64 = 0.001;
/// Error of a distance of the heel besides that of the pose, m: shoes bend and slide at the strike.
const HEEL_SIGMA_M: f64 = 0.006;

fn seconds(ns: i64) -> f64 {
    1e-9 * ns as f64
}

/// Heel strike and foot flat of a stance. What is known of the strike otherwise is a mean and a
/// standard deviation, s.
fn strike(
    foot: &FootStances<'_>,
    index: usize,
    prior: Option<[f64; 2]>,
    config: &EventConfig,
) -> Strike {
    let stance = &foot.stances[index];
    let first_s = seconds(stance.times_ns[0]);
    let not_before_s = match index.checked_sub(1) {
        Some(previous) => seconds(foot.stances[previous].times_ns[1]),
        None => f64::NEG_INFINITY,
    };
    let approach = approach(foot, stance, (not_before_s, first_s), config);
    // The foot is not flat yet in the last frame before the stance.
    let last_moving_s = approach.last().map_or(f64::NEG_INFINITY, |last| last[0]);
    let [loading_s, loading_sigma_s] = config.loading_s;
    // A foot may be hidden at rest for longer than its approach takes.
    let reach_s = prior.map_or(config.max_approach_s, |_| MAX_HIDDEN_S);
    let earliest_s = (first_s - reach_s - loading_s).max(not_before_s);
    let times = (0..).map(|n| first_s - STEP_S * f64::from(n));
    let times: Vec<f64> = times.take_while(|t| *t > earliest_s).collect();
    let logs = times.iter().map(|&t| {
        // Foot flat comes after the last frame before the stance, and before its first one.
        let until = |limit: f64| normal_cdf((limit - t - loading_s) / loading_sigma_s);
        let flat = (until(first_s) - until(last_moving_s)).max(1e-12);
        let by_gait = prior.map_or(0.0, |[mean, sigma]| -0.5 * ((t - mean) / sigma).powi(2));
        libm::log(flat) + by_gait + log_likelihood(&approach, t, config)
    });
    let logs: Vec<f64> = logs.collect();
    let (time_s, sigma_s) = moments(&times, &logs).unwrap_or((first_s, loading_s));
    let from_s = last_moving_s.max(time_s);
    let expected_s = (time_s + loading_s).clamp(from_s, first_s);
    let spread_s = ((first_s - from_s) / 12.0_f64.sqrt()).min(loading_sigma_s.hypot(sigma_s));
    Strike {
        heel_strike: Event {
            time_s,
            sigma_s: sigma_s.max(STEP_S),
            is_seen: !approach.is_empty(),
        },
        foot_flat: Event {
            time_s: expected_s,
            sigma_s: spread_s.max(STEP_S),
            is_seen: last_moving_s > f64::NEG_INFINITY,
        },
    }
}

/// Frames before a stance: time, s, distance of the heel from where it then rests, and the variance
/// of that, m.
fn approach(
    foot: &FootStances<'_>,
    stance: &Stance,
    (not_before_s, first_s): (f64, f64),
    config: &EventConfig,
) -> Vec<[f64; 3]> {
    let heel = [-foot.heel_m, 0.0, 0.0];
    let at_rest = Vector3::from(stance.world_from_foot.apply(heel));
    let begin_s = not_before_s.max(first_s - config.max_approach_s);
    let before = &foot.observations[..stance.observations.start];
    let mut frames: Vec<[f64; 3]> = before
        .iter()
        .rev()
        .take_while(|own| seconds(own.time_ns) > begin_s)
        .map(|own| {
            let at = Vector3::from(own.world_from_foot.apply(heel));
            let [x, y, ..] = own.covariance.sigmas();
            let variance = x.max(y).powi(2) + HEEL_SIGMA_M * HEEL_SIGMA_M;
            [seconds(own.time_ns), (at - at_rest).norm(), variance]
        })
        // No foot is faster: a mismatch.
        .filter(|[time_s, distance, _]| *distance < 0.05 + config.max_speed * (first_s - time_s))
        .collect();
    frames.reverse();
    frames
}

/// Logarithm of the likelihood of the approach for a strike at a time: distances are
/// `v t + a t^2 / 2` at a time `t` before it, with uncertain `v` and `a`, and none after it.
fn log_likelihood(approach: &[[f64; 3]], strike_s: f64, config: &EventConfig) -> f64 {
    let [[speed, speed_sigma], [deceleration, deceleration_sigma]] =
        [config.strike_speed, config.strike_deceleration];
    let mean = Vector2::new(speed, deceleration);
    let inverse = Vector2::new(speed_sigma.powi(-2), deceleration_sigma.powi(-2));
    let mut information = Matrix2::from_diagonal(&inverse);
    let determinant = information.determinant();
    let (mut gradient, mut sum) = (Vector2::zeros(), 0.0);
    for [time_s, distance, variance] in approach {
        let left = (strike_s - time_s).max(0.0);
        let row = Vector2::new(left, 0.5 * left * left);
        let residual = distance - row.dot(&mean);
        information += row * row.transpose() / *variance;
        gradient += row * (residual / variance);
        sum += residual * residual / variance;
    }
    let Some(covariance) = information.try_inverse() else {
        return f64::NEG_INFINITY;
    };
    let explained = gradient.dot(&(covariance * gradient));
    0.5 * (explained - sum - libm::log(information.determinant() / determinant))
}

/// Mean and standard deviation of times by the logarithms of their likelihoods.
fn moments(times: &[f64], logs: &[f64]) -> Option<(f64, f64)> {
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = logs.iter().map(|log| libm::exp(log - most)).collect();
    let sum: f64 = weights.iter().sum();
    let mean = |of: &dyn Fn(f64) -> f64| {
        let terms = times.iter().zip(&weights);
        terms.map(|(time, weight)| weight * of(*time)).sum::<f64>() / sum
    };
    let middle = mean(&|time| time);
    let variance = mean(&|time| (time - middle).powi(2));
    (sum.is_finite() && sum > 0.0).then_some((middle, variance.sqrt()))
}

/// Share of a stride in which a foot bears: by speed, and its standard deviation.
fn bearing_share(speed: f64) -> [f64; 2] {
    [(0.642 - 0.035 * speed).clamp(0.4, 0.75), 0.022]
}

/// Share of a stride after which the heel lifts, and its standard deviation.
const HEEL_LIFT_SHARE: [f64; 2] = [0.35, 0.06];
/// Time from the last frame at rest until the toe leaves the ground where no other foot and no next
/// step determines it, and its standard deviation, s.
const UNKNOWN_LIFT_S: [f64; 2] = [0.3, 0.15];
/// Minimum time in the air, s.
const MIN_SWING_S: f64 = 0.2;

/// Heel off and toe off of a stance.
fn lift(
    foot: &FootStances<'_>,
    index: usize,
    own: &[Strike],
    other: &[Strike],
    config: &EventConfig,
) -> (Event, Event) {
    let stance = &foot.stances[index];
    let (strike, last_s) = (own[index].heel_strike, seconds(stance.times_ns[1]));
    let next = own.get(index + 1).map(|next| next.heel_strike);
    let stride_s = next.map(|next| next.time_s - strike.time_s);
    let speed = next.zip(foot.stances.get(index + 1)).map(|(next, stance)| {
        let from = &foot.stances[index].world_from_foot;
        let step = stance.world_from_foot.translation() - from.translation();
        step.norm() / (next.time_s - strike.time_s).max(0.1)
    });
    let latest_s = next.map_or(f64::INFINITY, |next| next.time_s - MIN_SWING_S);
    let of_other = other.iter().map(|other| other.heel_strike);
    let mut of_other = of_other.filter(|other| other.time_s > strike.time_s);
    let [share, share_sigma] = bearing_share(speed.unwrap_or(1.2));
    let toe_off = match (stride_s, of_other.next()) {
        (Some(stride_s), Some(other)) if other.time_s < latest_s => {
            let both_s = (share - 0.5) * stride_s;
            let sigma_s = (share_sigma * stride_s).hypot(other.sigma_s);
            (other.time_s + both_s, sigma_s)
        }
        (Some(stride_s), _) => {
            let sigma_s = (2.0 * share_sigma * stride_s).hypot(strike.sigma_s);
            (strike.time_s + share * stride_s, sigma_s)
        }
        (None, _) => {
            let [after_s, sigma_s] = UNKNOWN_LIFT_S;
            (last_s + after_s, sigma_s)
        }
    };
    let toe_off = mean_between(toe_off, last_s, latest_s);
    // The first frame after the stance in which the foot moves is not before the heel lifts.
    let moving_s = foot.observations.get(stance.observations.end);
    let moving_s = moving_s.map_or(f64::INFINITY, |own| seconds(own.time_ns));
    let is_seen = moving_s - last_s < config.max_approach_s;
    let [lift_share, lift_sigma] = HEEL_LIFT_SHARE;
    let expected = match stride_s {
        Some(stride_s) => (strike.time_s + lift_share * stride_s, lift_sigma * stride_s),
        None => (0.5 * (last_s + toe_off.0), UNKNOWN_LIFT_S[1]),
    };
    let heel_off = mean_between(expected, last_s, toe_off.0.min(moving_s));
    let event = |(time_s, sigma_s): (f64, f64), is_seen| Event {
        time_s,
        sigma_s,
        is_seen,
    };
    (event(heel_off, is_seen), event(toe_off, false))
}

/// A normally distributed time between two limits: mean and standard deviation.
fn mean_between((time_s, sigma_s): (f64, f64), from_s: f64, to_s: f64) -> (f64, f64) {
    let to_s = to_s
        .max(from_s + STEP_S)
        .min(time_s.max(from_s) + 5.0 * sigma_s);
    let count = ((to_s - from_s) / STEP_S).ceil().clamp(2.0, 4000.0);
    let step_s = (to_s - from_s) / count;
    let times: Vec<f64> = (0..count as usize)
        .map(|n| from_s + (n as f64 + 0.5) * step_s)
        .collect();
    let logs: Vec<f64> = times
        .iter()
        .map(|t| -0.5 * ((t - time_s) / sigma_s).powi(2))
        .collect();
    let (mean, deviation) = moments(&times, &logs).unwrap_or((from_s, sigma_s));
    (mean, deviation.max(STEP_S))
}

fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests;
