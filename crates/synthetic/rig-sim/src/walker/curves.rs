//! Curves that feet and chest follow over time and speed.

/// 0 to 1 with no speed and no acceleration at the ends.
pub(super) fn smooth(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

/// Fraction of the usual roll of a foot at a speed.
pub(super) fn vigour(speed: f64) -> f64 {
    (speed / 1.3).clamp(0.0, 1.2)
}

/// 0 for walking, 1 for running.
pub(super) fn running_share(speed: f64) -> f64 {
    let t = ((speed - 1.8) / 0.5).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
