//! Heel strike and foot flat of a stance.
//!
//! Contract: before the strike the heel approaches the place where it then rests, and the foot has
//! the pitch with which it strikes; after it the heel is there, and the pitch falls to zero until
//! the whole sole bears. Speed and deceleration of the approach, pitch and duration of the roll are
//! unknown within what is usual; after short steps a foot comes down more slowly and flatter. The
//! strike is the mean of its distribution over time.

use nalgebra::Vector3;

use super::distance::distance;
use super::times::{
    Habit, Motion, Row, STEP_S, fit, log_normal, moments, typical, weights, without_prior,
};
use crate::config::EventConfig;
use crate::contact::{DISPLACED_SIGMA_S, Event, FootStances, seconds};
use crate::poses::motion;
use crate::stance::Stance;

/// Error of a distance of the heel besides that of the pose, m, and of a pitch, rad: shoes bend and
/// slide at the strike.
const HEEL_SIGMA_M: f64 = 0.004;
const PITCH_SIGMA: f64 = 0.02;
/// Error of a time besides those: feet strike in other ways than this model's, s; those of people
/// who run do so flat or on the toe. From `FAST_SPEED` on, m/s, the latter grows to its value at
/// `RUN_SPEED`.
const MODEL_SIGMA_S: f64 = 0.006;
const RUN_SIGMA_S: f64 = 0.02;
const FAST_SPEED: f64 = 1.5;
/// The same of the time from which on the whole sole bears, which shoes and ground make less sharp,
/// s, and of people who run, who may land with the whole sole.
const FLAT_SIGMA_S: f64 = 0.01;
const RUN_FLAT_SIGMA_S: f64 = 0.025;
/// Speed from which on people run, m/s.
pub(super) const RUN_SPEED: f64 = 2.0;
/// How much the pitch may differ from that of the strike before it, rad/s.
const PITCH_RATE: f64 = 1.5;
/// Least time from the last frame at rest to the next strike of the foot, s.
const MIN_LIFTED_S: f64 = 0.3;
/// Longest time for which a foot at rest is hidden, s.
const MAX_HIDDEN_S: f64 = 0.5;
/// The same where no frame shows either foot, s.
const MAX_UNSEEN_S: f64 = 4.0;
/// Standard deviations of what steps around a strike say within which it is searched.
const PRIOR_SIGMAS: f64 = 4.0;
/// Time after the first frame at rest in which frames still tell the strike, s.
const AFTER_S: f64 = 0.1;
/// Time after the first frame at rest in which the foot may strike, s: it is near its place then.
const LATE_S: f64 = 0.06;
/// Length of a stride from which on feet strike as usual, m.
const WHOLE_STRIDE_M: f64 = 1.0;
/// Durations of the roll that are tried, in its standard deviations.
const ROLLS: [f64; 7] = [-1.8, -1.2, -0.6, 0.0, 0.6, 1.2, 1.8];
/// Least duration of a roll, s.
const MIN_ROLL_S: f64 = 0.02;
/// Standard deviation of a strike whose motion is typical, s.
const SURE_S: f64 = 0.02;

#[derive(Clone, Debug)]
pub(super) struct Strike {
    pub(super) heel_strike: Event,
    pub(super) foot_flat: Event,
    /// Speed, deceleration, pitch.
    motion: Motion,
    /// Duration of the roll and its standard deviation, s.
    roll_s: [f64; 2],
    /// Whether it ends a whole stride.
    is_typical: bool,
}

/// How a wearer usually strikes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StrikeHabit {
    motion: Habit,
    roll_s: [f64; 2],
}

impl StrikeHabit {
    /// That of people.
    pub(super) fn generic(config: &EventConfig) -> Self {
        Self::of(config, |_, usual| {
            typical([usual[0], usual[1]], usual[2], std::iter::empty())
        })
    }

    /// That of a wearer, from strikes of which those after whole strides that are sure count.
    pub(super) fn learned<'a>(
        strikes: impl Iterator<Item = &'a Strike>,
        config: &EventConfig,
    ) -> Self {
        let sure: Vec<&Strike> = strikes
            .filter(|own| own.is_typical)
            .filter(|own| own.heel_strike.is_seen && own.heel_strike.sigma_s < SURE_S)
            .collect();
        Self::of(config, |k, usual| {
            let estimates = sure.iter().map(|own| match k {
                3 => own.roll_s,
                k => [own.motion.mean[k], own.motion.variance[k].sqrt()],
            });
            let prior = [usual[0], usual[1].hypot(usual[2])];
            let estimates = estimates.filter_map(|own: [f64; 2]| without_prior(own, prior));
            typical([usual[0], usual[1]], usual[2], estimates)
        })
    }

    /// That of a stride of which this is the share of a whole one.
    fn after(&self, share: f64) -> Self {
        Self {
            motion: Habit {
                mean: self
                    .motion
                    .mean
                    .component_mul(&Vector3::new(share, 1.0, share)),
                sigma: self.motion.sigma,
            },
            roll_s: [share * self.roll_s[0], self.roll_s[1]],
        }
    }

    fn of(config: &EventConfig, habit: impl Fn(usize, [f64; 3]) -> [f64; 2]) -> Self {
        let usual = [
            config.strike_speed,
            config.strike_deceleration,
            config.strike_pitch,
        ];
        let [speed, deceleration, pitch] = [0, 1, 2].map(|k| habit(k, usual[k]));
        Self {
            motion: Habit {
                mean: Vector3::new(speed[0], deceleration[0], pitch[0]),
                sigma: Vector3::new(speed[1], deceleration[1], pitch[1]),
            },
            roll_s: habit(3, config.loading_s),
        }
    }
}

