//! Heel off and toe off of a stance.
//!
//! Contract: the heel lifts with a growing pitch about the toe; the toe is at rest until it leaves
//! with a growing speed. Where frames show that, its time follows from them; elsewhere from the
//! gait: the toe leaves a certain share of a stride after the strike of the other foot, the heel
//! lifts a certain share after its own strike.
//!
//! Source of the share of a stride in which a foot bears, 0.642 - 0.035 v for a speed v in m/s:
//! Kirtley, Whittle, Jefferson, "Influence of walking speed on gait parameters", J. Biomed. Eng. 7,
//! 1985. People who run bear for less than half of a stride, and change from walking to running at
//! about 2 m/s: Alexander, "Optimization and gaits in the locomotion of vertebrates", Physiol. Rev.
//! 69, 1989. Heels lift after 0.30 to 0.40 of a stride: Perry, Burnfield, "Gait Analysis", 2nd ed.,
//! 2010.

use nalgebra::Vector3;

use super::distance::distance;
use super::strike::{RUN_SPEED, Strike};
use super::times::{Habit, Row, STEP_S, fit, log_normal, moments, typical, weights, without_prior};
use crate::config::EventConfig;
use crate::contact::{DISPLACED_SIGMA_S, Event, FootStances, is_one_stride, seconds};
use crate::poses::motion;
use crate::stance::Stance;

/// Error of a place of the toe besides that of the pose, m, and of a pitch, rad: soles bend.
const TOE_SIGMA_M: f64 = 0.01;
const PITCH_SIGMA: f64 = 0.02;
/// How much the accelerations of both change, m/s³ and rad/s³.
const TOE_JERK: f64 = 100.0;
const PITCH_JERK: f64 = 150.0;
/// Time after the last frame at rest in which frames tell when the foot lifts, s.
const AFTER_S: f64 = 0.45;
/// Time after the toe has left in which a frame shows that it did, s.
const SHOWN_S: f64 = 0.1;
/// Time before the last frame at rest, likewise.
const BEFORE_S: f64 = 0.15;
/// Logarithm of the ratio by which frames can make a time more probable than another: where they
/// contradict the gait by more, they show something else.
const MAX_LOG: f64 = 4.5;
/// Distance of the toe from where it rested, from which on its motion says nothing of its begin,
/// m.
const MAX_TOE_M: f64 = 0.3;
/// Error of a time besides those of frames: feet lift in other ways than this model's, s.
const MODEL_SIGMA_S: f64 = 0.008;
/// Error of the time at which the heel lifts, relative to that of the toe: frames after the toe has
/// left do not show how the heel lifts.
const HEEL_SHARE: f64 = 0.5;
/// Pitch relative to the stance from which on a foot does not lift over its toe, rad.
const MAX_PITCH: f64 = 0.1;
/// Time from the last frame at rest until the toe leaves the ground where no other foot and no next
/// step determines it, and its standard deviation, s.
const UNKNOWN_LIFT_S: [f64; 2] = [0.3, 0.15];
/// Longest time from the last frame at rest to the next strike of the foot, s.
const MAX_NEXT_S: f64 = 1.5;
/// Longest time from there to the strike of the other foot that precedes the lift, s.
const MAX_OTHER_S: f64 = 0.6;
/// Change of the time of a stride from the usual one, and speed, m/s, from which on a person walks
/// regularly, and by what share of the stride toes leave otherwise than usual if not: people who
/// begin to walk, turn, stop or run.
const MAX_STRIDE_CHANGE: f64 = 0.15;
const MIN_SPEED: f64 = 0.7;
const IRREGULAR_SHARE: f64 = 0.07;
/// Minimum time in the air, s.
const MIN_SWING_S: f64 = 0.2;
/// Standard deviation of an event that tells what is typical, s.
const SURE_S: f64 = 0.02;

/// Heel off and toe off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lift {
    pub(super) heel_off: Event,
    pub(super) toe_off: Event,
    /// Share of the stride by which the toe leaves later than that of people, and share after which
    /// the heel lifts, where the stride is known, with standard deviations by frames alone.
    shares: Option<[[f64; 2]; 2]>,
    stride_s: f64,
}

