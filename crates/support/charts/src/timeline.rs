//! A timeline: one row per stream, spans coloured by kind, marks across all rows.
//!
//! Spans are merged on the pixels they fall on, and what is shorter than a pixel is drawn one pixel
//! wide, so 100 000 events stay small and a gap of a millisecond still shows in an hour. Where
//! spans of several kinds share a pixel the last named kind wins: name the ordinary state first and
//! the worst one last. Where a row has no span it remains empty.

use crate::axis::{Axis, Extent, Scale};
use crate::geometry::columns;
use crate::sheet::{GRID, Sheet, Swatch, TICK, ticks_below};
use crate::svg::{Anchor, MUTED, Svg, shorten, text_width};

/// `from..to` in the units of the time axis, and its kind as an index into the kinds of the
/// timeline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Where it starts.
    pub from: f64,
    /// Where it ends; equal to `from` for an instant.
    pub to: f64,
    /// Which of the named kinds it is.
    pub kind: usize,
}

/// Rows of spans over one time axis.
#[derive(Clone, Debug)]
pub struct Timeline {
    sheet: Sheet,
    axis: Axis,
    kinds: Vec<String>,
    rows: Vec<Row>,
    marks: Vec<(f64, String)>,
}

#[derive(Clone, Debug)]
struct Row {
    name: String,
    note: String,
    spans: Vec<Span>,
}

/// Light for the ordinary state, strong for the rest.
const COLOURS: [&str; 6] = [
    "#9CCBE8", "#E69F00", "#D55E00", "#000000", "#CC79A7", "#009E73",
];
const ROW: f64 = 22.0;

impl Timeline {
    /// An empty timeline over an axis, usually [`Axis::time`].
    pub fn new(title: &str, axis: Axis) -> Self {
        let sheet = Sheet {
            title: title.into(),
            ..Sheet::default()
        };
        Self {
            sheet,
            axis,
            kinds: Vec::new(),
            rows: Vec::new(),
            marks: Vec::new(),
        }
    }

    /// A line below the title.
    pub fn subtitle(mut self, text: &str) -> Self {
        self.sheet.subtitle = text.into();
        self
    }

    /// A small line at the bottom.
    pub fn footnote(mut self, text: &str) -> Self {
        self.sheet.footnotes.push(text.into());
        self
    }

    /// Names the kinds, the ordinary one first and the worst last; at most six look different.
    pub fn kinds<T: Into<String>>(mut self, names: impl IntoIterator<Item = T>) -> Self {
        self.kinds = names.into_iter().map(Into::into).collect();
        self
    }

    /// Adds a row; `note` stands at its right end, for example "3 gaps, 0.2 s".
    pub fn row(mut self, name: &str, note: &str, spans: impl IntoIterator<Item = Span>) -> Self {
        self.rows.push(Row {
            name: name.into(),
            note: note.into(),
            spans: spans.into_iter().collect(),
        });
        self
    }

    /// A labelled instant across all rows.
    pub fn mark(mut self, at: f64, label: &str) -> Self {
        self.marks.push((at, label.into()));
        self
    }

    /// The chart, `width` pixels wide (at least 320) and as high as its rows need.
    pub fn to_svg(&self, width: u32) -> String {
        let width = f64::from(width.max(320));
        let mut svg = Svg::default();
        let swatch = |kind: usize| Swatch::Box(COLOURS[kind.min(5)], 1.0);
        let legend: Vec<_> = self
            .kinds
            .iter()
            .enumerate()
            .map(|(i, name)| (name.as_str(), swatch(i)))
            .collect();
        let head = self.sheet.head(&mut svg, width, &legend);

        let widest = |texts: &mut dyn Iterator<Item = &String>| {
            texts.map(|t| text_width(t, TICK)).fold(0.0, f64::max)
        };
        let left = (widest(&mut self.rows.iter().map(|r| &r.name)) + 18.0)
            .min((width * 0.3).max(145.0).min(width * 0.45));
        let note = widest(&mut self.rows.iter().map(|r| &r.note)).min((width * 0.25).max(104.0));
        let (x0, x1) = (
            left.round(),
            (width - if note > 0.0 { note + 18.0 } else { 14.0 }).round(),
        );

        let extent = self.extent();
        let empty = extent.0.is_none();
        let most = ((x1 - x0) / 80.0).clamp(2.0, 12.0) as usize;
        let range = self.axis.resolve(extent, 0.0, false, most);
        let scale = Scale {
            range,
            log: self.axis.is_log(),
            pixels: (x0, x1),
        };

        let marks = self.draw_mark_labels(&mut svg, scale, head, width);
        let top = marks.bottom + 4.0;
        let bottom = top + ROW * self.rows.len().max(2) as f64;
        let ticks = if empty {
            Vec::new()
        } else {
            self.axis.ticks(range, most)
        };
        for (value, _) in &ticks {
            svg.line((scale.at(*value), top), (scale.at(*value), bottom), GRID);
        }
        for (i, row) in self.rows.iter().enumerate() {
            let y = top + ROW * i as f64;
            self.draw_row(&mut svg, row, scale, y, [left - 16.0, note + 2.0]);
        }
        for &x in &marks.lines {
            svg.line(
                (x, top - 4.0),
                (x, bottom),
                "stroke=\"#222\" stroke-dasharray=\"3 2\"",
            );
        }
        if empty {
            svg.text(
                (x0 + x1) / 2.0,
                (top + bottom) / 2.0 + 5.0,
                14.0,
                Anchor::Middle,
                "fill=\"#767676\"",
                "no data",
            );
        }
        ticks_below(
            &mut svg,
            bottom,
            width,
            ticks.into_iter().map(|(v, text)| (scale.at(v), text)),
        );
        svg.text(
            (x0 + x1) / 2.0,
            bottom + 31.0,
            TICK,
            Anchor::Middle,
            "",
            &self.axis.caption(range),
        );

        let notes = self.notes(&marks);
        let lines = self.sheet.foot_lines(width, &notes);
        let end = Sheet::foot(&mut svg, bottom + 36.0, &lines);
        svg.finish(width, end, &self.sheet.title)
    }

