//! How well uncertainties order errors, and how well a PSNR is predicted.

use super::rules::Verdicts;
use super::samples::Sample;

/// Mean absolute error of the PSNR that a measure predicts, dB: its uncertainty is minus the PSNR.
pub(crate) fn mean_error_db(samples: &[Sample], of: &Verdicts) -> f64 {
    let both = samples.iter().zip(&of.uncertainty);
    let errors = both.map(|(sample, uncertainty)| (sample.errors.psnr_db + uncertainty).abs());
    errors.sum::<f64>() / samples.len() as f64
}

/// Area between the sparsification curve and that of an oracle (Ilg et al. 2018): the mean error of
/// what remains as the most uncertain are left out, over the share that is left out, relative to
/// the mean error of all. 0 is the order of the errors themselves.
pub(crate) fn ause(uncertainty: &[f64], error: &[f64]) -> f64 {
    let curve = |by: &[f64]| {
        let mut order: Vec<usize> = (0..error.len()).collect();
        order.sort_by(|a, b| by[*a].total_cmp(&by[*b]));
        let mut sum = 0.0;
        let means = order.iter().zip(1..).map(|(k, count)| {
            sum += error[*k];
            sum / f64::from(count)
        });
        means.collect::<Vec<f64>>()
    };
    let (found, best) = (curve(uncertainty), curve(error));
    let Some(all) = best.last().filter(|all| **all > 0.0) else {
        return f64::NAN;
    };
    let between = found.iter().zip(&best).map(|(a, b)| a - b);
    between.sum::<f64>() / (error.len() as f64 * all)
}

/// Spearman's rank correlation.
pub(crate) fn spearman(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let mean = (a.len() as f64 - 1.0) / 2.0;
    let product = |x: &[f64], y: &[f64]| {
        let both = x.iter().zip(y);
        both.map(|(x, y)| (x - mean) * (y - mean)).sum::<f64>()
    };
    product(&a, &b) / (product(&a, &a) * product(&b, &b)).sqrt()
}

/// Ranks from 0; equal values have the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut from = 0;
    for group in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let rank = from as f64 + (group.len() as f64 - 1.0) / 2.0;
        group.iter().for_each(|k| ranks[*k] = rank);
        from += group.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::confidence::rules;

    #[test]
    fn error_of_the_predicted_psnr() {
        let samples = [24.0, 17.0].map(|db| rules::tests::sample(db, 0.0, [0.0; 2], 1.0));
        let of = Verdicts {
            uncertainty: vec![-22.0, -18.0],
            flagged: vec![false; 2],
        };
        assert!((mean_error_db(&samples, &of) - 1.5).abs() < 1e-12);
        assert!((mean_error_db(&samples[1..], &of.of(1..2)) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_order_of_the_errors_is_the_best_one() {
        let error = [0.1, 0.5, 0.2, 0.9, 0.3];
        assert_eq!(ause(&error, &error), 0.0);
        let reversed = error.map(|e| -e);
        let random = [0.3, 0.1, 0.2, 0.5, 0.4];
        assert!(ause(&reversed, &error) > ause(&random, &error));
        assert!((spearman(&error, &error.map(|e| e * e)) - 1.0).abs() < 1e-12);
        assert!((spearman(&error, &reversed) + 1.0).abs() < 1e-12);
        assert_eq!(ranks(&[2.0, 1.0, 2.0, 5.0]), [1.5, 0.0, 1.5, 3.0]);
    }
}
