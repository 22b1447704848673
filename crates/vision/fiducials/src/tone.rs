//! The tone curve between black and white.

use crate::batch::{BATCH, Lane};

/// Entries of the table, a power of two.
const ENTRIES: usize = 32;

/// Gray level as a share of the contrast between black and white, by light as such a share: gray
/// levels are a power of light, and black is not without light.
#[derive(Clone, Debug)]
pub(crate) struct Tone {
    table: [f32; ENTRIES + 1],
}

impl Tone {
    /// A curve with an exponent, and light of black relative to white.
    pub(crate) fn new(exponent: f64, black: f64) -> Self {
        let lowest = libm::pow(black, exponent);
        let light = |k: usize| k as f64 / ENTRIES as f64;
        let power = |v: f64| f64::from(libm::powf(v as f32, exponent as f32));
        let share = |k: usize| (power(black + (1.0 - black) * light(k)) - lowest) / (1.0 - lowest);
        Self {
            table: std::array::from_fn(|k| share(k) as f32),
        }
    }

    /// Gray level and its derivative, at a share of the light.
    pub(crate) fn at(&self, light: f32) -> (f32, f32) {
        let place = light.clamp(0.0, 1.0) * ENTRIES as f32;
        let k = (place as usize).min(ENTRIES - 1);
        let (a, b) = (self.table[k], self.table[k + 1]);
        (a + (b - a) * (place - k as f32), (b - a) * ENTRIES as f32)
    }
}

/// Two curves that are read at the same places.
#[derive(Clone, Debug)]
pub(crate) struct TonePair {
    /// Gray level at the begin of an interval and its change to the end: of the first curve, then
    /// of the second.
    table: [[f32; 4]; ENTRIES],
}

impl TonePair {
    pub(crate) fn new(first: &Tone, second: &Tone) -> Self {
        let of = |tone: &Tone, k: usize| [tone.table[k], tone.table[k + 1] - tone.table[k]];
        Self {
            table: std::array::from_fn(|k| {
                let ([a, b], [c, d]) = (of(first, k), of(second, k));
                [a, b, c, d]
            }),
        }
    }

    /// Gray levels and their derivatives by the first curve, and gray levels by the second one, at
    /// shares of the light.
    #[inline(always)]
    pub(crate) fn at(&self, light: &Lane, [levels, slopes, others]: [&mut Lane; 3]) {
        let (mut index, mut share) = ([0_i32; BATCH], [0.0_f32; BATCH]);
        for k in 0..BATCH {
            let place = light[k].clamp(0.0, 1.0) * ENTRIES as f32;
            let begin = (place as i32).min(ENTRIES as i32 - 1);
            share[k] = place - begin as f32;
            index[k] = begin;
        }
        for k in 0..BATCH {
            let [a, by, other, other_by] = self.table[index[k] as usize & (ENTRIES - 1)];
            levels[k] = a + by * share[k];
            slopes[k] = by * ENTRIES as f32;
            others[k] = other + other_by * share[k];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_goes_from_black_to_white() {
        for (exponent, black) in [(0.45, 0.04), (1.0, 0.1), (0.45, 0.0)] {
            let tone = Tone::new(exponent, black);
            assert!(tone.at(0.0).0.abs() < 1e-6);
            assert!((tone.at(1.0).0 - 1.0).abs() < 1e-6);
            assert!(tone.at(0.5).0 >= 0.5 - 1e-6);
        }
        let linear = Tone::new(1.0, 0.1);
        assert!((linear.at(0.3).0 - 0.3).abs() < 1e-6);
        assert!((linear.at(0.3).1 - 1.0).abs() < 1e-5);
    }
}
