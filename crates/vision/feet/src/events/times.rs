//! Distributions of times, and the fit of motions that begin or end at a time.

use nalgebra::{Matrix3, Vector3};

/// Times that are tried, s.
pub(super) const STEP_S: f64 = 0.002;

/// A measurement that depends on three unknown numbers.
pub(super) struct Row {
    pub(super) factors: Vector3<f64>,
    pub(super) value: f64,
    pub(super) variance: f64,
}

/// What is known of three numbers: means and standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Habit {
    pub(super) mean: Vector3<f64>,
    pub(super) sigma: Vector3<f64>,
}

/// Estimates of three numbers from measurements.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Motion {
    pub(super) mean: Vector3<f64>,
    pub(super) variance: Vector3<f64>,
    /// Logarithm of the likelihood of the measurements.
    pub(super) log: f64,
}

/// Estimates the numbers, and the likelihood of the measurements with all of them.
pub(super) fn fit(rows: &[Row], habit: &Habit) -> Option<Motion> {
    let inverse = habit.sigma.map(|sigma| sigma.powi(-2));
    let mut information = Matrix3::from_diagonal(&inverse);
    let determinant = information.determinant();
    let (mut gradient, mut sum) = (Vector3::zeros(), 0.0);
    for row in rows {
        let residual = row.value - row.factors.dot(&habit.mean);
        information += row.factors * row.factors.transpose() / row.variance;
        gradient += row.factors * (residual / row.variance);
        sum += residual * residual / row.variance + libm::log(row.variance);
    }
    let covariance = information.try_inverse()?;
    let moved = covariance * gradient;
    Some(Motion {
        mean: habit.mean + moved,
        variance: covariance.diagonal(),
        log: 0.5
            * (gradient.dot(&moved) - sum - libm::log(information.determinant() / determinant)),
    })
}

/// Weights that sum to 1, by logarithms of likelihoods; `None` of no finite ones.
pub(super) fn weights(logs: &[f64]) -> Option<Vec<f64>> {
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if !most.is_finite() {
        return None;
    }
    let weights: Vec<f64> = logs.iter().map(|log| libm::exp(log - most)).collect();
    let sum: f64 = weights.iter().sum();
    Some(weights.iter().map(|weight| weight / sum).collect())
}

/// Mean and standard deviation of values by their weights.
pub(super) fn moments(values: impl Fn(usize) -> f64, weights: &[f64]) -> [f64; 2] {
    let mean = |of: &dyn Fn(usize) -> f64| {
        let terms = weights.iter().enumerate();
        terms.map(|(k, weight)| weight * of(k)).sum::<f64>()
    };
    let middle = mean(&|k| values(k));
    let variance = mean(&|k| (values(k) - middle).powi(2));
    [middle, variance.sqrt()]
}

/// Logarithm of a normal density without its constant.
pub(super) fn log_normal(value: f64, [mean, sigma]: [f64; 2]) -> f64 {
    -0.5 * ((value - mean) / sigma).powi(2)
}

/// The mean of a number over the steps of a wearer: of `mean` with a standard deviation between
/// people, and estimates with their variances, which scatter from step to step besides.
pub(super) fn typical(
    [mean, between_people]: [f64; 2],
    between_steps: f64,
    estimates: impl Iterator<Item = [f64; 2]>,
) -> [f64; 2] {
    let prior = between_people.powi(-2);
    let (mut sum, mut information) = (mean * prior, prior);
    for [value, variance] in estimates {
        let weight = 1.0 / (variance + between_steps * between_steps);
        sum += value * weight;
        information += weight;
    }
    // Other steps of the wearer scatter about his mean, which is uncertain itself.
    [
        sum / information,
        (1.0 / information + between_steps * between_steps).sqrt(),
    ]
}

/// What measurements alone say, with its variance, of an estimate that a prior was part of.
pub(super) fn without_prior([mean, sigma]: [f64; 2], prior: [f64; 2]) -> Option<[f64; 2]> {
    let information = sigma.powi(-2) - prior[1].powi(-2);
    (information > 0.4 * prior[1].powi(-2)).then(|| {
        let sum = mean * sigma.powi(-2) - prior[0] * prior[1].powi(-2);
        [sum / information, 1.0 / information]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_fitted_between_habit_and_measurements() {
        let habit = Habit {
            mean: Vector3::new(1.0, 0.0, 5.0),
            sigma: Vector3::new(1.0, 1e-6, 1.0),
        };
        let row = |value| Row {
            factors: Vector3::new(1.0, 0.0, 0.0),
            value,
            variance: 1.0,
        };
        let found = fit(&[row(3.0)], &habit).unwrap();
        assert!((found.mean - Vector3::new(2.0, 0.0, 5.0)).norm() < 1e-9);
        assert!((found.variance.x - 0.5).abs() < 1e-9);
        let likelier = fit(&[row(1.0)], &habit).unwrap();
        assert!(likelier.log > found.log);
    }

    #[test]
    fn typical_numbers_go_from_those_of_people_to_those_of_the_wearer() {
        let none = typical([0.1, 0.02], 0.01, std::iter::empty());
        assert!((none[0] - 0.1).abs() < 1e-12 && (none[1] - 0.02_f64.hypot(0.01)).abs() < 1e-12);
        let many = typical([0.1, 0.02], 0.01, (0..1000).map(|_| [0.13, 1e-6]));
        assert!((many[0] - 0.13).abs() < 1e-3 && (many[1] - 0.01).abs() < 1e-3);
    }
}
