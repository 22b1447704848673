//! A drawing of lines, areas and texts, as SVG text or as a PNG.
//!
//! Contract: both show the same. The PNG is rasterized here, with stroked letters, so that it needs
//! neither a font nor a program and has the same bytes on every machine. Coordinates are pixels, x
//! to the right, y down.

use std::fmt::Write as _;

use crate::glyphs;

/// Red, green, blue.
pub(crate) type Color = [u8; 3];

/// Supersampling factor, for antialiasing.
const SUPERSAMPLING: usize = 3;

/// A drawn shape.
#[derive(Clone, Debug)]
enum Shape {
    Area(Vec<[f64; 2]>, Color, f64),
    Line(Vec<[f64; 2]>, Color, f64),
    Text([f64; 2], f64, Color, String),
}

/// Shapes in drawing order.
#[derive(Clone, Debug)]
pub struct Sheet {
    width: usize,
    height: usize,
    shapes: Vec<Shape>,
}

impl Sheet {
    /// An empty white sheet.
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            shapes: Vec::new(),
        }
    }

    /// A filled area; `opacity` from 0 to 1.
    pub(crate) fn area(&mut self, corners: &[[f64; 2]], color: Color, opacity: f64) {
        self.shapes
            .push(Shape::Area(corners.to_vec(), color, opacity));
    }

    /// A line through points.
    pub(crate) fn line(&mut self, points: &[[f64; 2]], color: Color, thick: f64) {
        self.shapes.push(Shape::Line(points.to_vec(), color, thick));
    }

    /// A closed line.
    pub(crate) fn outline(&mut self, corners: &[[f64; 2]], color: Color, thick: f64) {
        let closed: Vec<[f64; 2]> = corners.iter().chain(corners.first()).copied().collect();
        self.line(&closed, color, thick);
    }

    /// A disc.
    pub(crate) fn dot(&mut self, [x, y]: [f64; 2], radius: f64, color: Color) {
        let corner = |i: usize| {
            let angle = i as f64 * std::f64::consts::TAU / 24.0;
            [x + radius * angle.cos(), y + radius * angle.sin()]
        };
        self.area(&(0..24).map(corner).collect::<Vec<_>>(), color, 1.0);
    }

    /// A text whose baseline begins at a point.
    pub(crate) fn text(&mut self, at: [f64; 2], size: f64, color: Color, text: impl Into<String>) {
        self.shapes.push(Shape::Text(at, size, color, text.into()));
    }

    /// Width of a text, pixels.
    pub(crate) fn text_width(text: &str, size: f64) -> f64 {
        0.6 * size * text.chars().count() as f64
    }

    /// As SVG text.
    pub fn svg(&self) -> String {
        let (w, h) = (self.width, self.height);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"DejaVu Sans Mono, monospace\">\n<rect width=\"{w}\" height=\"{h}\" fill=\"#ffffff\"/>\n"
        );
        for shape in &self.shapes {
            let _ = match shape {
                Shape::Area(corners, color, opacity) => writeln!(
                    out,
                    "<polygon points=\"{}\" fill=\"{}\" fill-opacity=\"{opacity}\"/>",
                    points(corners),
                    hex(*color)
                ),
                Shape::Line(line, color, thick) => writeln!(
                    out,
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{thick}\" stroke-linecap=\"round\" stroke-linejoin=\"round\"/>",
                    points(line),
                    hex(*color)
                ),
                // The width is stated, because the font may differ.
                Shape::Text([x, y], size, color, text) => writeln!(
                    out,
                    "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{size}\" textLength=\"{:.1}\" fill=\"{}\">{}</text>",
                    Self::text_width(text, *size),
                    hex(*color),
                    escape(text)
                ),
            };
        }
        out + "</svg>\n"
    }

    /// As PNG.
    ///
    /// # Errors
    /// The PNG encoder fails.
    pub fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.pixels())?;
        writer.finish()?;
        Ok(bytes)
    }

    /// Rows of RGB.
    fn pixels(&self) -> Vec<u8> {
        let mut fine = SupersampledImage {
            width: self.width * SUPERSAMPLING,
            height: self.height * SUPERSAMPLING,
            pixels: vec![[255; 3]; self.width * self.height * SUPERSAMPLING * SUPERSAMPLING],
        };
        for shape in &self.shapes {
            match shape {
                Shape::Area(corners, color, opacity) => fine.area(corners, *color, *opacity),
                Shape::Line(line, color, thick) => fine.line(line, *color, *thick),
                Shape::Text([x, y], size, color, text) => {
                    let (u, v) = (0.1 * size, 0.115 * size);
                    for (i, letter) in text.chars().enumerate() {
                        let left = x + u * (glyphs::ADVANCE * i as f64 + 0.8);
                        for line in glyphs::lines(letter) {
                            let place =
                                |[c, r]: [f64; 2]| [left + u * c, y - v * (r - glyphs::BASE)];
                            let line: Vec<[f64; 2]> = line.into_iter().map(place).collect();
                            fine.line(&line, *color, 0.1 * size);
                        }
                    }
                }
            }
        }
        let mut out = Vec::with_capacity(3 * self.width * self.height);
        for y in 0..self.height {
            for x in 0..self.width {
                let mut sum = [0_usize; 3];
                for row in 0..SUPERSAMPLING {
                    let start = (y * SUPERSAMPLING + row) * fine.width + x * SUPERSAMPLING;
                    for pixel in &fine.pixels[start..start + SUPERSAMPLING] {
                        for (sum, value) in sum.iter_mut().zip(pixel) {
                            *sum += usize::from(*value);
                        }
                    }
                }
                out.extend(sum.map(|v| (v / (SUPERSAMPLING * SUPERSAMPLING)) as u8));
            }
        }
        out
    }
}