impl Lift {
    /// Whether something is learned of it.
    #[cfg(test)]
    pub(super) fn is_typical(&self) -> bool {
        self.shares.is_some()
    }

    /// Of which nothing is learned: heel off and toe off.
    fn without_habit([heel_off, toe_off]: [Event; 2]) -> Self {
        Self {
            heel_off,
            toe_off,
            shares: None,
            stride_s: 1.0,
        }
    }
}

/// How long the feet of a wearer usually bear: differences of the share from that of people, and
/// share after which the heel lifts, each with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LiftHabit {
    shares: [[f64; 2]; 2],
}

impl LiftHabit {
    /// That of people.
    pub(super) fn generic(config: &EventConfig) -> Self {
        let usual = [config.bearing_share, config.heel_lift_share];
        Self {
            shares: usual
                .map(|[mean, people, steps]| typical([mean, people], steps, std::iter::empty())),
        }
    }

    /// That of a wearer, from steps of which those that are sure count.
    pub(super) fn learned<'a>(
        &self,
        lifts: impl Iterator<Item = &'a Lift> + Clone,
        config: &EventConfig,
    ) -> Self {
        let usual = [config.bearing_share, config.heel_lift_share];
        let shares = [0, 1].map(|k: usize| {
            let [mean, people, steps] = usual[k];
            let estimates = lifts.clone().filter_map(|own| {
                let event = [own.toe_off, own.heel_off][k];
                let [share, sigma] = own.shares?[k];
                let is_sure = event.is_seen && sigma * own.stride_s < SURE_S;
                without_prior([share, sigma], self.shares[k]).filter(|_| is_sure)
            });
            let [own, sigma] = typical([mean, people], steps, estimates);
            // Nobody differs by more: some of these frames show something else.
            let limit = 2.0 * people;
            match (own - mean).abs() <= limit {
                true => [own, sigma],
                false => [own.clamp(mean - limit, mean + limit), sigma.hypot(people)],
            }
        });
        Self { shares }
    }
}

/// Share of a stride in which a foot bears of people who run, and its standard deviation.
const RUN_SHARE: [f64; 2] = [0.38, 0.06];
/// Scatter of the speed at which people begin to run, m/s.
const RUN_SPEED_SCATTER: f64 = 0.12;

/// Share of a stride in which the feet of people bear at a speed, m/s, and its standard deviation
/// besides that between people who walk: whether they run is uncertain too.
pub(super) fn bearing_share(speed: f64) -> [f64; 2] {
    let walking = (0.642 - 0.035 * speed).clamp(0.5, 0.75);
    let [running, scatter] = RUN_SHARE;
    let runs = 1.0 / (1.0 + ((RUN_SPEED - speed) / RUN_SPEED_SCATTER).exp());
    let change = walking - running;
    [
        walking - runs * change,
        (runs * scatter * scatter + runs * (1.0 - runs) * change * change).sqrt(),
    ]
}

/// What follows from the gait.
struct GaitEvents {
    toe_off: [f64; 2],
    heel_off: [f64; 2],
    latest_s: f64,
    stride_s: Option<f64>,
    /// Whether the person walks as usual before and after it.
    is_regular: bool,
    /// When the toes of people leave at that speed, s.
    usual_toe_off_s: Option<f64>,
}

/// Heel off and toe off of a stance after which no frame shows a foot for some time: in this order
/// at any time until the foot swings to where it is at rest next.
fn unseen_lift(foot: &FootStances<'_>, index: usize, [_, until_s]: [f64; 2]) -> Lift {
    let last_s = seconds(foot.stances[index].times_ns[1]);
    let next = foot.stances.get(index + 1);
    let next_s = next.map_or(f64::INFINITY, |next| seconds(next.times_ns[0]));
    let latest_s = (next_s - MIN_SWING_S).min(until_s + UNKNOWN_LIFT_S[0]);
    let length_s = (latest_s - last_s).max(MIN_SWING_S);
    // The smaller and the larger one of two times that are equally probable in an interval.
    let event = |share: f64| Event {
        time_s: last_s + share * length_s,
        sigma_s: length_s / 18.0_f64.sqrt(),
        is_seen: false,
    };
    Lift::without_habit([1.0 / 3.0, 2.0 / 3.0].map(event))
}