/// A frame near a strike: its time, s, the distance of the heel from where it then rests, m, the
/// pitch relative to that, toe up, rad, and the variances of both.
struct Approach {
    time_s: f64,
    heel: [f64; 2],
    pitch: [f64; 2],
}

/// Heel strike and foot flat of a stance. What is known of the strike otherwise is a mean and a
/// standard deviation, s, and the time before it in which no frame shows a foot.
pub(super) fn strike(
    foot: &FootStances<'_>,
    index: usize,
    (prior, unseen): (Option<[f64; 2]>, Option<[f64; 2]>),
    habit: &StrikeHabit,
    config: &EventConfig,
) -> Strike {
    let stance = &foot.stances[index];
    let first_s = seconds(stance.times_ns[0]);
    let last_s = match index.checked_sub(1) {
        Some(previous) => seconds(foot.stances[previous].times_ns[1]),
        None => f64::NEG_INFINITY,
    };
    let approach = approach(foot, stance, (last_s, first_s), config);
    let is_seen = approach.iter().any(|own| own.time_s < first_s);
    let share = stride_share(foot, index);
    let habit = habit.after(share);
    let [roll_s, roll_sigma_s] = habit.roll_s;
    let is_displaced = index
        .checked_sub(1)
        .is_some_and(|previous| foot.is_displaced_after(previous));
    if is_displaced {
        return unknown(first_s, roll_s, DISPLACED_SIGMA_S);
    }
    // A foot may be hidden at rest for longer than its approach takes.
    let reach_s = match is_seen {
        true => config.max_approach_s,
        false => MAX_HIDDEN_S,
    };
    let reach_s = match unseen.filter(|_| !is_seen) {
        Some([from_s, _]) => reach_s.max((first_s - from_s).min(MAX_UNSEEN_S)),
        None => reach_s,
    };
    // The steps around it may say that it was hidden for longer.
    let reach_s = match prior.filter(|_| !is_seen) {
        Some([mean_s, sigma_s]) => {
            let expected_s = first_s - roll_s - (mean_s - PRIOR_SIGMAS * sigma_s);
            reach_s.max(expected_s.min(MAX_UNSEEN_S))
        }
        None => reach_s,
    };
    let earliest_s =
        (first_s - reach_s - roll_s).max((last_s + MIN_LIFTED_S).min(first_s - roll_s));
    let times = (0..).map(|n| first_s + LATE_S - STEP_S * f64::from(n));
    let times: Vec<f64> = times.take_while(|t| *t > earliest_s).collect();
    let mut cases = Vec::with_capacity(times.len() * ROLLS.len());
    for &time_s in &times {
        let by_gait = prior.map_or(0.0, |prior| log_normal(time_s, prior));
        for roll in ROLLS {
            let seconds = (roll_s + roll * roll_sigma_s).max(MIN_ROLL_S);
            let rows = rows(&approach, [time_s, seconds]);
            let Some(motion) = fit(&rows, &habit.motion) else {
                continue;
            };
            // The foot is flat in the first frame of the stance, within what its tolerance hides.
            let late = (time_s + seconds - first_s).max(0.0) / (0.5 * seconds);
            let log = motion.log + by_gait - 0.5 * roll * roll - 0.5 * late * late;
            cases.push((time_s, seconds, motion, log));
        }
    }
    let logs: Vec<f64> = cases.iter().map(|own| own.3).collect();
    let Some(weights) = weights(&logs) else {
        return unknown(first_s, roll_s, roll_s);
    };
    let running = (speed(foot, index) - FAST_SPEED) / (RUN_SPEED - FAST_SPEED);
    let of_run = |walking: f64, run: f64| walking + running.clamp(0.0, 1.0) * (run - walking);
    let model_sigma_s = of_run(MODEL_SIGMA_S, RUN_SIGMA_S);
    let flat_sigma_s = of_run(FLAT_SIGMA_S, RUN_FLAT_SIGMA_S);
    let event = |[time_s, sigma_s]: [f64; 2], is_seen| Event {
        time_s,
        sigma_s: sigma_s.hypot(model_sigma_s),
        is_seen,
    };
    let time = moments(|k| cases[k].0, &weights);
    let flat_s = |k: usize| {
        let (strike_s, roll_s, ..) = cases[k];
        (strike_s + roll_s).min(first_s.max(strike_s))
    };
    let flat = moments(flat_s, &weights);
    let of = |of: fn(&Motion) -> Vector3<f64>| {
        let terms = cases.iter().zip(&weights);
        terms.fold(Vector3::zeros(), |sum, (case, w)| sum + of(&case.2) * *w)
    };
    let mean = of(|own| own.mean);
    let squares = of(|own| own.variance + own.mean.component_mul(&own.mean));
    Strike {
        heel_strike: event(time, is_seen),
        foot_flat: event([flat[0].max(time[0]), flat[1].hypot(flat_sigma_s)], is_seen),
        motion: Motion {
            mean,
            variance: squares - mean.component_mul(&mean),
            log: 0.0,
        },
        roll_s: moments(|k| cases[k].1, &weights),
        is_typical: share >= 1.0,
    }
}

