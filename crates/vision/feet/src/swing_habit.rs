//! How the feet of a wearer swing: generic motions, and what all steps of a walk say of them.
//!
//! Contract: steps on level ground, upwards, downwards, in a run, and from or to a stand are
//! learned apart, from both feet, of which the right one is mirrored. A frame that contradicts all
//! that feet do is left out. Axes are those of the step for the position (forward, left, up) and
//! those of the foot for the rotation.

use cad_transforms::RigidTransform;
use nalgebra::{Matrix3, Vector3};

use crate::config::SwingConfig;
use crate::contact::{Contact, FootContacts, is_one_stride, rest_s};
use crate::deviation::{AxisConfig, AxisHabit, Measurement, Place, Quantity, Step};
use crate::poses::motion;
use crate::shoe::Side;
use crate::stance::FootObservation;
use crate::swing::UsualMotion;

/// Height between contacts from which on a step goes up or down, m.
const CLIMB_M: f64 = 0.08;
/// Time for which a foot bears, s, from which on the wearer stands, and least length of a step of a
/// wearer who walks, m: feet that start or stop hardly tilt.
const STANDING_S: f64 = 1.2;
const SHORT_M: f64 = 0.6;
/// Share of a stride below which a foot bears in a run.
const RUNNING_SHARE: f64 = 0.5;
/// Squared deviation of a frame in variances, from which on it is a mismatch.
const MISMATCH: f64 = 25.0;
/// Axes that change sign from the left to the right foot: left, about forward, about up.
const MIRRORED: [bool; 6] = [false, true, false, true, false, true];
/// Least error of an event for which its effect is computed, and half of the time over which
/// motions are differences, s.
const LEAST_SIGMA_S: f64 = 1e-3;

/// See the module.
#[derive(Clone, Debug)]
pub struct SwingHabit {
    kinds: [[AxisHabit; 6]; 5],
}

/// Kinds of steps that are learned apart.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Level,
    Up,
    Down,
    Run,
    Stand,
}

impl Kind {
    const ALL: [Self; 5] = [Self::Level, Self::Up, Self::Down, Self::Run, Self::Stand];

    fn of([from, to]: [&Contact; 2]) -> Self {
        let stride_s = to.heel_strike.time_s - from.heel_strike.time_s;
        let [bears_s, then_bears_s] =
            [from, to].map(|own| own.toe_off.time_s - own.heel_strike.time_s);
        let [a, b] = [from, to].map(|own| own.stance.world_from_foot.translation());
        let is_short = (b - a).xy().norm() < SHORT_M;
        match b.z - a.z {
            _ if is_short || bears_s.max(then_bears_s) > STANDING_S => Self::Stand,
            _ if bears_s < RUNNING_SHARE * stride_s => Self::Run,
            rise if rise > CLIMB_M => Self::Up,
            rise if rise < -CLIMB_M => Self::Down,
            _ => Self::Level,
        }
    }
}

