//! Deviation of a foot from the generic motion between two contacts, along one axis.
//!
//! Contract: a deviation is the sum of a curve over the phase of the step that all steps of a
//! wearer share, of one that each step has of its own, and of errors of the times of its events.
//! All of them are Gaussian processes that vanish at the contacts. The shared curve and the size of
//! the own ones are learned from all frames of a walk; frames of a step then tell more of it.
//! Without frames the deviation is zero and as uncertain as people differ.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Where the shared curve is described, phases.
const NODES: usize = 13;
/// Phases over which shared curves are correlated.
const SHARED_LENGTH: f64 = 0.15;
/// Variance that keeps matrices regular, relative.
const REGULAR: f64 = 1e-6;
/// Number of measurements that the size of own deviations that people have counts for.
const PRIOR_COUNT: f64 = 12.0;
/// Limits of the learned size of own deviations relative to that of people.
const SCALES: [f64; 2] = [0.4, 2.5];
const ROUNDS: usize = 4;

/// What deviates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Quantity {
    /// A position, m.
    Position,
    /// A rotation, rad.
    Rotation,
}

/// How deviations of people along one axis are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AxisConfig {
    pub(crate) kind: Quantity,
    /// Standard deviation of the curve that the steps of a wearer share, in mid-step.
    pub(crate) shared: f64,
    /// Of that which each step has of its own.
    pub(crate) own: f64,
    /// Time over which own deviations are correlated, s.
    pub(crate) own_s: f64,
}

/// An instant between two contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    pub(crate) time_s: f64,
    /// From 0 at the end of a contact to 1 at the begin of the next one.
    pub(crate) phase: f64,
    /// Shares by which errors of heel off, toe off, heel strike and foot flat move the motion.
    pub(crate) event_weights: [f64; 4],
    /// Derivative of the generic motion, per s.
    pub(crate) rate: f64,
    /// Variance by errors of events beyond what that derivative says.
    pub(crate) beyond: f64,
}

/// A measurement of a deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Measurement {
    pub(crate) place: Place,
    pub(crate) value: f64,
    pub(crate) variance: f64,
}

/// What frames show of one step along one axis.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Step {
    pub(crate) measurements: Vec<Measurement>,
    /// Standard deviations of heel off, toe off, heel strike and foot flat, s.
    pub(crate) event_sigmas_s: [f64; 4],
}

/// Deviations that the steps of a wearer have in common along one axis.
#[derive(Clone, Debug)]
pub(crate) struct AxisHabit {
    config: AxisConfig,
    /// Lower triangle of the covariance of the shared curve at its nodes, as a factor.
    nodes: Cholesky<f64, Dyn>,
    /// Of the whitened curve.
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Size of own deviations relative to that of people.
    scale: f64,
}

impl AxisHabit {
    /// That of people.
    pub(crate) fn generic(config: AxisConfig) -> Self {
        let at = |k: usize| (k + 1) as f64 / (NODES + 1) as f64;
        let nodes = DMatrix::from_fn(NODES, NODES, |i, j| {
            shared_kernel(at(i) - at(j)) + if i == j { REGULAR } else { 0.0 }
        });
        Self {
            config,
            nodes: nodes
                .cholesky()
                .expect("a kernel with a regular part is positive definite"),
            mean: DVector::zeros(NODES),
            covariance: DMatrix::identity(NODES, NODES),
            scale: 1.0,
        }
    }

    /// That of a wearer, from steps.
    pub(crate) fn learned(config: AxisConfig, steps: &[Step]) -> Option<Self> {
        let mut habit = Self::generic(config);
        for _ in 0..ROUNDS {
            let mut information = DMatrix::identity(NODES, NODES);
            let mut gradient = DVector::zeros(NODES);
            let mut parts = Vec::with_capacity(steps.len());
            for step in steps.iter().filter(|step| !step.measurements.is_empty()) {
                let shared = habit.shared_at(&step.places());
                let inverse = habit.own_at(step)?.inverse();
                let values = step.values();
                information += shared.transpose() * &inverse * &shared;
                gradient += shared.transpose() * &inverse * &values;
                parts.push((shared, inverse, values));
            }
            let covariance = information.cholesky()?.inverse();
            habit.mean = &covariance * gradient;
            // Squares of what remains, and their number less that of the numbers fitted.
            let (mut squares, mut count) = (0.0, 0.0);
            for (shared, inverse, values) in &parts {
                let rest = values - shared * &habit.mean;
                squares += rest.dot(&(inverse * &rest));
                let explained = shared * &covariance * shared.transpose() * inverse;
                count += values.len() as f64 - explained.trace();
            }
            habit.covariance = covariance;
            let ratio = (squares + PRIOR_COUNT) / (count.max(0.0) + PRIOR_COUNT);
            habit.scale = (habit.scale * ratio.sqrt()).clamp(SCALES[0], SCALES[1]);
        }
        Some(habit)
    }

