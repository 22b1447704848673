//! Noise of an image pair, apart from its texture.
//!
//! Two estimates are made for each block, and both are upper limits: the smaller one counts.
//! Immerkær's mask ("Fast noise variance estimation", CVIU 1996) cancels surfaces with little
//! curvature, and its mean absolute response to noise of standard deviation s is
//! `6 s sqrt(2 / pi)`; fine texture adds to it. The second estimate is what the right image does
//! not predict: texture is in both images, noise is not. A match at another
//! depth or an occlusion adds to it.
//!
//! The noise of the pair is the lower quartile over blocks. Under- and overexposed blocks do not
//! show the noise and are not counted.

use crate::band::Band;
use crate::prediction::{BLOCK_PX, Block, predict};
use imaging::ImageView;

/// Mean gray levels of evaluated blocks.
const VALID_MEANS: std::ops::Range<u32> = 4..250;

/// Standard deviation of the noise, gray levels; `None` if no block is well exposed. Both images
/// have the same size; matches are searched within the band.
///
/// ```
/// use depth::{Band, ImageView, noise};
///
/// // A ramp has no noise, a pattern of single pixels that only one eye shows is nothing else, and
/// // darkness hides it.
/// let ramp: Vec<u8> = (0..96 * 64).map(|i| 60 + (i % 96) as u8).collect();
/// let dots: Vec<u8> = (0..96 * 64).map(|i| 60 + 10 * ((i % 96 + i / 96) % 2) as u8).collect();
/// let dark = vec![0; 96 * 64];
/// let [ramp, dots, dark] = [&ramp, &dots, &dark].map(|pixels| ImageView::packed(96, 64, pixels));
/// let (ramp, dots, dark) = (ramp?, dots?, dark?);
/// let band = Band::full(0, 16, 64)?;
/// assert_eq!(noise::estimate(&ramp, &ramp, &band), Some(0.0));
/// assert!(noise::estimate(&dots, &ramp, &band).is_some_and(|sigma| sigma > 3.0));
/// assert!(noise::estimate(&dots, &dots, &band).is_some_and(|sigma| sigma < 1.0));
/// assert_eq!(noise::estimate(&dark, &dark, &band), None);
/// # Ok::<(), depth::DepthError>(())
/// ```
pub fn estimate(left: &ImageView<'_>, right: &ImageView<'_>, band: &Band) -> Option<f64> {
    let noise = |block: &Block| {
        let by_mask = mask_response(left, block.corner)?;
        let by_prediction = block.prediction.map_or(f64::INFINITY, |found| found.noise);
        Some(by_mask.min(by_prediction))
    };
    let blocks = predict(left, right, band, 2);
    let mut found: Vec<f64> = blocks.iter().filter_map(noise).collect();
    found.sort_unstable_by(f64::total_cmp);
    found.get(found.len() / 4).copied()
}

