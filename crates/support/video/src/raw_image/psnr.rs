//! Peak signal-to-noise ratio, the measure that the encoder's quality is set in.

use super::RawImage;

/// PSNR of the luma planes in dB, peak 255: `10 log10(255² / mean squared difference)`. Formats may
/// differ. Infinite for equal luma; NaN, which passes no threshold, if the images cannot be
/// compared (sizes differ, or one is malformed).
pub fn psnr(a: &RawImage, b: &RawImage) -> f64 {
    match (a.luma(), b.luma()) {
        (Ok(left), Ok(right)) if (a.width, a.height) == (b.width, b.height) => decibel(left, right),
        _ => f64::NAN,
    }
}

/// As [`psnr`], over the samples of all planes together. NaN also if the formats differ.
pub fn psnr_all(a: &RawImage, b: &RawImage) -> f64 {
    let same = (a.width, a.height, a.format) == (b.width, b.height, b.format);
    if same && a.check().is_ok() && b.check().is_ok() {
        decibel(&a.data, &b.data)
    } else {
        f64::NAN
    }
}

fn decibel(a: &[u8], b: &[u8]) -> f64 {
    let mean = squared_difference(a, b) as f64 / a.len() as f64;
    10.0 * (255.0 * 255.0 / mean).log10()
}

/// Sum of squared differences of two equally long slices.
pub(super) fn squared_difference(a: &[u8], b: &[u8]) -> u64 {
    // 2^16 terms of at most 255² just fit in 32 bits, which is what lets this vectorise.
    const BLOCK: usize = 1 << 16;
    a.chunks(BLOCK)
        .zip(b.chunks(BLOCK))
        .map(|(a, b)| {
            let block: u32 = a
                .iter()
                .zip(b)
                .map(|(&a, &b)| u32::from(a.abs_diff(b)) * u32::from(a.abs_diff(b)))
                .sum();
            u64::from(block)
        })
        .sum()
}
