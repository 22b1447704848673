//! Smoothing of noisy images, in proportion to their noise.

use rayon::prelude::*;

use imaging::ImageView;

/// Weight of the whole kernel along one axis.
const WHOLE: u32 = 64;

/// Smooths an image with the kernel `a, 1 - 2a, a` along both axes, rounded; the border pixels are
/// repeated. `strength` is from 0 (`a` is 0: no change) to 1 (`a` is 1/4: binomial), in steps of
/// 1/16.
pub(crate) fn smooth(image: &ImageView<'_>, strength: f64, smoothed: &mut Vec<u8>) {
    let (width, height) = (image.width(), image.height());
    let side = (strength.clamp(0.0, 1.0) * f64::from(WHOLE / 4)).round() as u32;
    let middle = WHOLE - 2 * side;
    smoothed.resize(width * height, 0);
    let rows = smoothed.par_chunks_exact_mut(width).enumerate();
    rows.for_each_init(
        || vec![0_u32; width],
        |column, (y, to)| {
            let near = [y.saturating_sub(1), y, (y + 1).min(height - 1)];
            let [above, here, below] = near.map(|y| image.row(y));
            for x in 0..width {
                let [a, b, c] = [above[x], here[x], below[x]].map(u32::from);
                column[x] = side * (a + c) + middle * b;
            }
            let half = WHOLE * WHOLE / 2;
            let rounded = |a: u32, b: u32, c: u32| {
                ((side * (a + c) + middle * b + half) / (WHOLE * WHOLE)) as u8
            };
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

    #[test]
    fn smoothing_is_a_weighted_mean() {
        let mut random = Random(9);
        for (width, height) in [(1, 1), (2, 5), (9, 4)] {
            let pixels = random.image(width, height);
            let image = ImageView::packed(width, height, &pixels).unwrap();
            for side in [0, 4, 16] {
                let mut found = Vec::new();
                smooth(&image, f64::from(side) / 16.0, &mut found);
                for y in 0..height as i32 {
                    for x in 0..width as i32 {
                        let mut sum = 64 * 64 / 2;
                        for (dx, dy) in (-1..2).flat_map(|y| (-1..2).map(move |x| (x, y))) {
                            let column = (x + dx).clamp(0, width as i32 - 1);
                            let row = (y + dy).clamp(0, height as i32 - 1);
                            let weight = |off: i32| if off == 0 { 64 - 2 * side } else { side };
                            let pixel = pixels[row as usize * width + column as usize];
                            sum += weight(dx) * weight(dy) * i32::from(pixel);
                        }
                        let at = y as usize * width + x as usize;
                        assert_eq!(i32::from(found[at]), sum / (64 * 64));
                        assert!(side > 0 || found[at] == pixels[at]);
                    }
                }
            }
        }
    }
}