impl SwingHabit {
    /// That of a wearer, from all steps of the left and the right foot.
    pub fn learned(feet: &[FootContacts<'_>; 2], config: &SwingConfig) -> Self {
        let generic = Self::generic(config);
        let mut steps: [[Vec<Step>; 6]; 5] = Default::default();
        for foot in feet {
            for (from, to) in foot.contacts.iter().zip(foot.contacts.iter().skip(1)) {
                let Some(swing) = Swing::new(foot, [from, to], &generic, config) else {
                    continue;
                };
                for (all, own) in steps[swing.kind as usize].iter_mut().zip(swing.steps) {
                    all.push(own);
                }
            }
        }
        let kinds = Kind::ALL.map(|kind| {
            [0, 1, 2, 3, 4, 5].map(|axis| {
                let steps = &steps[kind as usize][axis];
                AxisHabit::learned(axis_config(config, axis), steps)
                    .unwrap_or_else(|| generic.kinds[kind as usize][axis].clone())
            })
        });
        Self { kinds }
    }

    /// That of people.
    pub fn generic(config: &SwingConfig) -> Self {
        let axis = |axis: usize| AxisHabit::generic(axis_config(config, axis));
        Self {
            kinds: Kind::ALL.map(|_| [0, 1, 2, 3, 4, 5].map(axis)),
        }
    }
}

fn axis_config(config: &SwingConfig, axis: usize) -> AxisConfig {
    AxisConfig {
        kind: match axis {
            0..3 => Quantity::Position,
            _ => Quantity::Rotation,
        },
        shared: config.shared_sigma[axis],
        own: config.own_sigma[axis],
        own_s: config.correlation_s,
    }
}

/// Standard deviations of heel off, toe off, heel strike and foot flat of a swing, s.
fn event_sigmas_s([from, to]: [&Contact; 2]) -> [f64; 4] {
    [from.heel_off, from.toe_off, to.heel_strike, to.foot_flat].map(|event| event.sigma_s)
}

/// One swing and what frames show of it.
pub(crate) struct Swing<'a> {
    pub(crate) usual: UsualMotion<'a>,
    contacts: [&'a Contact; 2],
    side: Side,
    kind: Kind,
    /// As if it were the left foot.
    steps: [Step; 6],
}

impl<'a> Swing<'a> {
    /// The swing between two contacts of a foot; `None` if these are too far apart for one.
    pub(crate) fn new(
        foot: &FootContacts<'a>,
        contacts: [&'a Contact; 2],
        habit: &SwingHabit,
        config: &SwingConfig,
    ) -> Option<Self> {
        let [from, to] = contacts;
        let span_s = [rest_s(from)[1], rest_s(to)[0]];
        let is_one_step = is_one_stride(&from.stance, &to.stance)
            && (0.0..config.max_swing_s).contains(&(span_s[1] - span_s[0]));
        if !is_one_step {
            return None;
        }
        let empty = || Step {
            measurements: Vec::new(),
            event_sigmas_s: event_sigmas_s(contacts),
        };
        let mut swing = Self {
            usual: UsualMotion::new(from, to, foot.sole),
            contacts,
            side: foot.side,
            kind: Kind::of(contacts),
            steps: std::array::from_fn(|_| empty()),
        };
        let axes = &habit.kinds[swing.kind as usize];
        let seconds = |own: &FootObservation| 1e-9 * own.time_ns as f64;
        for own in foot.observations {
            if !(span_s[0]..span_s[1]).contains(&seconds(own)) {
                continue;
            }
            let places = swing.places(seconds(own));
            let deviation = swing.deviation(own);
            let is_mismatch = (0..6).any(|k| {
                let [value, variance] = deviation[k];
                value * value
                    > MISMATCH * (axes[k].variance(&swing.steps[k], &places[k]) + variance)
            });
            if is_mismatch {
                continue;
            }
            for (k, step) in swing.steps.iter_mut().enumerate() {
                step.measurements.push(Measurement {
                    place: places[k],
                    value: deviation[k][0],
                    variance: deviation[k][1],
                });
            }
        }
        Some(swing)
    }

    /// Whether the foot rises or falls: edges of steps are none of the usual motion's.
    pub(crate) fn climbs(&self) -> bool {
        let [a, b] = self
            .contacts
            .map(|own| own.stance.world_from_foot.translation().z);
        (b - a).abs() > CLIMB_M
    }

    /// Whether it is known when the foot lifts and strikes.
    pub(crate) fn has_known_events(&self, config: &SwingConfig) -> bool {
        let [heel_off, toe_off, strike, _] = event_sigmas_s(self.contacts);
        heel_off.min(toe_off) < config.max_lift_sigma_s && strike < config.max_strike_sigma_s
    }

    /// Mean and variance of the deviation along each axis at times.
    pub(crate) fn deviations(
        &self,
        habit: &SwingHabit,
        times_s: &[f64],
    ) -> Option<Vec<[[f64; 2]; 6]>> {
        let places: Vec<[Place; 6]> = times_s.iter().map(|t| self.places(*t)).collect();
        let mut found = vec![[[0.0; 2]; 6]; times_s.len()];
        for axis in 0..6 {
            let own: Vec<Place> = places.iter().map(|all| all[axis]).collect();
            let habit = &habit.kinds[self.kind as usize][axis];
            let values = habit.at(&self.steps[axis], &own)?;
            for (found, [mean, variance]) in found.iter_mut().zip(values) {
                found[axis] = [self.sign(axis) * mean, variance];
            }
        }
        Some(found)
    }

    fn sign(&self, axis: usize) -> f64 {
        match self.side {
            Side::Right if MIRRORED[axis] => -1.0,
            _ => 1.0,
        }
    }

    fn places(&self, time_s: f64) -> [Place; 6] {
        let [from, to] = self.contacts;
        let share = |from: f64, to: f64| ((time_s - from) / (to - from).max(1e-3)).clamp(0.0, 1.0);
        let [lift_s, off_s] = [from.heel_off.time_s, from.toe_off.time_s];
        let [strike_s, flat_s] = [to.heel_strike.time_s, to.foot_flat.time_s];
        // A step takes some three tenths of this time for the roll over the toe, one for that over
        // the heel.
        let phase = match time_s {
            t if t < off_s => 0.3 * share(lift_s, off_s),
            t if t < strike_s => 0.3 + 0.6 * share(off_s, strike_s),
            _ => 0.9 + 0.1 * share(strike_s, flat_s),
        };
        // The motion is stretched between two events: an error of one moves it by that share.
        let between = |of: usize, share: f64| {
            let mut weights = [0.0; 4];
            (weights[of], weights[of + 1]) = (1.0 - share, share);
            weights
        };
        let event_weights = match time_s {
            t if t < off_s => between(0, share(lift_s, off_s)),
            t if t < strike_s => between(1, share(off_s, strike_s)),
            _ => between(2, share(strike_s, flat_s)),
        };
        let sigmas_s = event_sigmas_s(self.contacts);
        let sigma_s = (0..4).map(|k| event_weights[k] * sigmas_s[k]).sum::<f64>();
        let sigma_s = sigma_s.max(LEAST_SIGMA_S);
        let own = self.usual.at(time_s);
        let moved = |by_s: f64| {
            let other = self.usual.at(time_s + by_s);
            let moved = self.usual.axes().inverse() * (other.translation() - own.translation());
            let turned = motion(&own, &other);
            [moved.x, moved.y, moved.z, turned[3], turned[4], turned[5]]
        };
        let [before, after] = [-LEAST_SIGMA_S, LEAST_SIGMA_S].map(moved);
        // What an event that is early or late changes, by three points of its distribution (Gauss
        // and Hermite): a foot that may still move is not at rest.
        let [early, late] = [-3.0_f64.sqrt(), 3.0_f64.sqrt()].map(|times| moved(times * sigma_s));
        std::array::from_fn(|axis| {
            let rate = (after[axis] - before[axis]) / (2.0 * LEAST_SIGMA_S);
            let all = (early[axis].powi(2) + late[axis].powi(2)) / 6.0;
            Place {
                time_s,
                phase,
                event_weights,
                rate: self.sign(axis) * rate,
                beyond: (all - (rate * sigma_s).powi(2)).max(0.0),
            }
        })
    }

    /// Deviation of a frame from the usual motion, as if of the left foot, and its variances.
    fn deviation(&self, observation: &FootObservation) -> [[f64; 2]; 6] {
        let mean: RigidTransform = self.usual.at(1e-9 * observation.time_ns as f64);
        let seen = &observation.world_from_foot;
        let back = self.usual.axes().inverse();
        let shift = back * (seen.translation() - mean.translation());
        let turn = motion(&mean, seen);
        let covariance = observation.covariance.matrix();
        let step_from_foot = (back * seen.rotation()).to_rotation_matrix();
        let positions: Matrix3<f64> = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let positions = step_from_foot * positions * step_from_foot.transpose();
        let rotations = Vector3::new(covariance[(3, 3)], covariance[(4, 4)], covariance[(5, 5)]);
        let values = [shift.x, shift.y, shift.z, turn[3], turn[4], turn[5]];
        std::array::from_fn(|axis| {
            let variance = match axis {
                0..3 => positions[(axis, axis)],
                _ => rotations[axis - 3],
            };
            [self.sign(axis) * values[axis], variance]
        })
    }
}
