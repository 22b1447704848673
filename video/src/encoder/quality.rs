//! From a quality in decibel to a quantiser.
//!
//! H.264 and H.265 quantise transform coefficients with the same step,
//!
//! ```text
//! step = 0.625 · 2^(QP/6)
//! ```
//!
//! (H.264: table 8-15 and clause 8.5; H.265: clause 8.6, step = 2^((QP-4)/6), the same within 1 %).
//! The transforms are orthonormal up to scaling, so an error of a coefficient is an error of the picture, and
//! rounding to a multiple of `step` leaves, if values are spread evenly over a step, a mean square
//! error of `step²/12`. Hence
//!
//! ```text
//! PSNR = 10 log10(255² · 12 / step²)        QP = 6 log2(255 · sqrt(12) / (0.625 · 10^(PSNR/20)))
//! ```
//!
//! Two things pull away from this. Encoders round towards zero (a dead zone), which costs up to 3.7 dB;
//! and coefficients smaller than that become zero, which costs less than `step²/12` each, so that easy pictures end
//! up better than asked for. `gain_db` of the encoder's row is what remains on hard material.

use super::kinds::Kind;

/// The constant quantiser that gives at least about `quality_db` of luma PSNR.
pub(crate) fn quantiser(kind: &Kind, quality_db: f64) -> u32 {
    let step = 255.0 * 12f64.sqrt() / 10f64.powf((quality_db - kind.gain_db) / 20.0);
    let qp = 6.0 * (step / 0.625).log2();
    // 0 is lossless in x264, which asks for a profile that hardware decoders lack; 50 is the
    // largest that every encoder takes. Rounding down rounds towards better pictures.
    qp.floor().clamp(1.0, 50.0) as u32
}