/// The supersampled image.
struct SupersampledImage {
    width: usize,
    height: usize,
    pixels: Vec<Color>,
}

impl SupersampledImage {
    /// Fills by the even-odd rule, row by row at pixel centers.
    fn area(&mut self, corners: &[[f64; 2]], color: Color, opacity: f64) {
        let corners: Vec<[f64; 2]> = corners
            .iter()
            .map(|c| c.map(|v| v * SUPERSAMPLING as f64))
            .collect();
        let low = corners.iter().map(|c| c[1]).fold(f64::INFINITY, f64::min);
        let high = corners
            .iter()
            .map(|c| c[1])
            .fold(f64::NEG_INFINITY, f64::max);
        let rows = low.max(0.0) as usize..(high.max(0.0).ceil() as usize).min(self.height);
        for row in rows {
            let y = row as f64 + 0.5;
            let mut crossings: Vec<f64> = Vec::new();
            for (i, a) in corners.iter().enumerate() {
                let b = corners[(i + 1) % corners.len()];
                if (a[1] <= y) != (b[1] <= y) {
                    crossings.push(a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
                }
            }
            crossings.sort_by(f64::total_cmp);
            for pair in crossings.chunks_exact(2) {
                let column = |x: f64| ((x - 0.5).ceil().max(0.0) as usize).min(self.width);
                for x in column(pair[0])..column(pair[1]) {
                    let pixel = &mut self.pixels[row * self.width + x];
                    for (value, new) in pixel.iter_mut().zip(color) {
                        let mixed = f64::from(*value) * (1.0 - opacity) + f64::from(new) * opacity;
                        *value = mixed.round() as u8;
                    }
                }
            }
        }
    }

    /// A line with round caps and joins.
    fn line(&mut self, points: &[[f64; 2]], color: Color, thick: f64) {
        let reach = 0.5 * thick * SUPERSAMPLING as f64;
        for pair in points.windows(2) {
            let [a, b] = [pair[0], pair[1]].map(|p| p.map(|v| v * SUPERSAMPLING as f64));
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            let square = (dx * dx + dy * dy).max(1e-12);
            let range = |axis: usize, size: usize| {
                let low = (a[axis].min(b[axis]) - reach).floor().max(0.0) as usize;
                let high = (a[axis].max(b[axis]) + reach).ceil().max(0.0) as usize;
                low..high.min(size)
            };
            for y in range(1, self.height) {
                for x in range(0, self.width) {
                    let (u, v) = (x as f64 + 0.5 - a[0], y as f64 + 0.5 - a[1]);
                    let t = ((u * dx + v * dy) / square).clamp(0.0, 1.0);
                    let (u, v) = (u - t * dx, v - t * dy);
                    if u * u + v * v <= reach * reach {
                        self.pixels[y * self.width + x] = color;
                    }
                }
            }
        }
    }
}

fn points(points: &[[f64; 2]]) -> String {
    let all: Vec<String> = points
        .iter()
        .map(|[x, y]| format!("{x:.2},{y:.2}"))
        .collect();
    all.join(" ")
}

pub(crate) fn hex([r, g, b]: Color) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace(command_line::output::is_hidden, " ")
}
