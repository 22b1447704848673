//! Deviations of phase: Allan, overlapping Allan, modified Allan, Hadamard, overlapping Hadamard,
//! total.
//!
//! Formulas from Riley and Howe, *Handbook of Frequency Stability Analysis*, NIST SP 1065 (2008),
//! chapter 5. Each takes phase `x` at a constant period τ₀ in seconds and an averaging factor `m`,
//! and returns the deviation at τ = m τ₀; `None` if the phase is too short for a single term.

/// Phase of a rate: its running sum, in units of rate times samples, one longer than the rate. The
/// mean rate is removed first; no deviation here depends on it, and the sum remains small.
pub fn phase(rate: &[f64]) -> Vec<f64> {
    let mean = rate.iter().sum::<f64>() / rate.len().max(1) as f64;
    let mut phase = Vec::with_capacity(rate.len() + 1);
    let mut sum = 0.0;
    phase.push(sum);
    for r in rate {
        sum += r - mean;
        phase.push(sum);
    }
    phase
}

/// Sum of the squares of all second differences of spacing `m`.
pub(crate) fn second_differences(x: &[f64], m: usize) -> f64 {
    let Some((middle, last)) = x.get(m..).zip(x.get(2 * m..)) else {
        return 0.0;
    };
    let terms = x.iter().zip(middle).zip(last);
    terms.map(|((a, b), c)| (c - 2.0 * b + a).powi(2)).sum()
}

/// Allan deviation from averages that do not overlap.
pub fn adev(x: &[f64], period_s: f64, m: usize) -> Option<f64> {
    oadev(&every(x, m)?, period_s * m as f64, 1)
}

/// Overlapping Allan deviation.
///
/// ```
/// use calib::allan::deviation::{adev, oadev};
///
/// // An offset and a drift of the phase at a constant rate do not count, an acceleration does.
/// let steady: Vec<f64> = (0..20).map(|i| 5.0 + 3.0 * f64::from(i)).collect();
/// assert_eq!(oadev(&steady, 1.0, 2), Some(0.0));
/// let accelerated: Vec<f64> = (0..20).map(|i| f64::from(i * i)).collect();
/// assert_eq!(oadev(&accelerated, 1.0, 1), Some(2.0_f64.sqrt()));
/// assert_eq!(oadev(&accelerated, 1.0, 1), adev(&accelerated, 1.0, 1));
/// // Too short for a single term.
/// assert_eq!(oadev(&steady[..4], 1.0, 2), None);
/// ```
pub fn oadev(x: &[f64], period_s: f64, m: usize) -> Option<f64> {
    let terms = count(x, 2, m)?;
    let tau = m as f64 * period_s;
    Some((second_differences(x, m) / (2.0 * tau * tau * terms)).sqrt())
}

/// Modified Allan deviation.
pub fn mdev(x: &[f64], period_s: f64, m: usize) -> Option<f64> {
    let terms = count(x, 3, m)? + 1.0;
    let tau = m as f64 * period_s;
    // The sum over m neighbouring second differences, updated recursively.
    let second = |i: usize| x[i + 2 * m] - 2.0 * x[i + m] + x[i];
    let mut inner: f64 = (0..m).map(second).sum();
    let mut sum = inner * inner;
    for i in 0..x.len() - 3 * m {
        inner += x[i + 3 * m] - 3.0 * x[i + 2 * m] + 3.0 * x[i + m] - x[i];
        sum += inner * inner;
    }
    Some((sum / (2.0 * (m as f64 * tau).powi(2) * terms)).sqrt())
}

/// Hadamard deviation from averages that do not overlap.
pub fn hdev(x: &[f64], period_s: f64, m: usize) -> Option<f64> {
    ohdev(&every(x, m)?, period_s * m as f64, 1)
}

/// Overlapping Hadamard deviation.
pub fn ohdev(x: &[f64], period_s: f64, m: usize) -> Option<f64> {
    let terms = count(x, 3, m)?;
    let tau = m as f64 * period_s;
    let third = (0..x.len() - 3 * m)
        .map(|i| (x[i + 3 * m] - 3.0 * x[i + 2 * m] + 3.0 * x[i + m] - x[i]).powi(2));
    Some((third.sum::<f64>() / (6.0 * tau * tau * terms)).sqrt())
}

/// Total deviation: the Allan deviation of the phase continued at both ends by its reflection, so
/// that long averaging times have more terms. Not corrected for the bias that it has in flicker and
/// random-walk noise.
pub fn totdev(x: &[f64], period_s: f64, m: usize) -> Option<f64> {
    let n = x.len();
    if m == 0 || n < 3 || m >= n {
        return None;
    }
    let reflected = |i: isize| -> f64 {
        let last = n as isize - 1;
        if i < 0 {
            2.0 * x[0] - x[i.unsigned_abs()]
        } else if i > last {
            2.0 * x[n - 1] - x[(2 * last - i) as usize]
        } else {
            x[i as usize]
        }
    };
    let tau = m as f64 * period_s;
    let terms = (1..n as isize - 1).map(|i| {
        let (before, after) = (reflected(i - m as isize), reflected(i + m as isize));
        (before - 2.0 * reflected(i) + after).powi(2)
    });
    Some((terms.sum::<f64>() / (2.0 * tau * tau * (n - 2) as f64)).sqrt())
}

/// Every `m`th point.
fn every(x: &[f64], m: usize) -> Option<Vec<f64>> {
    (m > 0).then(|| x.iter().step_by(m).copied().collect())
}

/// Number of differences over `order` averages.
fn count(x: &[f64], order: usize, m: usize) -> Option<f64> {
    let terms = x.len().checked_sub(order.checked_mul(m)?)?;
    (m > 0 && terms > 0).then_some(terms as f64)
}
