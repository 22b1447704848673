//! Deviation of a foot from its usual motion between two contacts, from what frames show of it.
//!
//! Contract: along each axis the deviation is a Gaussian process whose acceleration is correlated
//! over a short time; it is at rest at both ends. Frames are measurements of it, and so its
//! uncertainty grows with the square of the time to the nearest ones. Means and variances are those
//! of all measurements (a Kalman filter and a smoother of Rauch, Tung and Striebel).

use nalgebra::{Matrix3, RowVector3, Vector3};

/// A measurement of a deviation along one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// Its time, s.
    pub time_s: f64,
    /// The deviation, m or rad.
    pub value: f64,
    /// Variance of that.
    pub variance: f64,
}

/// How deviations change along one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Process {
    /// Standard deviation of the acceleration, m/s² or rad/s².
    pub acceleration: f64,
    /// Time over which it is correlated, s.
    pub correlation_s: f64,
}

/// Maximum time between states, s.
const MAX_STEP_S: f64 = 0.01;

/// Mean and variance of the deviation at ordered times from `from_s` to `to_s`, where it is at rest
/// with `end_variance`.
pub fn bridge(
    [from_s, to_s]: [f64; 2],
    end_variance: f64,
    measurements: &[Measurement],
    process: Process,
    times_s: &[f64],
) -> Vec<[f64; 2]> {
    let mut nodes: Vec<f64> = vec![from_s, to_s];
    nodes.extend(measurements.iter().map(|measured| measured.time_s));
    nodes.extend(times_s);
    nodes.retain(|time| (from_s..=to_s).contains(time));
    nodes.sort_by(f64::total_cmp);
    nodes.dedup();
    let nodes = fill(&nodes);
    let accelerations = process.acceleration * process.acceleration;
    let rest = RowVector3::new(end_variance, 1e-6, accelerations);
    let mut state = State {
        mean: Vector3::zeros(),
        covariance: Matrix3::from_diagonal(&rest.transpose()),
    };
    let mut filtered = Vec::with_capacity(nodes.len());
    let mut predicted = Vec::with_capacity(nodes.len());
    let mut next = 0;
    let mut last_s = from_s;
    for &time_s in &nodes {
        let (transition, noise) = step(process, time_s - last_s);
        state = state.after(&transition, &noise);
        predicted.push((state, transition));
        while let Some(measured) = measurements.get(next).filter(|m| m.time_s <= time_s) {
            if measured.time_s == time_s {
                state.update(0, measured.value, measured.variance);
            }
            next += 1;
        }
        if time_s == to_s {
            state.update(0, 0.0, end_variance);
            state.update(1, 0.0, 1e-6);
        }
        filtered.push(state);
        last_s = time_s;
    }
    let smoothed = smooth(&filtered, &predicted);
    let of_time = |time: &f64| {
        let k = nodes
            .partition_point(|node| node < time)
            .min(nodes.len() - 1);
        [smoothed[k].mean[0], smoothed[k].covariance[(0, 0)].max(0.0)]
    };
    times_s.iter().map(of_time).collect()
}

/// Position, velocity and acceleration of a deviation.
#[derive(Clone, Copy, Debug)]
struct State {
    mean: Vector3<f64>,
    covariance: Matrix3<f64>,
}

impl State {
    fn after(&self, transition: &Matrix3<f64>, noise: &Matrix3<f64>) -> Self {
        Self {
            mean: transition * self.mean,
            covariance: transition * self.covariance * transition.transpose() + noise,
        }
    }

    /// Measures one of its components.
    fn update(&mut self, component: usize, value: f64, variance: f64) {
        let column = self.covariance.column(component).into_owned();
        let gain = column / (column[component] + variance);
        self.mean += gain * (value - self.mean[component]);
        self.covariance -= gain * column.transpose();
    }
}

/// Transition over a time, and the covariance that is added, to second order in short times.
fn step(process: Process, seconds: f64) -> (Matrix3<f64>, Matrix3<f64>) {
    let kept = libm::exp(-seconds / process.correlation_s);
    let transition = Matrix3::new(
        1.0,
        seconds,
        0.5 * seconds * seconds,
        0.0,
        1.0,
        seconds,
        0.0,
        0.0,
        kept,
    );
    let variance = process.acceleration * process.acceleration * (1.0 - kept * kept);
    let mut noise = Matrix3::zeros();
    noise[(2, 2)] = variance;
    (transition, noise)
}

