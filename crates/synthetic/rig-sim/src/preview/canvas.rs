//! A drawing canvas: images, dots, lines, convex shapes, a few characters.
//!
//! Contract: drawing is clipped to the canvas. Coordinates are pixels, integers being pixel
//! centers, (0, 0) the top left one.

use std::io;
use std::path::Path;

use crate::png_file;

/// Red, green, blue.
pub type Color = [u8; 3];

/// A drawing canvas.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Canvas {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major.
    pub pixels: Vec<Color>,
}

/// Rows of three pixels each, from the top, the highest bit first.
const GLYPHS: [(char, u16); 13] = [
    ('0', 0b111_101_101_101_111),
    ('1', 0b010_110_010_010_111),
    ('2', 0b111_001_111_100_111),
    ('3', 0b111_001_111_001_111),
    ('4', 0b101_101_111_001_001),
    ('5', 0b111_100_111_001_111),
    ('6', 0b111_100_111_101_111),
    ('7', 0b111_001_010_010_010),
    ('8', 0b111_101_111_101_111),
    ('9', 0b111_101_111_001_111),
    ('.', 0b000_000_000_000_010),
    ('s', 0b011_100_010_001_110),
    ('m', 0b000_110_111_101_101),
];

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
                self.set((x + column) as i64, (y + row) as i64, color);
            }
        }
    }

    /// A disc.
    pub fn dot(&mut self, [x, y]: [f64; 2], radius: f64, color: Color) {
        self.cover(
            [x - radius, y - radius],
            [x + radius, y + radius],
            color,
            |u, v| (u - x) * (u - x) + (v - y) * (v - y) <= radius * radius,
        );
    }

    /// A line with round ends.
    pub fn line(&mut self, [a, b]: [[f64; 2]; 2], thick: f64, color: Color) {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let square = (dx * dx + dy * dy).max(1e-12);
        let reach = 0.5 * thick;
        let low = [a[0].min(b[0]) - reach, a[1].min(b[1]) - reach];
        let high = [a[0].max(b[0]) + reach, a[1].max(b[1]) + reach];
        self.cover(low, high, color, |u, v| {
            let along = ((u - a[0]) * dx + (v - a[1]) * dy) / square;
            let t = along.clamp(0.0, 1.0);
            let (du, dv) = (u - a[0] - t * dx, v - a[1] - t * dy);
            du * du + dv * dv <= reach * reach
        });
    }

    /// A convex shape with these corners, in either sense.
    pub fn convex(&mut self, corners: &[[f64; 2]], color: Color) {
        let bound = |pick: fn(f64, f64) -> f64, start: f64| {
            [0, 1].map(|axis| corners.iter().map(|c| c[axis]).fold(start, pick))
        };
        let (low, high) = (
            bound(f64::min, f64::INFINITY),
            bound(f64::max, f64::NEG_INFINITY),
        );
        self.cover(low, high, color, |u, v| {
            let side = |i: usize| {
                let (p, q) = (corners[i], corners[(i + 1) % corners.len()]);
                (q[0] - p[0]) * (v - p[1]) - (q[1] - p[1]) * (u - p[0])
            };
            (0..corners.len()).all(|i| side(i) >= 0.0) || (0..corners.len()).all(|i| side(i) <= 0.0)
        });
    }

    /// Digits, point, `s` and `m`, five squares of `size` px high; others leave a gap.
    pub fn text(&mut self, [x, y]: [usize; 2], size: usize, text: &str, color: Color) {
        for (i, character) in text.chars().enumerate() {
            let glyph = GLYPHS.iter().find(|(c, _)| *c == character);
            let bits = glyph.map_or(0, |(_, bits)| *bits);
            for k in (0..15).filter(|k| bits >> (14 - k) & 1 == 1) {
                let corner = [x + (4 * i + k % 3) * size, y + k / 3 * size];
                self.paste(corner, size, &vec![color; size * size]);
            }
        }
    }

    /// Writes the canvas as PNG.
    ///
    /// # Errors
    /// Any I/O error.
    pub fn save(&self, path: &Path) -> io::Result<()> {
        png_file::rgb8(path, [self.width, self.height], &self.pixels)
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
            let first = low[axis].ceil().max(0.0) as i64;
            first..=high[axis].floor().min(size as f64) as i64
        };
        for y in range(1, self.height) {
            for x in range(0, self.width) {
                if inside(x as f64, y as f64) {
                    self.set(x, y, color);
                }
            }
        }
    }

    fn set(&mut self, x: i64, y: i64, color: Color) {
        let inside = |v: i64, size: usize| usize::try_from(v).ok().filter(|&v| v < size);
        if let (Some(x), Some(y)) = (inside(x, self.width), inside(y, self.height)) {
            self.pixels[y * self.width + x] = color;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(canvas: &Canvas) -> Vec<String> {
        let rows = canvas.pixels.chunks(canvas.width);
        rows.map(|row| {
            row.iter()
                .map(|p| if *p == [0; 3] { '#' } else { '.' })
                .collect()
        })
        .collect()
    }

    #[test]
    fn shapes_cover_pixels_by_their_centers_and_are_clipped() {
        let mut canvas = Canvas::new(7, 5, [255; 3]);
        canvas.convex(&[[3.0, 0.0], [6.0, 3.0], [3.0, 3.0]], [0; 3]);
        canvas.line([[-5.0, 4.0], [1.0, 4.0]], 1.0, [0; 3]);
        canvas.dot([0.0, 0.0], 1.0, [0; 3]);
        assert_eq!(
            drawn(&canvas),
            ["##.#...", "#..##..", "...###.", "...####", "##....."]
        );
    }

    #[test]
    fn digit_glyph_is_drawn() {
        let mut canvas = Canvas::new(8, 5, [255; 3]);
        canvas.text([0, 0], 1, "4.", [0; 3]);
        assert_eq!(
            drawn(&canvas),
            ["#.#.....", "#.#.....", "###.....", "..#.....", "..#..#.."]
        );
    }
}
