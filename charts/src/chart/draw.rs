//! Draws the inside of a plot: bands, grid, series, reference lines, then labels on top of all.

use super::Chart;
use crate::axis::Scale;
use crate::geometry::{Point, Rect, cells, clip_line, clip_polygon, columns, thin};
use crate::labels::{Placer, SIZE};
use crate::series::{Histogram, Series, Shape, Style};
use crate::sheet::{GRID, markers};
use crate::svg::{Anchor, Svg, num, text_width};

/// Above this many points markers shrink to dots, and above the second number to a grid of 3 px.
const DOTS_ABOVE: usize = 300;
const CELLS_ABOVE: usize = 3000;

pub(super) struct Canvas<'a> {
    pub(super) chart: &'a Chart,
    pub(super) svg: Svg,
    pub(super) plot: Rect,
    pub(super) x: Scale,
    pub(super) y: Scale,
    pub(super) labels: Placer,
    /// Written last: labels beside these points, and the values centred above bars.
    pub(super) beside: Vec<(Point, String)>,
    pub(super) values: Vec<(Point, String)>,
}

impl Canvas<'_> {
    fn pixel(&self, (x, y): Point) -> Point {
        (self.x.at(x), self.y.at(y))
    }

    /// Where bars stand.
    fn ground(&self) -> f64 {
        self.y.at(if self.y.log {
            self.y.range.0
        } else {
            0.0_f64.clamp(self.y.range.0, self.y.range.1)
        })
    }

    pub(super) fn bands(&mut self) {
        let Rect { x0, y0, x1, y1 } = self.plot;
        let bands = self.chart.references.iter().filter(|r| r.from != r.to);
        let (vertical, horizontal): (Vec<_>, Vec<_>) = bands.partition(|r| r.of_x);
        let vertical = vertical
            .iter()
            .filter(|r| self.chart.x.usable(r.from) && self.chart.x.usable(r.to));
        let spans = vertical.map(|r| {
            let (a, b) = (self.x.at(r.from) - x0, self.x.at(r.to) - x0);
            (a.min(b), a.max(b), 0)
        });
        let high = y1 - y0;
        let runs = columns(spans, (x1 - x0) as usize).into_iter();
        let d: String = runs
            .map(|(at, len, _)| format!("M{} {y0}h{len}v{high}h-{len}z", x0 as usize + at))
            .collect();
        if !d.is_empty() {
            self.svg
                .element("path", &format!("d=\"{d}\" fill=\"#f6d9c4\""));
        }
        for r in horizontal
            .iter()
            .filter(|r| self.chart.y.usable(r.from) && self.chart.y.usable(r.to))
        {
            let (a, b) = (
                self.y.at(r.from).clamp(y0, y1),
                self.y.at(r.to).clamp(y0, y1),
            );
            self.svg
                .rect(x0, a.min(b), x1 - x0, (a - b).abs(), "fill=\"#e3efe6\"");
        }
    }

    pub(super) fn grid(&mut self, x_ticks: &[(f64, String)], y_ticks: &[(f64, String)]) {
        let Rect { x0, y0, x1, y1 } = self.plot;
        if self.chart.x.category_names().is_none() {
            for (v, _) in x_ticks {
                let at = self.x.at(*v).clamp(x0, x1);
                self.svg.line((at, y0), (at, y1), GRID);
            }
        }
        for (v, _) in y_ticks {
            let at = self.y.at(*v).clamp(y0, y1);
            self.svg.line(
                (x0, at),
                (x1, at),
                if *v == 0.0 && !self.y.log {
                    "stroke=\"#8a8a8a\""
                } else {
                    GRID
                },
            );
        }
    }

    /// Areas first, then lines, then points.
    pub(super) fn series(&mut self, styles: &[Style]) {
        let chart = self.chart;
        let all = || chart.series.iter().zip(styles.iter().copied());
        self.draw_bars(
            &all()
                .filter_map(|(s, style)| s.bar_values().map(|v| (v, style)))
                .collect::<Vec<_>>(),
        );
        for (series, style) in all() {
            match &series.shape {
                Shape::Band(points) => self.draw_band(points, style),
                Shape::Histogram(histogram) => {
                    self.draw_histogram(histogram, style, &series.stroke(style))
                }
                _ => {}
            }
        }
        for (series, style) in all() {
            match &series.shape {
                Shape::Line(points) => self.draw_line(points, style.colour, &series.stroke(style)),
                Shape::Steps(points) => self.draw_line(
                    &corners_of_steps(points),
                    style.colour,
                    &series.stroke(style),
                ),
                _ => {}
            }
        }
        for (series, style) in all() {
            if let Shape::Line(points) | Shape::Scatter(points) | Shape::Steps(points) =
                &series.shape
            {
                self.draw_points(series, points, style);
            }
        }
    }

    fn draw_line(&mut self, points: &[Point], colour: &str, stroke: &str) {
        let chart = self.chart;
        for run in points
            .split(|p| !chart.usable((p.0, p.1, p.1)))
            .filter(|run| !run.is_empty())
        {
            let pixels: Vec<Point> = run.iter().map(|p| self.pixel(*p)).collect();
            for piece in clip_line(&pixels, self.plot) {
                let piece = thin(&piece);
                match piece.as_slice() {
                    [only] => self.dots(&[*only], colour, 2.6),
                    piece => self.svg.poly("polyline", piece, stroke),
                }
                self.labels.avoid_line(&piece);
            }
        }
    }

    fn draw_points(&mut self, series: &Series, points: &[Point], style: Style) {
        let at = |p: &Point| {
            (self.chart.usable((p.0, p.1, p.1)) && self.x.holds(p.0) && self.y.holds(p.1))
                .then(|| self.pixel(*p))
        };
        let placed: Vec<Option<Point>> = points.iter().map(at).collect();
        let pixels: Vec<Point> = placed.iter().flatten().copied().collect();
        if series.has_markers() {
            match pixels.len() {
                n if n > CELLS_ABOVE => self.draw_cells(&pixels, style.colour),
                n if n > DOTS_ABOVE => self.dots(&pixels, style.colour, 3.0),
                _ => markers(&mut self.svg, &pixels, style),
            }
            if pixels.len() <= CELLS_ABOVE {
                let rect = |(x, y): &Point| Rect {
                    x0: x - 4.0,
                    y0: y - 4.0,
                    x1: x + 4.0,
                    y1: y + 4.0,
                };
                pixels
                    .iter()
                    .map(rect)
                    .for_each(|rect| self.labels.avoid(rect));
            }
        }
        for (label, at) in series
            .labels
            .iter()
            .zip(placed)
            .filter(|(label, _)| !label.is_empty())
        {
            if let Some(at) = at {
                self.beside.push((at, label.clone()));
            }
        }
    }

    fn dots(&mut self, points: &[Point], colour: &str, wide: f64) {
        let d: String = points
            .iter()
            .map(|p| format!("M{} {}h.01", num(p.0), num(p.1)))
            .collect();
        let look = format!(
            "d=\"{d}\" stroke=\"{colour}\" stroke-width=\"{wide}\" stroke-linecap=\"round\""
        );
        self.svg.element("path", &look);
    }

    /// More points than can be told apart: the squares that hold one, larger where they are many.
    fn draw_cells(&mut self, points: &[Point], colour: &str) {
        let fine = cells(points, 2.0);
        let (size, strokes) = if fine.len() <= 4000 {
            (2.0, fine)
        } else {
            (4.0, cells(points, 4.0))
        };
        let mut d = String::new();
        for ((x, y), long) in strokes {
            let (x, y) = (x.min(self.plot.x1), (y - size / 2.0).max(self.plot.y0));
            let end = (y + long + size).min(self.plot.y1);
            d.push_str(&format!("M{} {}V{}", num(x), num(y), num(end)));
            self.labels.avoid_line(&[(x, y), (x, end)]);
        }
        self.svg.element(
            "path",
            &format!("d=\"{d}\" stroke=\"{colour}\" stroke-width=\"{size}\""),
        );
    }

    fn draw_band(&mut self, points: &[(f64, f64, f64)], style: Style) {
        let chart = self.chart;
        for run in points
            .split(|p| !chart.usable(*p))
            .filter(|run| !run.is_empty())
        {
            let edge = |of: fn(&(f64, f64, f64)) -> Point| {
                thin(&run.iter().map(|p| self.pixel(of(p))).collect::<Vec<_>>())
            };
            let mut outline = edge(|p| (p.0, p.1));
            outline.extend(edge(|p| (p.0, p.2)).into_iter().rev());
            let look = format!("fill=\"{}\" fill-opacity=\"0.2\"", style.colour);
            self.svg
                .poly("polygon", &clip_polygon(outline, self.plot), &look);
        }
    }

    fn draw_histogram(&mut self, histogram: &Histogram, style: Style, stroke: &str) {
        let ground = self.ground();
        let top = |n: f64| if n > 0.0 { self.y.at(n) } else { ground };
        let tops: Vec<Point> = histogram
            .corners()
            .map(|(edge, n)| (self.x.at(edge), top(n)))
            .collect();
        let (Some(first), Some(last)) = (tops.first(), tops.last()) else {
            return;
        };
        let ends = [(first.0, ground), (last.0, ground)];
        let outline = thin(&[&ends[..1], &tops, &ends[1..]].concat());
        let look = format!("fill=\"{}\" fill-opacity=\"0.3\"", style.colour);
        self.svg
            .poly("polygon", &clip_polygon(outline.clone(), self.plot), &look);
        for piece in clip_line(&outline, self.plot) {
            self.svg.poly("polyline", &piece, stroke);
            self.labels.avoid_line(&piece);
        }
    }

    /// Bars side by side. Their values stand above them where there is room for all of them.
    fn draw_bars(&mut self, series: &[(&[f64], Style)]) {
        let axis = &self.chart.y;
        let slot = if self.x.log {
            0.0
        } else {
            self.x.at(1.0) - self.x.at(0.0)
        };
        let wide = (slot * 0.8 / series.len() as f64).clamp(1.0, 70.0);
        let ground = self.ground();
        let text = |v: &f64| {
            if axis.usable(*v) {
                axis.value_text(*v)
            } else {
                "n/a".into()
            }
        };
        let fits = |v: &f64| text_width(&text(v), 10.0) <= wide + 8.0;
        let texts = series.iter().all(|(values, _)| values.iter().all(fits));
        for (index, (values, style)) in series.iter().enumerate() {
            for (i, &value) in values
                .iter()
                .enumerate()
                .filter(|(i, _)| self.x.holds(*i as f64))
            {
                let left = self.x.at(i as f64) + (index as f64 - series.len() as f64 / 2.0) * wide;
                let (left, right) = (
                    left.max(self.plot.x0),
                    (left + wide - 1.0).min(self.plot.x1),
                );
                let mut top = ground;
                if axis.usable(value) {
                    top = self.y.at(value).clamp(self.plot.y0, self.plot.y1);
                    let (y0, y1) = (top.min(ground), top.max(ground));
                    self.svg.rect(
                        left,
                        y0,
                        (right - left).max(0.5),
                        y1 - y0,
                        &format!("fill=\"{}\"", style.colour),
                    );
                    self.labels.avoid(Rect {
                        x0: left,
                        y0: y0 - 12.0,
                        x1: right.max(left),
                        y1,
                    });
                }
                if texts {
                    let y = if value < 0.0 {
                        top + 11.0
                    } else {
                        (top - 3.0).max(self.plot.y0 + 9.0)
                    };
                    self.values.push((((left + right) / 2.0, y), text(&value)));
                }
            }
        }
    }

    /// The lines, and the labels of lines and bands. They take their places before the labels of points.
    pub(super) fn reference_lines(&mut self) {
        let Rect { x0, y0, x1, y1 } = self.plot;
        for r in &self.chart.references {
            let (axis, scale) = if r.of_x {
                (&self.chart.x, self.x)
            } else {
                (&self.chart.y, self.y)
            };
            if !axis.usable(r.from)
                || !axis.usable(r.to)
                || !(scale.holds(r.from) || scale.holds(r.to))
            {
                continue;
            }
            let at = scale.at(r.from.clamp(scale.range.0, scale.range.1));
            if r.from == r.to {
                let (a, b) = if r.of_x {
                    ((at, y0), (at, y1))
                } else {
                    ((x0, at), (x1, at))
                };
                self.svg.line(
                    a,
                    b,
                    "stroke=\"#444\" stroke-width=\"1.2\" stroke-dasharray=\"6 3\"",
                );
                self.labels.avoid_line(&[a, b]);
            }
            if r.label.is_empty() {
                continue;
            }
            let wide = text_width(&r.label, SIZE);
            let starts: Vec<Point> = if r.of_x {
                let rows = (0..5).map(|row| y0 + SIZE + 2.0 + 14.0 * f64::from(row));
                rows.flat_map(|y| [(at + 4.0, y), (at - 4.0 - wide, y)])
                    .collect()
            } else {
                let from_left = [x1 - wide - 5.0, x0 + 5.0, (x0 + x1 - wide) / 2.0];
                let other = scale.at(r.to.clamp(scale.range.0, scale.range.1));
                let levels = [at - 5.0, at + SIZE + 3.0, other + SIZE + 3.0, other - 5.0];
                from_left
                    .into_iter()
                    .flat_map(|x| levels.map(|y| (x, y)))
                    .collect()
            };
            let start = self.labels.place(&r.label, &starts);
            self.svg
                .text_with_rim(start.0, start.1, SIZE, Anchor::Start, &r.label);
        }
    }

    pub(super) fn write_labels(&mut self) {
        for ((x, y), text) in std::mem::take(&mut self.values) {
            self.svg.text_with_rim(x, y, 10.0, Anchor::Middle, &text);
        }
        for (at, text) in std::mem::take(&mut self.beside) {
            let (x, y) = self.labels.beside(at, &text);
            self.svg.text_with_rim(x, y, SIZE, Anchor::Start, &text);
        }
    }
}

/// The corners of a step line. What cannot be drawn stays in, as the break it is.
fn corners_of_steps(points: &[Point]) -> Vec<Point> {
    let mut corners = Vec::with_capacity(points.len() * 2);
    for (i, p) in points.iter().enumerate() {
        if i > 0 {
            corners.push((p.0, points[i - 1].1));
        }
        corners.push(*p);
    }
    corners
}