    /// Mean and variance of the deviation of a step.
    pub(crate) fn at(&self, step: &Step, places: &[Place]) -> Option<Vec<[f64; 2]>> {
        if step.measurements.is_empty() {
            let unseen = |place: &Place| {
                [
                    self.features(place).dot(&self.mean),
                    self.variance(step, place),
                ]
            };
            return Some(places.iter().map(unseen).collect());
        }
        let inverse = self.own_at(step)?.inverse();
        let shared = self.shared_at(&step.places());
        let rest = step.values() - &shared * &self.mean;
        let of_place = |place: &Place| {
            let own = step.measurements.iter();
            let own = own.map(|m| self.own(step, &m.place, place));
            let own = DVector::from_iterator(step.measurements.len(), own);
            let gain = &inverse * &own;
            let features = self.features(place);
            // Of the shared curve, less what the own frames say of the sum.
            let left = &features - shared.transpose() * &gain;
            let mean = features.dot(&self.mean) + gain.dot(&rest);
            let variance = self.own(step, place, place) - own.dot(&gain)
                + left.dot(&(&self.covariance * &left));
            [mean, variance.max(0.0) + place.beyond]
        };
        Some(places.iter().map(of_place).collect())
    }

    /// Variance of the deviation without frames of the step.
    pub(crate) fn variance(&self, step: &Step, place: &Place) -> f64 {
        let features = self.features(place);
        let shared = features.dot(&(&self.covariance * &features));
        self.own(step, place, place) + shared + place.beyond
    }

    /// Factors of the whitened shared curve.
    fn features(&self, place: &Place) -> DVector<f64> {
        self.shared_at(std::slice::from_ref(place))
            .row(0)
            .transpose()
    }

    /// The same, a row for each place.
    fn shared_at(&self, places: &[Place]) -> DMatrix<f64> {
        let kernel = DMatrix::from_fn(NODES, places.len(), |k, n| {
            let node = (k + 1) as f64 / (NODES + 1) as f64;
            self.config.shared
                * envelope(self.config.kind, &places[n])
                * shared_kernel(places[n].phase - node)
        });
        let solved = self.nodes.l().solve_lower_triangular(&kernel);
        solved.map_or(DMatrix::zeros(places.len(), NODES), |solved| {
            solved.transpose()
        })
    }

    /// Covariance of the measurements of a step without the shared curve, as factors.
    fn own_at(&self, step: &Step) -> Option<Cholesky<f64, Dyn>> {
        let all = &step.measurements;
        let covariance = DMatrix::from_fn(all.len(), all.len(), |i, j| {
            let own = self.own(step, &all[i].place, &all[j].place);
            own + if i == j {
                all[i].variance + all[i].place.beyond
            } else {
                0.0
            }
        });
        covariance.cholesky()
    }

    /// Covariance of own deviations and of errors of events.
    fn own(&self, step: &Step, a: &Place, b: &Place) -> f64 {
        let size = self.scale * self.config.own;
        let envelopes = envelope(self.config.kind, a) * envelope(self.config.kind, b);
        let own =
            size * size * envelopes * own_kernel((a.time_s - b.time_s).abs() / self.config.own_s);
        let variances = step.event_sigmas_s.map(|sigma| sigma * sigma);
        let weights = a.event_weights.iter().zip(&b.event_weights);
        let events = weights.zip(variances).map(|((a, b), own)| a * b * own);
        let events = events.sum::<f64>();
        own + a.rate * b.rate * events
    }
}

impl Step {
    fn places(&self) -> Vec<Place> {
        self.measurements.iter().map(|own| own.place).collect()
    }

    fn values(&self) -> DVector<f64> {
        let values = self.measurements.iter().map(|own| own.value);
        DVector::from_iterator(self.measurements.len(), values)
    }
}

/// Phases between which positions deviate: before and after that toe or heel are on the ground.
const FREE: [f64; 2] = [0.1, 0.98];

/// Size of deviations over a step, 1 in its middle.
fn envelope(kind: Quantity, place: &Place) -> f64 {
    match kind {
        Quantity::Position => {
            let free = (place.phase - FREE[0]) / (FREE[1] - FREE[0]);
            let free = free.clamp(0.0, 1.0);
            (4.0 * free * (1.0 - free)).powi(2)
        }
        Quantity::Rotation => 4.0 * place.phase * (1.0 - place.phase),
    }
}

/// Matérn kernel of order 3/2: slopes at the edge of what frames show say little of what is beyond.
fn shared_kernel(phases: f64) -> f64 {
    let r = 3.0_f64.sqrt() * phases.abs() / SHARED_LENGTH;
    (1.0 + r) * libm::exp(-r)
}

