//! The domain of a lens model, and directions.

/// Number of steps of the search for the end of a domain.
const SEARCH_STEPS: usize = 400;

/// The largest `x` up to `end` for which `grows` holds everywhere from 0, to 1e-12 of `end`.
pub(super) fn end_of_domain(end: f64, grows: impl Fn(f64) -> bool) -> f64 {
    let step = end / SEARCH_STEPS as f64;
    let Some(first_bad) = (1..=SEARCH_STEPS).find(|&i| !grows(step * i as f64)) else {
        return end;
    };
    let (mut good, mut bad) = (step * (first_bad - 1) as f64, step * first_bad as f64);
    for _ in 0..40 {
        let middle = 0.5 * (good + bad);
        if grows(middle) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    good
}

/// The unit vector; `None` for a vector without a direction.
pub(super) fn unit([x, y, z]: [f64; 3]) -> Option<[f64; 3]> {
    let length = (x * x + y * y + z * z).sqrt();
    (length > 0.0 && length.is_finite()).then(|| [x / length, y / length, z / length])
}
