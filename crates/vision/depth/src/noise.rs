//! Estimation and smoothing of image noise.
//!
//! Noise is the response to a mask that cancels surfaces with little curvature: Immerkær's mask
//! ("Fast noise variance estimation", CVIU 1996), whose mean absolute response to noise of standard
//! deviation s is `6 s sqrt(2 / pi)`. Texture adds to the response, so that the estimate is the
//! lower quartile over blocks; one block in four is evaluated. Under- and overexposed blocks do not
//! show the noise and are not counted.

use rayon::prelude::*;

use imaging::ImageView;

/// Side length of a block, px.
const BLOCK_PX: usize = 16;
/// Mean gray levels of evaluated blocks.
const VALID_MEANS: std::ops::Range<u32> = 4..250;

/// Standard deviation of the noise, gray levels; `None` if no block is well exposed.
///
/// ```
/// use depth::{ImageView, noise};
///
/// // A ramp has no noise, a pattern of single pixels is nothing else, and darkness hides it.
/// let ramp: Vec<u8> = (0..96 * 64).map(|i| 60 + (i % 96) as u8).collect();
/// let dots: Vec<u8> = (0..96 * 64).map(|i| 60 + 10 * ((i % 96 + i / 96) % 2) as u8).collect();
/// let dark = vec![0; 96 * 64];
/// assert_eq!(noise::estimate(&ImageView::packed(96, 64, &ramp)?), Some(0.0));
/// assert!(noise::estimate(&ImageView::packed(96, 64, &dots)?).is_some_and(|sigma| sigma > 5.0));
/// assert_eq!(noise::estimate(&ImageView::packed(96, 64, &dark)?), None);
/// # Ok::<(), depth::DepthError>(())
/// ```
pub fn estimate(image: &ImageView<'_>) -> Option<f64> {
    let (width, height) = (image.width(), image.height());
    // Every second block in both directions.
    let columns = width.saturating_sub(2 + BLOCK_PX).div_ceil(2 * BLOCK_PX);
    let rows = height.saturating_sub(2 + BLOCK_PX).div_ceil(2 * BLOCK_PX);
    let block = |k: usize| {
        let (left, top) = (
            2 * (k % columns) * BLOCK_PX + 1,
            2 * (k / columns) * BLOCK_PX + 1,
        );
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
        VALID_MEANS.contains(&(gray / size)).then_some(sum)
    };
    let blocks = (0..columns * rows).into_par_iter();
    let mut sums: Vec<u32> = blocks.filter_map(block).collect();
    sums.sort_unstable();
    let quarter = *sums.get(sums.len() / 4)?;
    let mean = f64::from(quarter) / (BLOCK_PX * BLOCK_PX) as f64;
    Some(mean / 6.0 * (std::f64::consts::PI / 2.0).sqrt())
}

/// Smooths an image with a binomial 3x3 kernel, rounded; the border pixels are repeated.
pub(crate) fn smooth(image: &ImageView<'_>, smoothed: &mut Vec<u8>) {
    let (width, height) = (image.width(), image.height());
    smoothed.resize(width * height, 0);
    let rows = smoothed.par_chunks_exact_mut(width).enumerate();
    rows.for_each_init(
        || vec![0u16; width],
        |column, (y, to)| {
            let near = [y.saturating_sub(1), y, (y + 1).min(height - 1)];
            let [above, here, below] = near.map(|y| image.row(y));
            for x in 0..width {
                let [a, b, c] = [above[x], here[x], below[x]].map(u16::from);
                column[x] = a + 2 * b + c;
            }
            let rounded = |a: u16, b: u16, c: u16| ((a + 2 * b + c + 8) / 16) as u8;
            for (k, three) in column.windows(3).enumerate() {
                to[k + 1] = rounded(three[0], three[1], three[2]);
            }
            let last = width - 1;
            to[0] = rounded(column[0], column[0], column[1.min(last)]);
            to[last] = rounded(column[last.saturating_sub(1)], column[last], column[last]);
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Random;

    /// Constant gray with approximately normal noise of a known standard deviation: the sum of
    /// twelve uniform values.
    fn noisy(random: &mut Random, sigma: f64) -> Vec<u8> {
        let mut normal = || {
            (0..12)
                .map(|_| random.below(1000) as f64 / 1000.0)
                .sum::<f64>()
                - 6.0
        };
        (0..160 * 120)
            .map(|_| (120.0 + sigma * normal()).round() as u8)
            .collect()
    }

    #[test]
    fn noise_of_a_textureless_image_is_estimated() {
        let mut random = Random(7);
        for sigma in [1.0, 2.0, 5.0] {
            let pixels = noisy(&mut random, sigma);
            let found = estimate(&ImageView::packed(160, 120, &pixels).unwrap()).unwrap();
            // The lower quartile is below the mean; rounding to gray levels adds a little.
            assert!((0.85..1.1).contains(&(found / sigma)), "{sigma}: {found}");
        }
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
        let found = estimate(&ImageView::packed(160, 120, &pixels).unwrap()).unwrap();
        assert!(found < 1.3, "{found}");
    }

    #[test]
    fn dark_image_has_no_noise_estimate() {
        let pixels = vec![0; 160 * 120];
        assert_eq!(
            estimate(&ImageView::packed(160, 120, &pixels).unwrap()),
            None
        );
        assert_eq!(
            estimate(&ImageView::packed(4, 4, &pixels[..16]).unwrap()),
            None
        );
    }

    #[test]
    fn smoothing_is_a_binomial_mean() {
        let mut random = Random(9);
        for (width, height) in [(1, 1), (2, 5), (9, 4)] {
            let pixels = random.image(width, height);
            let mut found = Vec::new();
            smooth(
                &ImageView::packed(width, height, &pixels).unwrap(),
                &mut found,
            );
            for y in 0..height as i32 {
                for x in 0..width as i32 {
                    let mut sum = 8;
                    for (dx, dy) in (-1..2).flat_map(|y| (-1..2).map(move |x| (x, y))) {
                        let column = (x + dx).clamp(0, width as i32 - 1);
                        let row = (y + dy).clamp(0, height as i32 - 1);
                        let weight = (2 - dx.abs()) * (2 - dy.abs());
                        sum += weight * i32::from(pixels[row as usize * width + column as usize]);
                    }
                    assert_eq!(i32::from(found[y as usize * width + x as usize]), sum / 16);
                }
            }
        }
    }
}
