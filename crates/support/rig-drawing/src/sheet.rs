//! A drawing of lines, areas and texts, as SVG text or as a PNG.
//!
//! Contract: both show the same. The PNG is rasterized with stroked letters, so that it needs
//! neither a font nor a program and has the same bytes on every machine. Coordinates are pixels, x
//! to the right, y down.

use std::fmt::Write as _;

use raster::{Canvas, Color, Compression, EncodingError, strokes};

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
                    strokes::width(text, *size),
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
    pub fn png(&self) -> Result<Vec<u8>, EncodingError> {
        self.raster().png(Compression::default())
    }

    /// The rasterized sheet.
    fn raster(&self) -> Canvas {
        let [width, height] = [self.width, self.height].map(|size| size * SUPERSAMPLING);
        let mut fine = Canvas::new(width, height, [255; 3]);
        let factor = SUPERSAMPLING as f64;
        // The sheet's coordinates begin at the corner of its first pixel, those of the canvas at
        // its center.
        let to_fine = |points: &[[f64; 2]]| -> Vec<[f64; 2]> {
            let scaled = points.iter().map(|p| p.map(|v| v * factor - 0.5));
            scaled.collect()
        };
        for shape in &self.shapes {
            match shape {
                Shape::Area(corners, color, opacity) => {
                    fine.polygon(&to_fine(corners), *color, *opacity);
                }
                Shape::Line(line, color, thick) => {
                    fine.line(&to_fine(line), thick * factor, *color);
                }
                Shape::Text(at, size, color, text) => {
                    let thick = strokes::THICKNESS * size * factor;
                    for line in strokes::text(*at, *size, text) {
                        fine.line(&to_fine(&line), thick, *color);
                    }
                }
            }
        }
        fine.downsampled(SUPERSAMPLING)
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