    fn usable(&self, span: &Span) -> bool {
        self.axis.usable(span.from) && self.axis.usable(span.to)
    }

    /// Extent of the usable spans and marks.
    fn extent(&self) -> Extent {
        let mut extent = Extent::default();
        let spans = self.rows.iter().flat_map(|row| &row.spans);
        spans
            .filter(|s| self.usable(s))
            .flat_map(|s| [s.from, s.to])
            .for_each(|v| extent.add(v));
        self.marks
            .iter()
            .map(|m| m.0)
            .filter(|v| self.axis.usable(*v))
            .for_each(|v| extent.add(v));
        extent
    }

    /// Notes below the chart, on what it does not show.
    fn notes(&self, marks: &Marks) -> Vec<String> {
        let mut notes = Vec::new();
        let spans = self.rows.iter().flat_map(|row| &row.spans);
        let skipped = spans.filter(|s| !self.usable(s)).count();
        let skipped = skipped + self.marks.iter().filter(|m| !self.axis.usable(m.0)).count();
        if skipped > 0 {
            notes.push(format!("{skipped} spans or marks with times not finite"));
        }
        if marks.unlabelled > 0 {
            notes.push(format!(
                "{} marks without room for their label",
                marks.unlabelled
            ));
        }
        notes
    }

    /// A row with its top at `y`; `widths` are those of its name and its note.
    fn draw_row(&self, svg: &mut Svg, row: &Row, scale: Scale, y: f64, widths: [f64; 2]) {
        let (x0, x1) = scale.pixels;
        let grey = format!("fill=\"{MUTED}\"");
        svg.text(
            x0 - 8.0,
            y + 15.0,
            TICK,
            Anchor::End,
            "",
            &shorten(&row.name, TICK, widths[0]),
        );
        svg.text(
            x1 + 8.0,
            y + 15.0,
            TICK,
            Anchor::Start,
            &grey,
            &shorten(&row.note, TICK, widths[1]),
        );
        svg.line((x0, y + ROW), (x1, y + ROW), GRID);
        self.draw_spans(svg, row, scale, y);
    }

    /// One path per kind; the ordinary kind is drawn lower than the row, so kinds differ in height
    /// too.
    fn draw_spans(&self, svg: &mut Svg, row: &Row, scale: Scale, y: f64) {
        let (x0, x1) = scale.pixels;
        let good = row.spans.iter().filter(|s| self.usable(s));
        let pixels = good.map(|s| {
            let (a, b) = (scale.at(s.from) - x0, scale.at(s.to) - x0);
            (a.min(b), a.max(b), s.kind.min(5))
        });
        let mut paths = [const { String::new() }; 6];
        for (start, len, kind) in columns(pixels, (x1 - x0) as usize) {
            let (inset, high) = if kind == 0 {
                (5.0, ROW - 10.0)
            } else {
                (2.0, ROW - 4.0)
            };
            paths[kind].push_str(&format!(
                "M{} {}h{len}v{high}h-{len}z",
                x0 as usize + start,
                y + inset
            ));
        }
        for (d, colour) in paths.iter().zip(COLOURS).filter(|(d, _)| !d.is_empty()) {
            svg.element("path", &format!("d=\"{d}\" fill=\"{colour}\""));
        }
    }

    /// Labels of marks in up to three rows below `y`, each right of its line.
    fn draw_mark_labels(&self, svg: &mut Svg, scale: Scale, y: f64, width: f64) -> Marks {
        let mut marks: Vec<_> = self.marks.iter().filter(|m| scale.holds(m.0)).collect();
        marks.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut found = Marks {
            lines: Vec::new(),
            bottom: y,
            unlabelled: 0,
        };
        let mut free = [0.0_f64; 3];
        for (at, label) in marks {
            let x = scale.at(*at).round();
            if found.lines.last() != Some(&x) {
                found.lines.push(x);
            }
            let wide = text_width(label, TICK);
            let start = (x + 3.0).min(width - wide - 4.0);
            match free.iter().position(|end| *end <= start) {
                Some(level) if start > 0.0 => {
                    let base = y + 13.0 * (level as f64 + 1.0);
                    svg.text(start, base, TICK, Anchor::Start, "", label);
                    free[level] = start + wide + 6.0;
                    found.bottom = found.bottom.max(base + 3.0);
                }
                _ => found.unlabelled += 1,
            }
        }
        found
    }
}

struct Marks {
    lines: Vec<f64>,
    bottom: f64,
    unlabelled: usize,
}
