//! A canvas of RGB pixels.
//!
//! Contract: drawing is clipped to the canvas. Coordinates are pixels, integers being pixel
//! centers, (0, 0) the top left one. A shape colors the pixels whose centers are inside; for
//! antialiasing draw at a multiple of the size and use [`Canvas::downsampled`]. The same calls give
//! the same pixels on every machine.

use crate::dot_matrix;

/// Red, green, blue.
pub type Color = [u8; 3];

/// A canvas of RGB pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Canvas {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major.
    pub pixels: Vec<Color>,
}

impl Canvas {
    /// A canvas of one color.
    pub fn new(width: usize, height: usize, color: Color) -> Self {
        Self {
            width,
            height,
            pixels: vec![color; width * height],
        }
    }

    /// Copies an image with rows of `width` pixels to a position.
    pub fn paste(&mut self, [x, y]: [usize; 2], width: usize, pixels: &[Color]) {
        for (row, line) in pixels.chunks_exact(width).enumerate() {
            for (column, &color) in line.iter().enumerate() {
                self.set(x + column, y + row, color);
            }
        }
    }

    /// A disc.
    pub fn disc(&mut self, [x, y]: [f64; 2], radius: f64, color: Color) {
        self.cover(
            [x - radius, y - radius],
            [x + radius, y + radius],
            color,
            |u, v| (u - x) * (u - x) + (v - y) * (v - y) <= radius * radius,
        );
    }

    /// A line through points, with round caps and joins; `thick` px wide.
    pub fn line(&mut self, points: &[[f64; 2]], thick: f64, color: Color) {
        let reach = 0.5 * thick;
        for pair in points.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            let square = (dx * dx + dy * dy).max(1e-12);
            let low = [0, 1].map(|axis| a[axis].min(b[axis]) - reach);
            let high = [0, 1].map(|axis| a[axis].max(b[axis]) + reach);
            self.cover(low, high, color, |x, y| {
                let (u, v) = (x - a[0], y - a[1]);
                let t = ((u * dx + v * dy) / square).clamp(0.0, 1.0);
                let (u, v) = (u - t * dx, v - t * dy);
                u * u + v * v <= reach * reach
            });
        }
    }

    /// A convex polygon with these corners, in either sense; pixels on its edges are inside.
    pub fn convex(&mut self, corners: &[[f64; 2]], color: Color) {
        let bound = |pick: fn(f64, f64) -> f64, start: f64| {
            [0, 1].map(|axis| corners.iter().map(|c| c[axis]).fold(start, pick))
        };
        let (low, high) = (
            bound(f64::min, f64::INFINITY),
            bound(f64::max, f64::NEG_INFINITY),
        );
        self.cover(low, high, color, |x, y| {
            let side = |i: usize| {
                let (p, q) = (corners[i], corners[(i + 1) % corners.len()]);
                (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
            };
            (0..corners.len()).all(|i| side(i) >= 0.0) || (0..corners.len()).all(|i| side(i) <= 0.0)
        });
    }

    /// A polygon filled by the even-odd rule; `opacity` from 0 to 1. Polygons with a common edge
    /// share no pixel.
    pub fn polygon(&mut self, corners: &[[f64; 2]], color: Color, opacity: f64) {
        let low = corners.iter().map(|c| c[1]).fold(f64::INFINITY, f64::min);
        let high = corners
            .iter()
            .map(|c| c[1])
            .fold(f64::NEG_INFINITY, f64::max);
        let first_at = |at: f64, size: usize| (at.ceil().max(0.0) as usize).min(size);
        for row in first_at(low, self.height)..first_at(high, self.height) {
            let y = row as f64;
            let mut crossings: Vec<f64> = Vec::new();
            for (i, a) in corners.iter().enumerate() {
                let b = corners[(i + 1) % corners.len()];
                if (a[1] <= y) != (b[1] <= y) {
                    crossings.push(a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
                }
            }
            crossings.sort_by(f64::total_cmp);
            for pair in crossings.chunks_exact(2) {
                for x in first_at(pair[0], self.width)..first_at(pair[1], self.width) {
                    let pixel = &mut self.pixels[row * self.width + x];
                    for (value, new) in pixel.iter_mut().zip(color) {
                        let mixed = f64::from(*value) * (1.0 - opacity) + f64::from(new) * opacity;
                        *value = mixed.round() as u8;
                    }
                }
            }
        }
    }

    /// Digits, point, `s` and `m`, five squares of `size` px high; others leave a gap.
    pub fn text(&mut self, [x, y]: [usize; 2], size: usize, text: &str, color: Color) {
        let square = vec![color; size * size];
        for (i, character) in text.chars().enumerate() {
            for [column, row] in dot_matrix::dots(character) {
                let left = x + (dot_matrix::ADVANCE * i + column) * size;
                self.paste([left, y + row * size], size, &square);
            }
        }
    }

    /// Mean of each block of `factor` x `factor` pixels; the last columns and rows that fill no
    /// block are dropped.
    ///
    /// # Panics
    /// `factor` is 0.
    #[must_use]
    pub fn downsampled(&self, factor: usize) -> Self {
        let (width, height) = (self.width / factor, self.height / factor);
        let mut pixels = Vec::with_capacity(width * height);
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let mut sum = [0_usize; 3];
            for row in 0..factor {
                let start = (y * factor + row) * self.width + x * factor;
                for pixel in &self.pixels[start..start + factor] {
                    for (sum, value) in sum.iter_mut().zip(pixel) {
                        *sum += usize::from(*value);
                    }
                }
            }
            pixels.push(sum.map(|v| (v / (factor * factor)) as u8));
        }
        Self {
            width,
            height,
            pixels,
        }
    }

    /// The bytes of a PNG file.
    ///
    /// # Errors
    /// The canvas is empty or its size is beyond the format.
    pub fn png(&self, compression: png::Compression) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(compression);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        writer.finish()?;
        Ok(bytes)
    }

    /// Colors the pixels of a rectangle whose centers are inside the shape.
    fn cover(
        &mut self,
        low: [f64; 2],
        high: [f64; 2],
        color: Color,
        inside: impl Fn(f64, f64) -> bool,
    ) {
        let range = |axis: usize, size: usize| {
            let end = (high[axis].floor() + 1.0).max(0.0) as usize;
            (low[axis].ceil().max(0.0) as usize)..end.min(size)
        };
        for y in range(1, self.height) {
            for x in range(0, self.width) {
                if inside(x as f64, y as f64) {
                    self.pixels[y * self.width + x] = color;
                }
            }
        }
    }

    fn set(&mut self, x: usize, y: usize, color: Color) {
        if x < self.width && y < self.height {
            self.pixels[y * self.width + x] = color;
        }
    }
}

#[cfg(test)]
mod tests;
