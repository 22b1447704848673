//! Intervals in which no frame shows a foot.

use crate::contact::seconds;
use crate::stance::FootObservation;

/// Begin and end, s, of the intervals longer than a time, s, between observations of either foot,
/// in order. Those before the first and after the last one do not count.
pub fn unseen_intervals(feet: [&[FootObservation]; 2], longer_than_s: f64) -> Vec<[f64; 2]> {
    let seen = feet.into_iter().flatten();
    let mut seen_s: Vec<f64> = seen.map(|own| seconds(own.time_ns)).collect();
    seen_s.sort_by(f64::total_cmp);
    let pairs = seen_s.windows(2).map(|pair| [pair[0], pair[1]]);
    pairs.filter(|[a, b]| b - a > longer_than_s).collect()
}

#[cfg(test)]
mod tests {
    use cad_transforms::{Covariance, RigidTransform};

    use super::*;

    #[test]
    fn either_foot_ends_an_interval() {
        let seen_at = |times_ms: &[i64]| -> Vec<FootObservation> {
            let seen = times_ms.iter().map(|ms| FootObservation {
                time_ns: ms * 1_000_000,
                world_from_foot: RigidTransform::identity(),
                covariance: Covariance::zero(),
            });
            seen.collect()
        };
        let [left, right] = [seen_at(&[0, 100, 2000]), seen_at(&[600, 1100])];
        let found = unseen_intervals([&left, &right], 0.8);
        assert_eq!(found, [[1.1, 2.0]]);
    }
}
