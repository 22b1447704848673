//! Gray levels of a tag's black and white in an eye.

use crate::tone::Tone;

/// Gray levels of black and white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Levels {
    pub(crate) black: f64,
    pub(crate) white: f64,
}

impl Levels {
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