/// Heel off and toe off of a stance after which the foot is displaced without a swing: there are
/// none.
fn displaced_lift(last_s: f64) -> Lift {
    let event = Event {
        time_s: last_s,
        sigma_s: DISPLACED_SIGMA_S,
        is_seen: false,
    };
    Lift::without_habit([event; 2])
}

/// Strikes of a foot and of the other one, in order of time.
#[derive(Clone, Copy)]
pub(super) struct Strikes<'a> {
    own: &'a [Strike],
    other: &'a [Strike],
    /// Median stride of the foot, s.
    usual_stride_s: Option<f64>,
}

impl<'a> Strikes<'a> {
    pub(super) fn new(own: &'a [Strike], other: &'a [Strike]) -> Self {
        let usual_stride_s = usual_stride_s(own);
        Self {
            own,
            other,
            usual_stride_s,
        }
    }

    /// The next one of the other foot.
    fn next_of_other(&self, time_s: f64) -> Option<Event> {
        let next = self
            .other
            .partition_point(|other| other.heel_strike.time_s <= time_s);
        self.other.get(next).map(|other| other.heel_strike)
    }
}

/// Heel off and toe off of a stance, and when after it no frame shows a foot.
pub(super) fn lift(
    foot: &FootStances<'_>,
    index: usize,
    strikes: Strikes<'_>,
    unseen: Option<[f64; 2]>,
    habit: &LiftHabit,
    config: &EventConfig,
) -> Lift {
    let stance = &foot.stances[index];
    let last_s = seconds(stance.times_ns[1]);
    if let Some(unseen) = unseen {
        return unseen_lift(foot, index, unseen);
    }
    if foot.is_displaced_after(index) {
        return displaced_lift(last_s);
    }
    let expected = expected(foot, index, strikes, habit);
    let frames = leaving(foot, stance, expected.latest_s);
    // Frames before that only say that it is later, which is not typical of a wearer.
    let shown = |event_s: f64| {
        let left = |own: &Leaving| {
            let is_after = (event_s..event_s + SHOWN_S).contains(&own.time_s);
            is_after && own.toe[0] > 3.0 * own.toe[1].sqrt()
        };
        frames.iter().any(left)
    };
    let toe_habit = Habit {
        mean: Vector3::new(config.toe_speed[0], config.toe_acceleration[0], 0.0),
        sigma: Vector3::new(config.toe_speed[1], config.toe_acceleration[1], 1.0),
    };
    let toe_rows = |time_s: f64| rows(&frames, time_s, TOE_JERK, |own| own.toe);
    let toe_off = between(expected.toe_off, [last_s, expected.latest_s], |t| {
        fit(&toe_rows(t), &toe_habit).map(|motion| motion.log)
    });
    let heel_habit = Habit {
        mean: Vector3::new(0.0, config.heel_lift_acceleration[0], 0.0),
        sigma: Vector3::new(0.2, config.heel_lift_acceleration[1], 1.0),
    };
    // Later the foot turns otherwise.
    let lifting: Vec<Leaving> = frames
        .iter()
        .copied()
        .filter(|f| f.time_s < toe_off[0])
        .collect();
    let heel_off = between(
        expected.heel_off,
        [last_s - 0.5 * BEFORE_S, toe_off[0]],
        |t| {
            fit(&rows(&lifting, t, PITCH_JERK, |own| own.pitch), &heel_habit)
                .map(|motion| motion.log)
        },
    );
    let event = |[time_s, sigma_s]: [f64; 2], is_seen| Event {
        time_s,
        sigma_s,
        is_seen,
    };
    let stride_s = expected.stride_s.unwrap_or(1.0);
    let irregular_s = match expected.is_regular {
        true => 0.0,
        false => IRREGULAR_SHARE * stride_s.min(MAX_NEXT_S),
    };
    let heel_sigma_s = heel_off[1]
        .hypot(HEEL_SHARE * toe_off[1])
        .hypot(irregular_s);
    // Other steps are not typical of a wearer.
    let usual_toe_off_s = expected.usual_toe_off_s.filter(|_| expected.is_regular);
    Lift {
        heel_off: event(
            [heel_off[0], heel_sigma_s],
            lifting.iter().any(|own| own.time_s > last_s),
        ),
        toe_off: event(
            [toe_off[0], toe_off[1].hypot(irregular_s)],
            shown(toe_off[0]),
        ),
        shares: usual_toe_off_s.map(|usual_s| {
            let lifted_s = heel_off[0] - strikes.own[index].heel_strike.time_s;
            let later_s = toe_off[0] - usual_s;
            [[later_s, toe_off[1]], [lifted_s, heel_off[1]]].map(|own| own.map(|s| s / stride_s))
        }),
        stride_s,
    }
}