/// Length of the stride before a stance as a share of a whole one, at most 1.
fn stride_share(foot: &FootStances<'_>, index: usize) -> f64 {
    let before = index.checked_sub(1).map(|k| &foot.stances[k]);
    before.map_or(1.0, |before| {
        let [from, to] =
            [before, &foot.stances[index]].map(|own| own.world_from_foot.translation());
        ((to - from).norm() / WHOLE_STRIDE_M).min(1.0)
    })
}

/// Speed of a foot over the step before a stance and the one after it, the greater one, m/s.
fn speed(foot: &FootStances<'_>, index: usize) -> f64 {
    let near = &foot.stances[index.saturating_sub(1)..foot.stances.len().min(index + 2)];
    let speeds = near.windows(2).map(|pair| {
        let [a, b] = [&pair[0], &pair[1]];
        let step = b.world_from_foot.translation() - a.world_from_foot.translation();
        step.norm() / seconds(b.times_ns[0] - a.times_ns[0]).max(0.2)
    });
    speeds.fold(0.0, f64::max)
}

fn unknown(first_s: f64, roll_s: f64, sigma_s: f64) -> Strike {
    let event = |time_s| Event {
        time_s,
        sigma_s,
        is_seen: false,
    };
    Strike {
        heel_strike: event(first_s - roll_s),
        foot_flat: event(first_s),
        motion: Motion::default(),
        roll_s: [roll_s; 2],
        is_typical: false,
    }
}

/// Frames before a stance and in its first tenth of a second.
fn approach(
    foot: &FootStances<'_>,
    stance: &Stance,
    (not_before_s, first_s): (f64, f64),
    config: &EventConfig,
) -> Vec<Approach> {
    let heel = [-foot.sole.heel_m, 0.0, 0.0];
    let at_rest = Vector3::from(stance.world_from_foot.apply(heel));
    let begin_s = not_before_s.max(first_s - config.max_approach_s);
    let until = foot.observations[..stance.observations.end].iter().rev();
    let mut frames: Vec<Approach> = until
        .take_while(|own| seconds(own.time_ns) > begin_s)
        .filter(|own| seconds(own.time_ns) < first_s + AFTER_S)
        .map(|own| {
            let at = Vector3::from(own.world_from_foot.apply(heel));
            let pitch = own.covariance.sigmas()[4];
            let turned = motion(&stance.world_from_foot, &own.world_from_foot);
            let [distance, variance] = distance(own, &heel, &at_rest, &at);
            Approach {
                time_s: seconds(own.time_ns),
                heel: [distance, variance + HEEL_SIGMA_M * HEEL_SIGMA_M],
                pitch: [-turned[4], pitch * pitch + PITCH_SIGMA * PITCH_SIGMA],
            }
        })
        // No foot is faster: a mismatch.
        .filter(|own| own.heel[0] < 0.05 + config.max_speed * (first_s - own.time_s).max(0.0))
        .collect();
    frames.reverse();
    frames
}

/// What frames say of the speed and the deceleration of the approach, and of the pitch at the
/// strike, for a time of the strike and a duration of the roll.
fn rows(approach: &[Approach], [strike_s, roll_s]: [f64; 2]) -> Vec<Row> {
    let of_frame = |own: &Approach| {
        let left = (strike_s - own.time_s).max(0.0);
        let rolled = ((own.time_s - strike_s) / roll_s).clamp(0.0, 1.0);
        let pitch = 1.0 - rolled * rolled * (3.0 - 2.0 * rolled);
        [
            Row {
                factors: Vector3::new(left, 0.5 * left * left, 0.0),
                value: own.heel[0],
                variance: own.heel[1],
            },
            Row {
                factors: Vector3::new(0.0, 0.0, pitch),
                value: own.pitch[0],
                variance: own.pitch[1] + (PITCH_RATE * left).powi(2),
            },
        ]
    };
    approach.iter().flat_map(of_frame).collect()
}
