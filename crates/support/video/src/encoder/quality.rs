//! From a quality in decibel to a quantiser.
//!
//! H.264 and H.265 quantise transform coefficients with the same step,
//!
//! ```text
//! step = 0.625 · 2^(QP/6)
//! ```
//!
//! (H.264: table 8-15 and clause 8.5; H.265: clause 8.6, step = 2^((QP-4)/6), the same within 1
//! %). The transforms are orthonormal up to scaling, so an error of a coefficient is an error of
//! the frame, and rounding to a multiple of `step` leaves, if values are spread evenly over a
//! step, a mean square error of `step²/12`. Hence
//!
//! ```text
//! PSNR = 10 log10(255² · 12 / step²)        QP = 6 log2(255 · sqrt(12) / (0.625 · 10^(PSNR/20)))
//! ```
//!
//! Two effects deviate from this. Encoders round towards zero (a dead zone), which costs up to 3.7
//! dB where every coefficient counts; and coefficients smaller than that become zero, which costs
//! less than `step²/12` each, so that easy frames end up better than requested. What remains on
//! real, detailed frames (KITTI, measured by `cargo run -p video --example quality`) is `gain_db`
//! of the encoder's row, and for those the quality holds: synthetic 1/f texture with noise comes
//! out about 1.5 dB lower, smooth or still scenes higher.

use super::Preset;
use super::kinds::Kind;

/// The constant quantiser for `quality_db` of luma PSNR on real, detailed frames.
pub(crate) fn quantiser(kind: &Kind, preset: Preset, quality_db: f64) -> u32 {
    let gain_db = kind.gain_db.unwrap_or_else(|| preset.gain_db());
    let step = 255.0 * 12f64.sqrt() / 10f64.powf((quality_db - gain_db) / 20.0);
    let qp = 6.0 * (step / 0.625).log2();
    // 0 is lossless in x264, which asks for a profile that hardware decoders lack; 50 is the
    // largest that every encoder takes. Rounding down rounds towards better frames.
    qp.floor().clamp(1.0, 50.0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encoder::kinds::KINDS;

    #[test]
    fn six_decibel_are_six_steps() {
        for kind in KINDS {
            let at = |quality| quantiser(kind, Preset::Ultrafast, quality);
            assert_eq!(
                at(36.0) - at(36.0 + 20.0 * 2f64.log10()),
                6,
                "{}",
                kind.element
            );
            assert!((20..60).all(|quality| at(f64::from(quality)) >= at(f64::from(quality) + 1.0)));
            assert_eq!(at(60.0), at(60.0).clamp(1, 50), "{}", kind.element);
            assert_eq!(at(20.0), at(20.0).clamp(1, 50), "{}", kind.element);
        }
    }

    #[test]
    fn theory_at_a_known_point() {
        // QP 16 is a step of 0.625 · 2^(16/6) = 3.97 (the standards' own tables say 4), so a mean
        // square error of 1.312, so 46.95 dB.
        let kind = Kind {
            gain_db: Some(0.0),
            properties: &[],
            ..KINDS[0]
        };
        assert_eq!(
            (
                quantiser(&kind, Preset::Ultrafast, 46.9),
                quantiser(&kind, Preset::Ultrafast, 47.0),
            ),
            (16, 15)
        );
    }
}