/// Noise of a block by the mask; `None` if the block is not well exposed.
fn mask_response(image: &ImageView<'_>, [left, top]: [usize; 2]) -> Option<f64> {
    let (mut sum, mut gray) = (0, 0);
    for y in top..top + BLOCK_PX {
        let near = [y - 1, y, y + 1].map(|y| &image.row(y)[left - 1..left + BLOCK_PX + 1]);
        for x in 1..=BLOCK_PX {
            let second = |row: &[u8]| {
                let [a, b, c] = [row[x - 1], row[x], row[x + 1]].map(i32::from);
                a - 2 * b + c
            };
            let [above, here, below] = near.map(second);
            sum += (above - 2 * here + below).unsigned_abs();
            gray += u32::from(near[1][x]);
        }
    }
    let size = (BLOCK_PX * BLOCK_PX) as u32;
    let mean = f64::from(sum) / f64::from(size);
    let is_exposed = VALID_MEANS.contains(&(gray / size));
    is_exposed.then(|| mean / 6.0 * (std::f64::consts::PI / 2.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Random;

    const SIZE: [usize; 2] = [160, 120];

    /// Approximately normal noise: the sum of twelve uniform values.
    fn normal(random: &mut Random) -> f64 {
        (0..12)
            .map(|_| random.below(1000) as f64 / 1000.0)
            .sum::<f64>()
            - 6.0
    }

    /// Constant gray with noise of a known standard deviation.
    fn noisy(random: &mut Random, sigma: f64) -> Vec<u8> {
        let pixel = |_| (120.0 + sigma * normal(random)).round() as u8;
        (0..SIZE[0] * SIZE[1]).map(pixel).collect()
    }

    fn found(left: &[u8], right: &[u8]) -> Option<f64> {
        let [left, right] =
            [left, right].map(|eye| ImageView::packed(SIZE[0], SIZE[1], eye).unwrap());
        estimate(&left, &right, &Band::full(0, 32, SIZE[1]).unwrap())
    }

    /// Two images of a texture whose cells are a pixel wide, on a surface at subpixel disparities;
    /// the second has another gain, and both have noise.
    fn fine_pair(random: &mut Random, sigma: f64) -> [Vec<u8>; 2] {
        const FINE: usize = 4;
        let columns = SIZE[0] + 40;
        let cells: Vec<f64> = (0..columns * SIZE[1])
            .map(|_| 100.0 + random.below(30) as f64)
            .collect();
        let [mut left, mut right] = [Vec::new(), Vec::new()];
        for y in 0..SIZE[1] {
            for x in 0..SIZE[0] {
                // Mean over the area of a pixel, from a quarter of a pixel on.
                let area = |from: usize| {
                    let parts = (from..from + FINE).map(|k| cells[y * columns + x + k / FINE]);
                    parts.sum::<f64>() / FINE as f64
                };
                left.push((area(0) + sigma * normal(random)).round() as u8);
                // A quarter of a pixel more every ten rows.
                right.push((0.95 * area(37 + y / 10) + sigma * normal(random)).round() as u8);
            }
        }
        [left, right]
    }

    #[test]
    fn noise_of_a_textureless_image_is_estimated() {
        let mut random = Random(7);
        for sigma in [1.0, 2.0, 5.0] {
            let eyes = [0, 1].map(|_| noisy(&mut random, sigma));
            let found = found(&eyes[0], &eyes[1]).unwrap();
            // The lower quartile is below the mean; rounding to gray levels adds a little.
            assert!((0.75..1.1).contains(&(found / sigma)), "{sigma}: {found}");
        }
    }

    #[test]
    fn fine_texture_is_no_noise() {
        let mut random = Random(10);
        let [left, right] = fine_pair(&mut random, 0.0);
        let alone = mask_response(
            &ImageView::packed(SIZE[0], SIZE[1], &left).unwrap(),
            [49, 49],
        );
        assert!(alone.unwrap() > 5.0, "{alone:?}");
        let clean = found(&left, &right).unwrap();
        assert!(clean < 1.0, "{clean}");
        let [left, right] = fine_pair(&mut random, 3.0);
        let noisy = found(&left, &right).unwrap();
        assert!((2.2..3.6).contains(&noisy), "{noisy}");
    }

    #[test]
    fn texture_in_a_part_of_the_image_does_not_count_as_noise() {
        let mut random = Random(8);
        let mut pixels = noisy(&mut random, 1.0);
        for (i, pixel) in pixels.iter_mut().enumerate() {
            if i % 160 < 90 {
                *pixel = if (i % 160 / 3 + i / 480) % 2 == 0 {
                    60
                } else {
                    200
                };
            }
        }
        let found = found(&pixels, &noisy(&mut random, 1.0)).unwrap();
        assert!(found < 1.3, "{found}");
    }

    #[test]
    fn dark_or_small_image_has_no_noise_estimate() {
        let pixels = vec![0; SIZE[0] * SIZE[1]];
        assert_eq!(found(&pixels, &pixels), None);
        let small = ImageView::packed(4, 4, &pixels[..16]).unwrap();
        assert_eq!(
            estimate(&small, &small, &Band::full(0, 8, 4).unwrap()),
            None
        );
    }
}
