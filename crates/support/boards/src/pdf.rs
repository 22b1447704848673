//! A board as a PDF page at its true size.
//!
//! Contract: one page, the pattern as one filled path (no seams between its cells), lengths exact
//! to 0.001 mm. Two rulers of 100 mm, one along each axis, show after printing whether the printer
//! kept the size. The same board and paper give the same bytes. A board that does not fit is an
//! error that states the available room.
//!
//! The subset of PDF 1.4 (ISO 32000-1) used: one page, one stream without compression, one of the
//! 14 fonts that every reader has.

use std::fmt::Write as _;

use crate::board::Target;

/// Strip at the left and the bottom for rulers and text, mm.
const STRIP_MM: f64 = 14.0;
/// PDF's unit per millimetre.
const POINTS: f64 = 72.0 / 25.4;

/// A sheet of paper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paper {
    /// Millimetres.
    pub width_mm: f64,
    /// Millimetres.
    pub height_mm: f64,
}

/// Names that [`Paper::parse`] knows, with width and height in millimetres (ISO 216; ANSI).
const SHEETS: [(&str, f64, f64); 6] = [
    ("A4", 210.0, 297.0),
    ("A3", 297.0, 420.0),
    ("A2", 420.0, 594.0),
    ("A1", 594.0, 841.0),
    ("A0", 841.0, 1189.0),
    ("Letter", 215.9, 279.4),
];

impl Paper {
    /// Parses `A4` to `A0`, `Letter`, or `WIDTHxHEIGHT` in millimetres. `None` for anything else.
    pub fn parse(text: &str) -> Option<Self> {
        if let Some((_, width_mm, height_mm)) = SHEETS
            .iter()
            .find(|(name, ..)| name.eq_ignore_ascii_case(text))
        {
            return Some(Self {
                width_mm: *width_mm,
                height_mm: *height_mm,
            });
        }
        let (width, height) = text.split_once(['x', 'X'])?;
        let side = |text: &str| {
            text.parse::<f64>()
                .ok()
                .filter(|v| (50.0..=5000.0).contains(v))
        };
        Some(Self {
            width_mm: side(width)?,
            height_mm: side(height)?,
        })
    }

    /// The same sheet rotated by 90 degrees.
    pub fn rotated(self) -> Self {
        Self {
            width_mm: self.height_mm,
            height_mm: self.width_mm,
        }
    }

    /// Room for a board with its white margin, mm.
    pub fn room_mm(&self) -> [f64; 2] {
        [self.width_mm - STRIP_MM, self.height_mm - STRIP_MM]
    }

    /// Whether a board with its white margin fits.
    pub fn fits(&self, target: &Target) -> bool {
        let (size, room) = (target.sheet_m().size_m(), self.room_mm());
        (0..2).all(|k| 1000.0 * size[k] <= room[k] + 1e-9)
    }
}

/// Reasons for a missing page.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PdfError {
    /// The board itself is invalid: correct the key.
    #[error("drawing a board: {key} is {found}")]
    Board {
        /// The key of the board's file.
        key: &'static str,
        /// What was found and what was expected.
        found: String,
    },
    /// It is larger than the paper: take larger paper, or smaller squares.
    #[error(
        "drawing a board: with its white margin it is {:.0} x {:.0} mm, but the paper has room for {:.0} x {:.0} mm beside the rulers",
        size_mm[0], size_mm[1], room_mm[0], room_mm[1]
    )]
    TooLarge {
        /// Board with margin, mm.
        size_mm: [f64; 2],
        /// Room on the paper, mm.
        room_mm: [f64; 2],
    },
}

/// The page, as the bytes of a PDF file.
///
/// # Errors
/// [`PdfError`].
///
/// ```
/// use boards::Target;
/// use boards::pdf::{Paper, draw};
///
/// let board = Target::Chessboard { columns: 7, rows: 4, square_m: 0.03 };
/// let paper = Paper::parse("A4").ok_or("no paper")?.rotated();
/// assert!(paper.fits(&board));
/// let page = draw(&board, paper)?;
/// assert!(page.starts_with(b"%PDF-1.4"));
/// assert_eq!(page, draw(&board, paper)?);
///
/// // Squares of 6 cm need a larger sheet.
/// let large = Target::Chessboard { columns: 7, rows: 4, square_m: 0.06 };
/// assert!(draw(&large, paper).unwrap_err().to_string().contains("the paper has room for"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn draw(target: &Target, paper: Paper) -> Result<Vec<u8>, PdfError> {
    if let Some((key, found)) = target.invalid_reason() {
        return Err(PdfError::Board { key, found });
    }
    let sheet = target.sheet_m();
    let size_mm = sheet.size_m().map(|v| 1000.0 * v);
    let room_mm = paper.room_mm();
    if !paper.fits(target) {
        return Err(PdfError::TooLarge { size_mm, room_mm });
    }
    // Position of the board's origin on the page, mm from the page's top left: centred in the room.
    let corner = [
        STRIP_MM + 0.5 * (room_mm[0] - size_mm[0]),
        0.5 * (room_mm[1] - size_mm[1]),
    ];
    let origin = [0, 1].map(|k| corner[k] - 1000.0 * sheet.min_m[k]);
    let mut page = Page {
        height_mm: paper.height_mm,
        content: String::new(),
    };
    page.content.push_str("0 g\n");
    for black in target.black() {
        let [left, top] = [0, 1].map(|k| origin[k] + 1000.0 * black.min_m[k]);
        let [right, bottom] = [0, 1].map(|k| origin[k] + 1000.0 * black.max_m[k]);
        page.rectangle(left, top, right, bottom);
    }
    page.content.push_str("f\n");
    page.rulers(paper);
    // Beside the ruler, where the paper is wide enough for it.
    if paper.width_mm >= 205.0 {
        let left = STRIP_MM + 2.0 + RULER_MM + 5.0;
        let lines = [
            describe(target).as_str(),
            "Print at 100 %, without scaling. Both rulers must measure 100 mm;",
            "if they do not, write the true sizes into the .toml file.",
        ]
        .map(str::to_owned);
        for (line, up) in lines.iter().zip([11.0, 8.0, 5.0]) {
            page.text([left, paper.height_mm - up], 2.1, line);
        }
    }
    Ok(file(paper, &page.content))
}

