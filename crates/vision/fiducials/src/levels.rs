//! Gray levels of a tag's black and white in an eye.

use crate::tone::Tone;

/// Gray levels of black and white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Levels {
    pub(crate) black: f64,
    pub(crate) white: f64,
}

impl Levels {
    /// The line through pairs of a share of white and a gray level; `None` if all shares are equal.
    pub(crate) fn fitted(pairs: impl Iterator<Item = (f64, f64)>) -> Option<Self> {
        let (mut n, mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (x, y) in pairs {
            n += 1.0;
            sx += x;
            sy += y;
            sxx += x * x;
            sxy += x * y;
        }
        let spread = n * sxx - sx * sx;
        if spread <= 0.0 {
            return None;
        }
        let slope = (n * sxy - sx * sy) / spread;
        let black = (sy - slope * sx) / n;
        Some(Self {
            black,
            white: black + slope,
        })
    }

    /// White minus black.
    pub(crate) fn contrast(&self) -> f64 {
        self.white - self.black
    }

    /// The tone curve between them, with an exponent.
    pub(crate) fn tone(&self, exponent: f64) -> Tone {
        let ratio = self.black.max(0.0) / self.white.max(1.0);
        Tone::new(exponent, libm::pow(ratio.min(0.9), 1.0 / exponent))
    }
}
