//! Quantiles of the chi-squared distribution.
//!
//! The incomplete gamma function is summed by its series or its continued fraction (Abramowitz and
//! Stegun 6.5.29 and 6.5.31); the quantile is found by bisection, to 10 digits.

/// The value below which a chi-squared variable with `freedom` degrees of freedom (any number
/// above 0) is with this probability (between 0 and 1).
///
/// ```
/// use calib::allan::chi2::{below, quantile};
///
/// // The 95 % limit of a sum of ten squares (table of the chi-squared distribution).
/// let limit = quantile(0.95, 10.0);
/// assert!((limit - 18.307).abs() < 1e-3, "{limit}");
/// assert!((below(limit, 10.0) - 0.95).abs() < 1e-9);
/// ```
pub fn quantile(probability: f64, freedom: f64) -> f64 {
    let mut low = 0.0;
    let mut high = freedom.max(1.0);
    while below(high, freedom) < probability && high < 1e300 {
        (low, high) = (high, 2.0 * high);
    }
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if below(middle, freedom) < probability {
            low = middle;
        } else {
            high = middle;
        }
        if high - low <= 1e-11 * high {
            break;
        }
    }
    0.5 * (low + high)
}

/// The probability that a chi-squared variable is below `value`.
pub fn below(value: f64, freedom: f64) -> f64 {
    let (a, x) = (0.5 * freedom, 0.5 * value);
    if x <= 0.0 {
        return 0.0;
    }
    let scale = (a * x.ln() - x - libm::lgamma(a)).exp();
    // Both converge in a few times √a steps where they are used.
    let most = 200 + (20.0 * a.sqrt()) as usize;
    if x < a + 1.0 {
        let mut term = 1.0 / a;
        let mut sum = term;
        for k in 1..most {
            term *= x / (a + k as f64);
            sum += term;
            if term < 1e-16 * sum {
                break;
            }
        }
        (sum * scale).min(1.0)
    } else {
        // Lentz's method for the continued fraction of the upper part.
        let mut b = x + 1.0 - a;
        let mut c = 1e300;
        let mut d = 1.0 / b;
        let mut fraction = d;
        for k in 1..most {
            let k = k as f64;
            let a_k = -k * (k - a);
            b += 2.0;
            d = 1.0 / (a_k * d + b);
            c = b + a_k / c;
            fraction *= c * d;
            if (c * d - 1.0).abs() < 1e-16 {
                break;
            }
        }
        (1.0 - fraction * scale).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Percentage points of Abramowitz and Stegun, table 26.8, and of an exponential variable.
    #[test]
    fn known_quantiles() {
        let cases = [
            (0.95, 1.0, 3.841_46),
            (0.05, 10.0, 3.940_30),
            (0.975, 10.0, 20.4832),
            (0.99, 30.0, 50.8922),
            (0.025, 100.0, 74.2219),
            (0.5, 2.0, 2.0 * std::f64::consts::LN_2),
            (0.9, 2.0, 2.0 * 10_f64.ln()),
        ];
        for (p, freedom, value) in cases {
            let found = quantile(p, freedom);
            assert!((found / value - 1.0).abs() < 4e-6, "{p} {freedom}: {found}");
        }
        // Many degrees of freedom: normal, with the first correction of Fisher's.
        let found = quantile(0.975, 1e6);
        let normal = 0.5 * (1.959_964 + (2e6_f64 - 1.0).sqrt()).powi(2);
        assert!((found / normal - 1.0).abs() < 1e-5, "{found} {normal}");
    }
}