fn smooth(filtered: &[State], predicted: &[(State, Matrix3<f64>)]) -> Vec<State> {
    let mut smoothed = filtered.to_vec();
    for k in (0..filtered.len().saturating_sub(1)).rev() {
        let (prediction, transition) = &predicted[k + 1];
        let Some(inverse) = prediction.covariance.try_inverse() else {
            continue;
        };
        let own = &filtered[k];
        let gain = own.covariance * transition.transpose() * inverse;
        let next = smoothed[k + 1];
        smoothed[k] = State {
            mean: own.mean + gain * (next.mean - prediction.mean),
            covariance: own.covariance
                + gain * (next.covariance - prediction.covariance) * gain.transpose(),
        };
    }
    smoothed
}

/// With further times where two are far apart.
fn fill(nodes: &[f64]) -> Vec<f64> {
    let mut filled: Vec<f64> = nodes.first().copied().into_iter().collect();
    for pair in nodes.windows(2) {
        let count = ((pair[1] - pair[0]) / MAX_STEP_S).ceil().max(1.0);
        let inner = (1..count as usize).map(|n| {
            let share = n as f64 / count;
            pair[0] + (pair[1] - pair[0]) * share
        });
        filled.extend(inner);
        filled.push(pair[1]);
    }
    filled
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_noise::Noise;

    const PROCESS: Process = Process {
        acceleration: 8.0,
        correlation_s: 0.06,
    };

    #[test]
    fn uncertainty_grows_with_the_length_of_a_gap() {
        let worst = |gap_s: f64| {
            let times: Vec<f64> = (0..50).map(|n| gap_s * f64::from(n) / 49.0).collect();
            let found = bridge([0.0, gap_s], 1e-8, &[], PROCESS, &times);
            found.iter().map(|v| v[1].sqrt()).fold(0.0, f64::max)
        };
        // Values for 0.25, 0.41 and 0.56 s of a table in the literature study: 12, 35 and 63 mm.
        for (gap_s, expected) in [(0.25, 0.012), (0.41, 0.035), (0.56, 0.063)] {
            let found = worst(gap_s);
            assert!((0.6..1.6).contains(&(found / expected)), "{gap_s}: {found}");
        }
    }

    #[test]
    fn measurements_pull_the_mean_and_narrow_the_variance() {
        let measured = [0.3, 0.35].map(|time_s| Measurement {
            time_s,
            value: 0.05,
            variance: 1e-6,
        });
        let times = [0.15, 0.3, 0.325, 0.4];
        let found = bridge([0.0, 0.45], 1e-8, &measured, PROCESS, &times);
        assert!((found[1][0] - 0.05).abs() < 0.002, "{found:?}");
        assert!((found[2][0] - 0.05).abs() < 0.005, "{found:?}");
        assert!(found[0][1] > 20.0 * found[2][1], "{found:?}");
    }

    #[test]
    fn errors_of_drawn_deviations_are_as_stated() {
        // Of drawn processes the late half is measured, and the early half compared.
        let mut noise = Noise::new(1);
        let (mut squares, count) = (0.0, 400);
        for _ in 0..count {
            let (transition, added) = step(PROCESS, 0.005);
            let mut own = Vector3::new(0.0, 0.0, PROCESS.acceleration * noise.next());
            let mut path = vec![own[0]];
            for _ in 0..80 {
                own = transition * own;
                own[2] += added[(2, 2)].sqrt() * noise.next();
                path.push(own[0]);
            }
            let measured: Vec<Measurement> = (40..80)
                .step_by(8)
                .map(|k| Measurement {
                    time_s: 0.005 * k as f64,
                    value: path[k] + 1e-3 * noise.next(),
                    variance: 1e-6,
                })
                .collect();
            // The end is not at rest: only the times before the last measurement count.
            let found = bridge([0.0, 9.0], 1e-8, &measured, PROCESS, &[0.1]);
            squares += (found[0][0] - path[20]).powi(2) / found[0][1] / f64::from(count);
        }
        assert!((0.8..1.25).contains(&squares), "{squares}");
    }
}
