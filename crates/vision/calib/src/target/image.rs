//! Images for detection, and the smoothing filter.

/// A borrowed 8-bit image of one channel. Integer coordinates are pixel centres.
#[derive(Clone, Copy, Debug)]
pub struct ImageView<'a> {
    width: usize,
    height: usize,
    stride: usize,
    pixels: &'a [u8],
}

impl<'a> ImageView<'a> {
    /// Rows of `width` pixels that begin `stride` bytes apart; `None` if `pixels` is too short.
    pub fn new(width: usize, height: usize, stride: usize, pixels: &'a [u8]) -> Option<Self> {
        let needed = match height {
            0 => 0,
            _ => stride.checked_mul(height - 1)?.checked_add(width)?,
        };
        (stride >= width && pixels.len() >= needed).then_some(Self {
            width,
            height,
            stride,
            pixels,
        })
    }

    /// Pixels along x.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels along y.
    pub fn height(&self) -> usize {
        self.height
    }

    pub(super) fn row(&self, y: usize) -> &'a [u8] {
        &self.pixels[y * self.stride..y * self.stride + self.width]
    }

    /// Grey value between pixel centres, bilinear; `None` outside.
    pub(super) fn sample(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let (x, y) = (x as f32, y as f32);
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        let (i, j) = (x as usize, y as usize);
        if i + 1 >= self.width || j + 1 >= self.height {
            return None;
        }
        let at = j * self.stride + i;
        let below = at + self.stride;
        let p = |i: usize| f32::from(self.pixels[i]);
        let (u, v) = (x - i as f32, y - j as f32);
        let top = p(at) + u * (p(at + 1) - p(at));
        let bottom = p(below) + u * (p(below + 1) - p(below));
        Some(f64::from(top + v * (bottom - top)))
    }

    /// The image at half the size: means of 2 x 2 pixels, rounded. Pixel (x, y) of the result is at
    /// (2 x + 0.5, 2 y + 0.5) of this image.
    pub(super) fn halved(&self) -> Vec<u8> {
        let mut half = Vec::with_capacity(self.width / 2 * (self.height / 2));
        for y in 0..self.height / 2 {
            let (a, b) = (self.row(2 * y), self.row(2 * y + 1));
            half.extend(a.chunks_exact(2).zip(b.chunks_exact(2)).map(|(a, b)| {
                let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
                ((sum + 2) / 4) as u8
            }));
        }
        half
    }
}

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
        let (width, height) = (image.width, image.height);
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

    #[test]
    fn a_view_has_all_its_rows() {
        let pixels = [0; 10];
        assert!(ImageView::new(4, 2, 6, &pixels).is_some());
        assert!(ImageView::new(5, 2, 6, &pixels).is_none());
        assert!(ImageView::new(7, 1, 6, &pixels).is_none());
        assert!(ImageView::new(0, 0, 0, &[]).is_some());
    }

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
