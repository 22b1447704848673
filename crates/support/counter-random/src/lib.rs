//! Counter-based random numbers: the same `(seed, stream, index)` gives the same number,
//! independent of previous draws, so a lost frame changes nothing else.
//!
//! Everything here is exact integer arithmetic or IEEE 754 basic operations, hence the same on
//! every machine; the logarithm of the standard library is not.

/// 64 random bits (the finalizer of SplitMix64, Steele, Lea and Flood 2014, applied twice).
pub fn bits(seed: u64, stream: u64, index: u64) -> u64 {
    let mix = |x: u64| {
        let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    };
    let golden = 0x9e37_79b9_7f4a_7c15_u64;
    let stream = mix(seed.wrapping_add(golden.wrapping_mul(stream.wrapping_add(1))));
    mix(stream.wrapping_add(golden.wrapping_mul(index.wrapping_add(1))))
}

/// Uniform above 0 and below 1.
pub fn uniform(seed: u64, stream: u64, index: u64) -> f64 {
    // 52 bits and a half are exact in an f64.
    ((bits(seed, stream, index) >> 12) as f64 + 0.5) / (1_u64 << 52) as f64
}

/// Exponential with mean 1.
pub fn exponential(seed: u64, stream: u64, index: u64) -> f64 {
    -ln(uniform(seed, stream, index))
}

/// Mean 0, standard deviation 1, near normal, never beyond 3.47: the sum of four uniform numbers.
pub fn bell(seed: u64, stream: u64, index: u64) -> f64 {
    let word = bits(seed, stream, index);
    let sum: u64 = [0, 16, 32, 48]
        .map(|shift| (word >> shift) & 0xffff)
        .iter()
        .sum();
    // The sum of four has variance 4/12.
    (sum as f64 / 65_535.0 - 2.0) * 1.732_050_807_568_877_2
}

/// Natural logarithm of a normal positive number, to 1e-11: the exponent's share, and for the
/// mantissa `m` in 1..2 the series of `2 artanh((m - 1) / (m + 1))`.
fn ln(x: f64) -> f64 {
    let exponent = (x.to_bits() >> 52) as i32 - 1023;
    let mantissa = f64::from_bits((x.to_bits() & ((1 << 52) - 1)) | (1023 << 52));
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let square = s * s;
    let series = (0..10)
        .rev()
        .fold(0.0, |sum, k| sum * square + 1.0 / f64::from(2 * k + 1));
    f64::from(exponent) * std::f64::consts::LN_2 + 2.0 * s * series
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithm_agrees_with_the_standard_library() {
        for x in [
            1e-16, 0.001, 0.3, 0.5, 0.999_999, 1.0, 1.999_999, 2.0, 12345.6,
        ] {
            let (found, expected) = (ln(x), x.ln());
            assert!((found - expected).abs() < 1e-10, "{x}: {found} {expected}");
        }
    }

    #[test]
    fn distributions_have_their_moments() {
        let draw = |f: fn(u64, u64, u64) -> f64| -> Vec<f64> {
            (0..100_000).map(|i| f(7, 3, i)).collect()
        };
        let check = |values: &[f64], mean: f64, deviation: f64| {
            let n = values.len() as f64;
            let m = values.iter().sum::<f64>() / n;
            let v = values.iter().map(|x| (x - m) * (x - m)).sum::<f64>() / n;
            assert!(
                (m - mean).abs() < 0.02 && (v.sqrt() - deviation).abs() < 0.02,
                "{m} {}",
                v.sqrt()
            );
        };
        check(&draw(uniform), 0.5, 0.288_675);
        check(&draw(exponential), 1.0, 1.0);
        check(&draw(bell), 0.0, 1.0);
    }
}
