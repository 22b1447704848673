//! The smoothing filter of detection.

use imaging::ImageView;

/// An image after the binomial filter 1 4 6 4 1 along both axes (standard deviation 1 pixel), in
/// 1/256 of a grey value: exact integers, so that every implementation gives the same. The last
/// pixel is repeated beyond the edge.
pub(super) struct Smooth {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) values: Vec<u16>,
}

/// 1/256 of a grey value.
pub(super) const UNIT: f32 = 1.0 / 256.0;

impl Smooth {
    pub(super) fn of(image: &ImageView<'_>) -> Self {
        let (width, height) = image.size();
        // Sums along x, one row after the other; then sums of five of these rows.
        let mut along_x = vec![0u16; width * height];
        if width > 0 {
            let mut padded = vec![0u16; width + 4];
            for (y, out) in along_x.chunks_exact_mut(width).enumerate() {
                let row = image.row(y);
                for (to, &from) in padded[2..].iter_mut().zip(row) {
                    *to = u16::from(from);
                }
                padded[..2].fill(u16::from(row[0]));
                padded[width + 2..].fill(u16::from(row[width - 1]));
                let (a, b, c, d, e) = (
                    &padded[..width],
                    &padded[1..width + 1],
                    &padded[2..width + 2],
                    &padded[3..width + 3],
                    &padded[4..],
                );
                for i in 0..width {
                    out[i] = a[i] + e[i] + 4 * (b[i] + d[i]) + 6 * c[i];
                }
            }
        }
        let mut values = vec![0u16; width * height];
        for y in 0..height {
            let row = |dy: isize| {
                let y = y.saturating_add_signed(dy).min(height - 1);
                &along_x[y * width..(y + 1) * width]
            };
            let (a, b, c, d, e) = (row(-2), row(-1), row(0), row(1), row(2));
            let out = &mut values[y * width..(y + 1) * width];
            for i in 0..width {
                out[i] = a[i] + e[i] + 4 * (b[i] + d[i]) + 6 * c[i];
            }
        }
        Self {
            width,
            height,
            values,
        }
    }

    /// Grey value between pixel centres, bilinear; `None` outside.
    pub(super) fn sample(&self, x: f32, y: f32) -> Option<f32> {
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        let (i, j) = (x as usize, y as usize);
        if i + 1 >= self.width || j + 1 >= self.height {
            return None;
        }
        let at = j * self.width + i;
        let p = |i: usize| f32::from(self.values[i]);
        let (u, v) = (x - i as f32, y - j as f32);
        let top = p(at) + u * (p(at + 1) - p(at));
        let bottom = p(at + self.width) + u * (p(at + self.width + 1) - p(at + self.width));
        Some(UNIT * (top + v * (bottom - top)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the definition: a weighted mean of 25 pixels, the last ones repeated beyond the
    /// edge.
    #[test]
    fn smoothing_is_the_binomial() {
        let (width, height, stride) = (13, 9, 17);
        let pixels: Vec<u8> = (0..stride * height)
            .map(|i| (i * i * 31 % 251) as u8)
            .collect();
        let image = ImageView::new(width, height, stride, &pixels).unwrap();
        let smooth = Smooth::of(&image);
        let weights = [1u16, 4, 6, 4, 1];
        for y in 0..height {
            for x in 0..width {
                let mut sum = 0;
                for (j, wy) in weights.iter().enumerate() {
                    for (i, wx) in weights.iter().enumerate() {
                        let x = (x + i).saturating_sub(2).min(width - 1);
                        let y = (y + j).saturating_sub(2).min(height - 1);
                        sum += wx * wy * u16::from(pixels[y * stride + x]);
                    }
                }
                assert_eq!(smooth.values[y * width + x], sum, "({x}, {y})");
            }
        }
    }
}
