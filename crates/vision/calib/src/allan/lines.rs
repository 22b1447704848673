//! Noise coefficients by lines of a fixed slope in the log-log plot, the common graphical method.
//!
//! N is the value at τ = 1 s of a line of slope -1/2 through the beginning of the curve, K the
//! value at τ = 3 s of a line of slope +1/2. The ROS package `allan_variance_ros` fits the first to
//! all points below 10 s and the second to *all* points, evenly spaced in τ, whether or not the
//! curve has that slope there. [`mod@super::fit`] estimates which terms the curve contains; these
//! functions are for comparison with files made by the common method.

/// The height at `at` of the line of this slope that fits the points (τ, σ) best in the least
/// squares of the logarithms; none without points. Those that are not above zero are left out.
pub fn height(points: impl IntoIterator<Item = (f64, f64)>, slope: f64, at_s: f64) -> Option<f64> {
    let usable = points
        .into_iter()
        .filter(|(tau, sigma)| *tau > 0.0 && *sigma > 0.0);
    let (sum, count) = usable.fold((0.0, 0_u64), |(sum, count), (tau, sigma)| {
        (sum + sigma.ln() - slope * tau.ln(), count + 1)
    });
    (count > 0).then(|| (sum / count as f64 + slope * at_s.ln()).exp())
}

/// White noise N: slope -1/2 through the points below `until_s`, at 1 s.
///
/// ```
/// use calib::allan::lines::white;
///
/// // A curve of white noise of 2 at 1 s.
/// let points: Vec<(f64, f64)> = [0.1, 0.4, 1.6, 6.4].map(|tau: f64| (tau, 2.0 / tau.sqrt())).to_vec();
/// let density = white(&points, 10.0).ok_or("no points")?;
/// assert!((density - 2.0).abs() < 1e-12);
/// # Ok::<(), &str>(())
/// ```
pub fn white(points: &[(f64, f64)], until_s: f64) -> Option<f64> {
    let below = points.iter().copied().filter(|(tau, _)| *tau < until_s);
    height(below, -0.5, 1.0)
}

/// Random walk K: slope +1/2 through the points from `from_s`, at 3 s.
pub fn walk(points: &[(f64, f64)], from_s: f64) -> Option<f64> {
    let from = points.iter().copied().filter(|(tau, _)| *tau >= from_s);
    height(from, 0.5, 3.0)
}