fn expected(
    foot: &FootStances<'_>,
    index: usize,
    strikes: Strikes<'_>,
    habit: &LiftHabit,
) -> GaitEvents {
    let own = strikes.own;
    let stance = &foot.stances[index];
    let (strike, last_s) = (own[index].heel_strike, seconds(stance.times_ns[1]));
    let next = own.get(index + 1).map(|next| next.heel_strike);
    // Later and farther ones are those of other steps.
    let is_one_stride =
        (foot.stances.get(index + 1)).is_some_and(|after| is_one_stride(stance, after));
    let next = next.filter(|next| is_one_stride && next.time_s - last_s < MAX_NEXT_S);
    let stride_s = next.map(|next| next.time_s - strike.time_s);
    let speed = next.zip(foot.stances.get(index + 1)).map(|(next, after)| {
        let step = after.world_from_foot.translation() - stance.world_from_foot.translation();
        step.norm() / (next.time_s - strike.time_s).max(0.1)
    });
    let latest_s = next.map_or(f64::INFINITY, |next| next.time_s - MIN_SWING_S);
    let [[later, later_sigma], [lift_share, lift_sigma]] = habit.shares;
    let [usual_share, run_sigma] = bearing_share(speed.unwrap_or(1.2));
    let share = usual_share + later;
    let is_regular = stride_s.zip(speed).zip(strikes.usual_stride_s).is_some_and(
        |((stride_s, speed), usual_s)| {
            (stride_s / usual_s - 1.0).abs() < MAX_STRIDE_CHANGE
                && (MIN_SPEED..RUN_SPEED).contains(&speed)
        },
    );
    let later_sigma = match is_regular {
        true => later_sigma,
        false => later_sigma.hypot(IRREGULAR_SHARE),
    }
    .hypot(run_sigma);
    let (toe_off, usual_toe_off_s) = match (stride_s, strikes.next_of_other(strike.time_s)) {
        (Some(stride_s), Some(other))
            if other.time_s < latest_s && other.time_s < last_s + MAX_OTHER_S =>
        {
            let at = |share: f64| other.time_s + (share - 0.5) * stride_s;
            let sigma_s = (later_sigma * stride_s).hypot(other.sigma_s);
            ([at(share), sigma_s], Some(at(usual_share)))
        }
        (Some(stride_s), _) => {
            let sigma_s = (2.0 * later_sigma * stride_s).hypot(strike.sigma_s);
            ([strike.time_s + share * stride_s, sigma_s], None)
        }
        (None, _) => ([last_s + UNKNOWN_LIFT_S[0], UNKNOWN_LIFT_S[1]], None),
    };
    let heel_off = match stride_s {
        Some(stride_s) => [strike.time_s + lift_share * stride_s, lift_sigma * stride_s],
        None => [0.5 * (last_s + toe_off[0]), UNKNOWN_LIFT_S[1]],
    };
    GaitEvents {
        toe_off,
        heel_off,
        latest_s,
        stride_s,
        is_regular,
        usual_toe_off_s,
    }
}

