//! Root mean squares and percentiles.

/// Root mean square; 0 of no values.
pub(super) fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// The value that a share of all does not exceed; NaN of no values.
pub(super) fn percentile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = (share * values.len() as f64).ceil() as usize;
    values.get(at.max(1) - 1).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_the_values() {
        let values: Vec<f64> = (1..=20).rev().map(f64::from).collect();
        assert_eq!(percentile(values.clone(), 0.95), 19.0);
        assert_eq!(percentile(values, 0.5), 10.0);
        assert_eq!(percentile(vec![3.0], 0.95), 3.0);
        assert!(percentile(Vec::new(), 0.5).is_nan());
    }
}