/// Length of the rulers, mm.
const RULER_MM: f64 = 100.0;

struct Page {
    height_mm: f64,
    content: String,
}

impl Page {
    /// Points from the page's bottom left.
    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x * POINTS, (self.height_mm - y) * POINTS]
    }

    fn rectangle(&mut self, left: f64, top: f64, right: f64, bottom: f64) {
        let [x0, y0] = self.place([left, bottom]);
        let [x1, y1] = self.place([right, top]);
        writeln!(
            self.content,
            "{x0:.4} {y0:.4} {:.4} {:.4} re",
            x1 - x0,
            y1 - y0
        )
        .expect("text grows");
    }

    fn line(&mut self, from: [f64; 2], to: [f64; 2]) {
        let ([x0, y0], [x1, y1]) = (self.place(from), self.place(to));
        writeln!(self.content, "{x0:.4} {y0:.4} m {x1:.4} {y1:.4} l").expect("text grows");
    }

    /// 100 mm along the bottom from the left, and along the left from the bottom; omitted on a
    /// smaller sheet.
    fn rulers(&mut self, paper: Paper) {
        self.content.push_str("0.3 w\n");
        let [x, y] = [STRIP_MM + 2.0, paper.height_mm - STRIP_MM - 2.0];
        let ticks = |i: u32| {
            if i.is_multiple_of(50) {
                5.0
            } else if i.is_multiple_of(10) {
                3.5
            } else {
                1.5
            }
        };
        if x + RULER_MM <= paper.width_mm - 5.0 {
            for i in 0..=100 {
                let at = x + f64::from(i);
                self.line(
                    [at, paper.height_mm - 5.0],
                    [at, paper.height_mm - 5.0 - ticks(i)],
                );
            }
            self.line(
                [x, paper.height_mm - 5.0],
                [x + RULER_MM, paper.height_mm - 5.0],
            );
        }
        if y - RULER_MM >= 5.0 {
            for i in 0..=100 {
                let at = y - f64::from(i);
                self.line([5.0, at], [5.0 + ticks(i), at]);
            }
            self.line([5.0, y], [5.0, y - RULER_MM]);
        }
        self.content.push_str("S\n");
        if x + RULER_MM <= paper.width_mm - 5.0 {
            self.text([x - 0.6, paper.height_mm - 11.0], 2.4, "0");
            self.text([x + RULER_MM - 9.0, paper.height_mm - 11.0], 2.4, "100 mm");
        }
    }

    /// Text of `size_mm`, its base line starting at `at`.
    fn text(&mut self, at: [f64; 2], size_mm: f64, text: &str) {
        let [x, y] = self.place(at);
        let escaped = text
            .replace('\\', "\\\\")
            .replace('(', "\\(")
            .replace(')', "\\)");
        writeln!(
            self.content,
            "BT /F1 {:.3} Tf {x:.3} {y:.3} Td ({escaped}) Tj ET",
            size_mm * POINTS
        )
        .expect("text grows");
    }
}

/// One-line description of the board.
pub fn describe(target: &Target) -> String {
    let mm = |m: f64| {
        format!("{:.3}", 1000.0 * m)
            .trim_end_matches('0')
            .trim_end_matches('.')
            .to_owned()
    };
    match target {
        Target::Chessboard {
            columns,
            rows,
            square_m,
        } => {
            format!(
                "Chessboard, {columns} x {rows} inner corners, squares of {} mm",
                mm(*square_m)
            )
        }
        Target::AprilGrid {
            columns,
            rows,
            tag_m,
            spacing,
            first_id,
        } => format!(
            "AprilGrid 36h11, {columns} x {rows} tags of {} mm, spacing {spacing}, first id {first_id}",
            mm(*tag_m)
        ),
        Target::Charuco {
            columns,
            rows,
            square_m,
            marker_m,
            dictionary,
            first_id,
        } => format!(
            "ChArUco DICT_{}, {columns} x {rows} squares of {} mm, markers of {} mm, first id {first_id}",
            dictionary.name(),
            mm(*square_m),
            mm(*marker_m)
        ),
    }
}