/// Median time from a strike to the next one of the same foot, s.
fn usual_stride_s(own: &[Strike]) -> Option<f64> {
    let times = own
        .windows(2)
        .map(|of| of[1].heel_strike.time_s - of[0].heel_strike.time_s);
    let mut times: Vec<f64> = times.filter(|seconds| *seconds < MAX_NEXT_S).collect();
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied()
}

/// A frame near the end of a stance: its time, s, the distance of the toe from where it rested, m,
/// the pitch since then, heel up, rad, and the variances of both.
#[derive(Clone, Copy)]
struct Leaving {
    time_s: f64,
    toe: [f64; 2],
    pitch: [f64; 2],
}

/// Frames from shortly before the end of a stance on, until the next foot flat.
fn leaving(foot: &FootStances<'_>, stance: &Stance, latest_s: f64) -> Vec<Leaving> {
    let toe = [foot.sole.toe_m, 0.0, 0.0];
    let at_rest = Vector3::from(stance.world_from_foot.apply(toe));
    let last_s = seconds(stance.times_ns[1]);
    let end_s = (last_s + AFTER_S).min(latest_s);
    let own = foot.observations[stance.observations.start..].iter();
    own.skip_while(|own| seconds(own.time_ns) < last_s - BEFORE_S)
        .take_while(|own| seconds(own.time_ns) < end_s)
        .map(|own| {
            let at = Vector3::from(own.world_from_foot.apply(toe));
            let pitch = own.covariance.sigmas()[4];
            let turned = motion(&stance.world_from_foot, &own.world_from_foot);
            let [distance, variance] = distance(own, &toe, &at_rest, &at);
            Leaving {
                time_s: seconds(own.time_ns),
                toe: [distance, variance + TOE_SIGMA_M * TOE_SIGMA_M],
                pitch: [turned[4], pitch * pitch + PITCH_SIGMA * PITCH_SIGMA],
            }
        })
        .take_while(|own| own.pitch[0] > -MAX_PITCH && own.toe[0] < MAX_TOE_M)
        .collect()
}

/// What frames say of a motion that begins at a time: its speed and acceleration.
fn rows(
    frames: &[Leaving],
    begin_s: f64,
    jerk: f64,
    value: impl Fn(&Leaving) -> [f64; 2],
) -> Vec<Row> {
    let of_frame = |own: &Leaving| {
        let since = (own.time_s - begin_s).max(0.0);
        let [value, variance] = value(own);
        // The acceleration is constant for a tenth of a second only.
        let model = jerk * since.powi(3) / 6.0;
        Row {
            factors: Vector3::new(since, 0.5 * since * since, 0.0),
            value,
            variance: variance + model * model,
        }
    };
    frames.iter().map(of_frame).collect()
}

/// A normally distributed time between two limits, with the likelihood of what frames show: mean
/// and standard deviation.
fn between(
    expected: [f64; 2],
    [from_s, to_s]: [f64; 2],
    log: impl Fn(f64) -> Option<f64>,
) -> [f64; 2] {
    let [time_s, sigma_s] = expected;
    let to_s = to_s
        .max(from_s + STEP_S)
        .min(time_s.max(from_s) + 5.0 * sigma_s);
    let count = ((to_s - from_s) / STEP_S).ceil().clamp(2.0, 2000.0);
    let step_s = (to_s - from_s) / count;
    let times: Vec<f64> = (0..count as usize)
        .map(|n| from_s + (n as f64 + 0.5) * step_s)
        .collect();
    let shown: Vec<f64> = times
        .iter()
        .map(|t| log(*t).unwrap_or(f64::NEG_INFINITY))
        .collect();
    let least = shown.iter().copied().fold(f64::NEG_INFINITY, f64::max) - MAX_LOG;
    let parts = times.iter().zip(&shown);
    let logs: Vec<f64> = parts
        .map(|(t, shown)| log_normal(*t, expected) + shown.max(least))
        .collect();
    match weights(&logs) {
        Some(weights) => {
            let [mean, deviation] = moments(|k| times[k], &weights);
            [mean, deviation.hypot(MODEL_SIGMA_S)]
        }
        None => [from_s, sigma_s],
    }
}
