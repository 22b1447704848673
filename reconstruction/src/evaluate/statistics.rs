//! Statistics of errors.

use serde::Serialize;

/// Statistics of non-negative errors, in their unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Statistics {
    /// Number of errors.
    pub count: usize,
    /// Root of the mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median; for an even number the mean of the middle two.
    pub median: f64,
    /// 95 % are no larger.
    pub p95: f64,
    /// Largest.
    pub max: f64,
}

impl Statistics {
    /// `None` without errors.
    pub fn of(mut errors: Vec<f64>) -> Option<Self> {
        errors.sort_by(f64::total_cmp);
        let max = *errors.last()?;
        let count = errors.len();
        let mean_of = |sum: f64| sum / count as f64;
        Some(Self {
            count,
            rmse: mean_of(errors.iter().map(|e| e * e).sum()).sqrt(),
            mean: mean_of(errors.iter().sum()),
            median: 0.5 * (errors[(count - 1) / 2] + errors[count / 2]),
            p95: errors[(count * 95).div_ceil(100) - 1],
            max,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_few_numbers_by_hand() {
        assert_eq!(Statistics::of(Vec::new()), None);
        let of = Statistics::of(vec![4.0, 0.0, 3.0, 1.0]).expect("numbers");
        assert_eq!((of.count, of.mean, of.median, of.max), (4, 2.0, 2.0, 4.0));
        assert_eq!(of.rmse, (26.0_f64 / 4.0).sqrt());
        let odd = Statistics::of(vec![5.0, 1.0, 2.0]).expect("numbers");
        assert_eq!((odd.median, odd.p95), (2.0, 5.0));
        let hundred = Statistics::of((1..=100).map(f64::from).collect()).expect("numbers");
        assert_eq!(hundred.p95, 95.0);
    }
}