/// Matérn kernel of order 5/2.
fn own_kernel(distance: f64) -> f64 {
    let r = 5.0_f64.sqrt() * distance;
    (1.0 + r + r * r / 3.0) * libm::exp(-r)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_noise::Noise;

    const CONFIG: AxisConfig = AxisConfig {
        kind: Quantity::Rotation,
        shared: 0.05,
        own: 0.01,
        own_s: 0.15,
    };
    const SECONDS: f64 = 0.7;

    fn place(phase: f64) -> Place {
        Place {
            time_s: SECONDS * phase,
            phase,
            event_weights: [0.0, 1.0 - phase, phase, 0.0],
            rate: 0.0,
            beyond: 0.0,
        }
    }

    /// A curve that is none of the model's.
    fn shared(phase: f64) -> f64 {
        0.06 * libm::sin(std::f64::consts::PI * phase).powi(2) * libm::cos(4.0 * phase)
    }

    fn own(phase: f64, sizes: [f64; 2]) -> f64 {
        let turn = std::f64::consts::PI * phase;
        sizes[0] * libm::sin(turn) + sizes[1] * libm::sin(2.0 * turn)
    }

    fn step(sizes: [f64; 2], phases: &[f64], noise: &mut Noise) -> Step {
        let measurement = |phase: &f64| Measurement {
            place: place(*phase),
            value: shared(*phase) + own(*phase, sizes) + 2e-3 * noise.next(),
            variance: 4e-6,
        };
        Step {
            measurements: phases.iter().map(measurement).collect(),
            event_sigmas_s: [0.0; 4],
        }
    }

    #[test]
    fn shared_curves_are_learned_where_frames_show_them() {
        let mut noise = Noise::new(1);
        let mut steps = Vec::new();
        for n in 0..20 {
            let sizes = [0, 1].map(|_| 0.005 * noise.next());
            // Frames at other phases in each step, and none in the first third.
            let phases = [0, 1, 2, 3].map(|k| 0.35 + 0.15 * f64::from(k) + 0.006 * f64::from(n));
            steps.push(step(sizes, &phases, &mut noise));
        }
        let habit = AxisHabit::learned(CONFIG, &steps).unwrap();
        let unseen = Step {
            measurements: Vec::new(),
            event_sigmas_s: [0.0; 4],
        };
        for phase in [0.5, 0.65, 0.8] {
            let [mean, variance] = habit.at(&unseen, &[place(phase)]).unwrap()[0];
            assert!((mean - shared(phase)).abs() < 0.008, "{phase}: {mean}");
            assert!(variance.sqrt() < 0.012, "{phase}: {variance}");
        }
        let [_, variance] = habit.at(&unseen, &[place(0.15)]).unwrap()[0];
        let generic = AxisHabit::generic(CONFIG);
        assert!(variance > 0.5 * generic.variance(&unseen, &place(0.15)));
    }

    #[test]
    fn errors_of_hidden_parts_are_as_stated() {
        let (mut squares, mut count) = (0.0, 0.0);
        for seed in 0..30 {
            let mut noise = Noise::new(100 + seed);
            let sizes: Vec<[f64; 2]> = (0..16)
                .map(|_| [0.008 * noise.next(), 0.004 * noise.next()])
                .collect();
            let phases = |n: usize| match n % 2 {
                0 => vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9],
                _ => vec![0.8, 0.9],
            };
            let all = sizes.iter().enumerate();
            let steps: Vec<Step> = all
                .map(|(n, sizes)| step(*sizes, &phases(n), &mut noise))
                .collect();
            let habit = AxisHabit::learned(CONFIG, &steps).unwrap();
            for n in (1..16).step_by(2) {
                let [mean, variance] = habit.at(&steps[n], &[place(0.45)]).unwrap()[0];
                let error = mean - shared(0.45) - own(0.45, sizes[n]);
                squares += error * error / variance;
                count += 1.0;
            }
        }
        let nees = squares / count;
        assert!((0.5..1.6).contains(&nees), "{nees}");
    }

    #[test]
    fn late_events_shift_the_whole_step() {
        // The generic motion is 4 m/s fast, and the step 20 ms late.
        let moving = |phase| Place {
            rate: 4.0,
            ..place(phase)
        };
        let step = Step {
            measurements: vec![Measurement {
                place: moving(0.7),
                value: -0.08,
                variance: 1e-6,
            }],
            event_sigmas_s: [0.0, 0.02, 0.02, 0.0],
        };
        let habit = AxisHabit::generic(AxisConfig {
            shared: 1e-3,
            own: 1e-3,
            ..CONFIG
        });
        let [mean, _] = habit.at(&step, &[moving(0.6)]).unwrap()[0];
        assert!((-0.1..-0.05).contains(&mean), "{mean}");
    }
}