/// The objects and the cross-reference table.
fn file(paper: Paper, content: &str) -> Vec<u8> {
    let [width, height] = [paper.width_mm, paper.height_mm].map(|v| v * POINTS);
    let objects = [
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>".to_owned(),
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_owned(),
        format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4} {height:.4}] /Contents 4 0 R \
             /Resources << /Font << /F1 5 0 R >> >> >>"
        ),
        format!(
            "<< /Length {} >>\nstream\n{content}endstream",
            content.len()
        ),
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>".to_owned(),
    ];
    let mut out = "%PDF-1.4\n".to_owned();
    let mut begins = Vec::new();
    for (i, object) in objects.iter().enumerate() {
        begins.push(out.len());
        write!(out, "{} 0 obj\n{object}\nendobj\n", i + 1).expect("text grows");
    }
    let table = out.len();
    write!(out, "xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1).expect("text grows");
    for begin in begins {
        writeln!(out, "{begin:010} 00000 n ").expect("text grows");
    }
    let count = objects.len() + 1;
    write!(
        out,
        "trailer\n<< /Size {count} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n"
    )
    .expect("text grows");
    out.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOARD: Target = Target::Chessboard {
        columns: 9,
        rows: 6,
        square_m: 0.018,
    };

    fn text(target: &Target, paper: &str) -> String {
        String::from_utf8(draw(target, Paper::parse(paper).unwrap()).unwrap()).unwrap()
    }

    /// Rectangles of the page in millimetres: left, bottom, width, height.
    fn rectangles(page: &str) -> Vec<[f64; 4]> {
        let numbers = |line: &str| {
            let all: Vec<f64> = line.split(' ').filter_map(|w| w.parse().ok()).collect();
            <[f64; 4]>::try_from(all).unwrap().map(|v| v / POINTS)
        };
        page.lines()
            .filter(|l| l.ends_with(" re"))
            .map(numbers)
            .collect()
    }

    #[test]
    fn the_pattern_has_its_true_size() {
        let page = text(&BOARD, "A3");
        let found = rectangles(&page);
        assert_eq!(found.len(), 35);
        assert!(
            found
                .iter()
                .all(|r| (r[2] - 18.0).abs() < 1e-3 && (r[3] - 18.0).abs() < 1e-3)
        );
        let left = found.iter().map(|r| r[0]).fold(f64::INFINITY, f64::min);
        let right = found.iter().map(|r| r[0] + r[2]).fold(0.0, f64::max);
        assert!((right - left - 180.0).abs() < 1e-3);
        // y points up: the top left square is black, the top right one of ten is not.
        let top = found.iter().map(|r| r[1]).fold(0.0, f64::max);
        assert!(
            found
                .iter()
                .any(|r| (r[1] - top).abs() < 1e-3 && (r[0] - left).abs() < 1e-3)
        );
        assert!(
            !found
                .iter()
                .any(|r| (r[1] - top).abs() < 1e-3 && (r[0] - left - 162.0).abs() < 1e-3)
        );
    }

    #[test]
    fn xref_table_has_the_object_offsets() {
        let page = text(&BOARD, "Letter");
        let table = page.rfind("\nxref\n").unwrap() + 1;
        let start: usize = page.lines().rev().nth(1).unwrap().parse().unwrap();
        assert_eq!(start, table);
        for (i, line) in page[table..].lines().skip(3).take(5).enumerate() {
            let begin: usize = line[..10].parse().unwrap();
            assert!(page[begin..].starts_with(&format!("{} 0 obj", i + 1)));
            assert_eq!(line.len() + 1, 20);
        }
        let length: usize = page
            .split("/Length ")
            .nth(1)
            .unwrap()
            .split(' ')
            .next()
            .unwrap()
            .parse()
            .unwrap();
        let from = page.find("stream\n").unwrap() + 7;
        assert_eq!(&page[from + length..from + length + 9], "endstream");
    }

    #[test]
    fn board_larger_than_the_paper_is_an_error() {
        let large = Target::Chessboard {
            columns: 9,
            rows: 6,
            square_m: 0.03,
        };
        let error = draw(&large, Paper::parse("A4").unwrap())
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("330 x 240 mm") && error.contains("196 x 283 mm"),
            "{error}"
        );
        assert!(draw(&large, Paper::parse("400x300").unwrap()).is_ok());
        for wrong in ["A5", "400", "x", "1x1", "400x300x2", "inf x 3"] {
            assert_eq!(Paper::parse(wrong), None, "{wrong}");
        }
    }
}
